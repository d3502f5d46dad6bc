"""Commands in processes of their own, as a user starts them in the root of the checkout."""

from __future__ import annotations

import subprocess
import sys

from spec.paths import ROOT

PYTHON = sys.executable


def run(*command: str, **options: object) -> subprocess.CompletedProcess:
    """What a command printed, and its exit status."""
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, **options)


def python(*argv: str, **options: object) -> subprocess.CompletedProcess:
    """The same of this Python."""
    return run(PYTHON, *argv, **options)
