"""`make check`: what a change needs at once: the linter, the types, and the tests that are quick.

The tests left out need Verilator, torch or real scenes, or take long; `make test` runs them. Each step's output is shown, and
the last line says which steps have failed.
"""

from __future__ import annotations

import subprocess
import sys
import time

from spec.paths import ROOT

QUICK = "not (rtl or torch or slow or long or data)"
"""Of the markers of pyproject.toml, which tests run."""

ELSEWHERE = ("tests/rtl", "tests/tb", "tests/golden/diff", "tests/golden/training")
"""Folders without a quick test, which are not even read: all of theirs need Verilator or torch."""

STEPS: dict[str, tuple[str, ...]] = {
    "lint": ("ruff", "check", "."),
    "types": ("mypy",),
    "tests": ("pytest", "-n", "auto", "--dist", "worksteal", "-m", QUICK,
              *(word for folder in ELSEWHERE for word in ("--ignore", folder))),
}


def main() -> int:
    """Runs every step, whatever has failed before it; 1 where one has."""
    failed, begin = [], time.monotonic()
    for name, command in STEPS.items():
        started = time.monotonic()
        print(f"{name}: {' '.join(command)}", flush=True)
        if subprocess.run([sys.executable, "-m", *command], cwd=ROOT, check=False).returncode:
            failed.append(name)
        print(f"{name}: {'FAILED' if name in failed else 'good'} in {time.monotonic() - started:.1f} s", flush=True)
    print(f"check: {', '.join(failed) + ' FAILED' if failed else 'all good'} in {time.monotonic() - begin:.1f} s")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
