"""Commands in processes of their own, as a user starts them in the root of the checkout."""

from __future__ import annotations

import os
import subprocess
import sys

from spec.paths import ROOT

PYTHON = sys.executable


def run(*command: str, **options: object) -> subprocess.CompletedProcess:
    """What a command printed, and its exit status. A `make` below `make test` must not take itself for a part of that."""
    outer = ("MAKEFLAGS", "MAKELEVEL", "MFLAGS", "MAKEOVERRIDES")
    options["env"] = {name: value for name, value in options.get("env", os.environ).items() if name not in outer}
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, **options)


def python(*argv: str, **options: object) -> subprocess.CompletedProcess:
    """The same of this Python."""
    return run(PYTHON, *argv, **options)
