"""A compiler wrapper, called by Verilator's makefiles as OBJCACHE, that compiles Verilator's own library only once.

Every simulator is linked with the same five files of the library. Compiling them takes four fifths of the build time of a
small unit.

    python -IS library_objects.py KEPT LIBRARY COMPILER ARGUMENTS...

KEPT is the folder in which the objects are kept, by a hash of the whole command line; one folder serves one compiler and one
version of Verilator. LIBRARY is the folder of the library's sources; files from elsewhere are compiled as usual.
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
    """Runs a compiler command, or copies the object that the same command produced before. Returns the exit status."""
    shared = (
        Path(command[-1]).parent == library and "-o" in command[:-1]
        and f"-I{os.getcwd()}" not in command)  # such a command uses the model's own headers: its object cannot be shared
    if not shared:
        return subprocess.run(command, check=False).returncode
    out = command.index("-o") + 1
    digest = hashlib.sha256(repr([*command[:out], *command[out + 1 :]]).encode()).hexdigest()[:16]
    known = kept / f"{digest}.o"
    kept.mkdir(parents=True, exist_ok=True)
    with open(kept / "lock", "w") as lock:  # one process compiles while the others wait for its object
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not known.exists():
            scratch = known.with_suffix(".tmp.o")
            plain = [argument for argument in (*command[:out], str(scratch), *command[out + 1 :]) if argument != "-MMD"]
            status = subprocess.run(plain, check=False).returncode
            if status:
                return status
            scratch.replace(known)
    shutil.copyfile(known, command[out])  # not a link: a compiler that overwrites the copy must not change the kept object
    return 0


if __name__ == "__main__":
    sys.exit(compile_or_copy(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3:]))
