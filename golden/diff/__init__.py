"""The differentiable renderer: kernels on the CPU and on CUDA, and a plain renderer in torch (`reference`) to compare them
with."""

from __future__ import annotations

import os

from spec.errors import InputError
from spec.extras import how_to_get


def import_torch() -> None:
    """Imports torch, so that a missing one is reported before any data is read.

    Its threads are made to sleep while they wait, unless the environment says otherwise. By default they spin between any two
    operations, which costs another process its processor and, with as many processes as processors, most of the time.

    Raises:
        InputError: torch is not installed.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")  # is read when torch is first imported
    try:
        import torch  # noqa: F401
    except ImportError as error:
        raise InputError(f"this needs torch, which is not installed; {how_to_get('torch')}") from error
