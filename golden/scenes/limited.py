"""Runs a reader of other people's files in a process of its own, with limits of time and memory.

Readers written in C++ believe what a file says of itself: a count of 2^40 makes them loop for hours, take all memory, or abort
the process. A process with limits ends, and the caller says which file it was. `read` starts it; it runs this module.
"""

from __future__ import annotations

import importlib
import os
import pickle
import resource
import subprocess
import sys
from pathlib import Path
from typing import Any

from spec.errors import InputError

SECONDS, SECONDS_PER_MB = 20, 1
"""CPU time that a reader may take: a start, and a part that grows with the input. Readers here manage some 20 MB a second."""

BYTES, BYTES_PER_BYTE = 2 << 30, 64
"""Memory that a reader may take beyond what it has after importing its library: a start, and a multiple of the input."""


def read(function: str, path: Path, size: int) -> Any:
    """Returns what a function returns for a path, from another process.

    Args:
        function: `module:name`. It takes the path, and what it returns is pickled.
        path: the file or folder.
        size: bytes of input, from which the limits follow.

    Raises:
        InputError: the function raised an exception, whose text the message holds, or it broke a limit or died.
    """
    seconds = SECONDS + SECONDS_PER_MB * (size >> 20)
    more_bytes = BYTES + BYTES_PER_BYTE * size
    command = [sys.executable, "-m", "golden.scenes.limited", function, str(path), str(seconds), str(more_bytes)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(entry or os.getcwd() for entry in sys.path)}
    done = subprocess.run(command, env=environment, capture_output=True, check=False)
    if done.returncode == 0:
        return pickle.loads(done.stdout)
    last = done.stderr.decode(errors="replace").strip().splitlines()[-1:] or ["no message"]
    if done.returncode == _FAILED:
        raise InputError(f"{path}: {last[0]}")
    raise InputError(f"{path}: its reader died or took more than {seconds} s of CPU time, as readers do on broken files "
                     f"(status {done.returncode}: {last[0]})")


_FAILED = 3
"""Exit status of the process where the function raised an exception."""


def _limit(seconds: int, more_bytes: int) -> None:
    """Limits this process, from now on."""
    pages = Path("/proc/self/statm")
    mapped = int(pages.read_text().split()[0]) * resource.getpagesize() if pages.exists() else 1 << 35
    for kind, value in ((resource.RLIMIT_CPU, seconds), (resource.RLIMIT_AS, mapped + more_bytes), (resource.RLIMIT_CORE, 0)):
        hard = resource.getrlimit(kind)[1]
        try:
            resource.setrlimit(kind, (value if hard == resource.RLIM_INFINITY else min(value, hard), hard))
        except (OSError, ValueError):  # a system that knows no such limit
            continue


def _main(function: str, path: str, seconds: str, more_bytes: str) -> None:
    module, name = function.split(":")
    call = getattr(importlib.import_module(module), name)
    _limit(int(seconds), int(more_bytes))
    try:
        result = call(Path(path))
    except MemoryError:
        sys.exit(_last_words("takes more memory than its size can need; is it broken?"))
    except Exception as error:  # libraries written in C++ raise what their authors threw
        sys.exit(_last_words(str(error).splitlines()[0] if str(error) else repr(error)))
    sys.stdout.buffer.write(pickle.dumps(result))


def _last_words(text: str) -> int:
    print(text, file=sys.stderr)
    return _FAILED


if __name__ == "__main__":
    _main(*sys.argv[1:])
