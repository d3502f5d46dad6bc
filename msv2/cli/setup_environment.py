"""Make the virtual environment the Makefile's targets run in; a no-op when it already has what is asked for.

Standard library only: it runs before anything is installed.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import shutil
import subprocess
import sys
import venv
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
ENVIRONMENT = ROOT / ".venv"
STAMP = ENVIRONMENT / "installed.json"
DEFAULT_EXTRAS = "models,train,synth,dev"
SYSTEM_TOOLS = {"g++": "g++", "make": "make", "perl": "perl"}
"""Programs that Verilator's builds call, and the Debian package of each."""


def check_system() -> None:
    """Exit with a message when Python is too old or a system tool is missing."""
    if sys.version_info < (3, 11):  # noqa: UP036 - whoever runs this may have an older one
        sys.exit(f"error: Python {sys.version.split()[0]} is too old: 3.11 or newer is needed (set PYTHON=)")
    missing = [package for tool, package in SYSTEM_TOOLS.items() if shutil.which(tool) is None]
    if missing:
        sys.exit(f"error: missing system tools; install the packages: {' '.join(missing)}")


def check_extras(asked: set[str]) -> None:
    """Exit with a message when pyproject.toml has no such extra."""
    import difflib
    import tomllib  # in the standard library since Python 3.11, which `check_system` asks for

    known = sorted(tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"])
    for extra in sorted(asked - set(known)):
        near = difflib.get_close_matches(extra, known, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        sys.exit(f"error: extra {extra!r} is not accepted: choose of {', '.join(known)}{hint}")


def wanted_state(extras: set[str]) -> dict[str, object]:
    """What the stamp must say for `extras`."""
    project = hashlib.sha256((ROOT / "pyproject.toml").read_bytes()).hexdigest()
    return {"project": project, "python": sys.version.split()[0], "extras": sorted(extras)}


def main(argv: Sequence[str] | None = None) -> None:
    """The command line's work."""
    parser = argparse.ArgumentParser(prog="msv2 setup", description=__doc__)
    parser.add_argument("--extras", default=DEFAULT_EXTRAS, help=f"separated by commas, or 'none' (default: {DEFAULT_EXTRAS})")
    parser.add_argument("--warm", action="store_true",
                        help="also compile the kernels of renderer and cycle model, so that the first frame starts at once")
    if not (ROOT / "pyproject.toml").exists():
        sys.exit("error: msv2 setup works in a checkout; an installed msv2 gets extras by pip install 'msv2[EXTRA]', and its "
                 "kernels by python -m msv2.cli.warm")
    args = parser.parse_args(argv)
    asked = {extra for extra in args.extras.replace(",", " ").split() if extra != "none"}
    if asked:
        check_system()
        check_extras(asked)
    install(asked)
    if args.warm:
        sys.exit(subprocess.run([str(ENVIRONMENT / "bin" / "python"), "-m", "msv2.cli.warm"], cwd=ROOT).returncode)


def install(asked: set[str]) -> None:
    """Create or update the environment, so that it has the asked extras and those of earlier set-ups."""
    installed = json.loads(STAMP.read_text()) if STAMP.exists() else {"extras": []}
    extras = asked | set(installed["extras"])  # never take away what an earlier set-up installed
    if installed == wanted_state(extras):
        return
    check_system()
    print(f"setting up {ENVIRONMENT.name} (extras: {', '.join(sorted(extras)) or 'none'}) ...", flush=True)
    if not (ENVIRONMENT / "bin" / "python").exists():
        venv.create(ENVIRONMENT, with_pip=True)
    target = f"{ROOT}[{','.join(sorted(extras))}]" if extras else str(ROOT)
    pip = [str(ENVIRONMENT / "bin" / "python"), "-m", "pip", "--disable-pip-version-check", "install", "-q", "-e", target]
    if subprocess.run(pip).returncode:
        sys.exit("error: pip could not install the packages named in pyproject.toml (its own message is above)")
    STAMP.write_text(json.dumps(wanted_state(extras)))


if __name__ == "__main__":
    main()
