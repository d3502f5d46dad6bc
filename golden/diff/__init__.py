"""The differentiable renderer: kernels on the CPU and on CUDA, and a plain renderer in torch (`reference`) to compare them
with."""

from __future__ import annotations

import os

from spec.errors import InputError
from spec.extras import how_to_get

SPINS = "1000"
"""How often a thread of torch looks for new work before it sleeps. The 300,000 of GNU OpenMP are longer than the time between
two operations of the trainer, so that its threads never sleep: with two other processes on two cores, 100 iterations took
120 s on two threads and 5.6 s on one. With 1000 they take 6.7 s on two, and no longer than before where nothing else runs."""


def import_torch() -> None:
    """Imports torch, so that a missing one is reported before any data is read, and lets its idle threads sleep.

    The latter has no effect where torch was imported before or the environment has a setting of its own.

    Raises:
        InputError: torch is not installed.
    """
    if "OMP_WAIT_POLICY" not in os.environ:
        os.environ.setdefault("GOMP_SPINCOUNT", SPINS)
    try:
        import torch  # noqa: F401
    except ImportError as error:
        raise InputError(f"this needs torch, which is not installed; {how_to_get('torch')}") from error
