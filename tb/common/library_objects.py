"""The compiler that Verilator's makefiles call, as their OBJCACHE: objects of Verilator's own library are compiled once.

Every simulator is linked with the same five files of the library, which take four fifths of the time of a small unit's build.

    python -IS library_objects.py KEPT LIBRARY COMPILER ARGUMENTS...

KEPT is where their objects are kept, by a hash of the whole command line; a folder is good for one compiler and one
Verilator. LIBRARY is the folder of the library's sources; what lies elsewhere is compiled as ever.
"""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path


def compile_or_copy(kept: Path, library: Path, command: Sequence[str]) -> int:
    """Runs a compiler's command, or copies what the same command has given before; returns the exit status."""
    shared = (
        Path(command[-1]).parent == library and "-o" in command[:-1]
        and f"-I{os.getcwd()}" not in command)  # headers of the model's own: it is not the same object elsewhere
    if not shared:
        return subprocess.run(command, check=False).returncode
    out = command.index("-o") + 1
    digest = hashlib.sha256(repr([*command[:out], *command[out + 1 :]]).encode()).hexdigest()[:16]
    known = kept / f"{digest}.o"
    kept.mkdir(parents=True, exist_ok=True)
    with open(kept / "lock", "w") as lock:  # one process compiles, others wait for its object
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not known.exists():
            scratch = known.with_suffix(".tmp.o")
            plain = [argument for argument in (*command[:out], str(scratch), *command[out + 1 :]) if argument != "-MMD"]
            status = subprocess.run(plain, check=False).returncode
            if status:
                return status
            scratch.replace(known)
    shutil.copyfile(known, command[out])  # no link: a compiler that writes over the copy must not change what is kept
    return 0


if __name__ == "__main__":
    sys.exit(compile_or_copy(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:]))
