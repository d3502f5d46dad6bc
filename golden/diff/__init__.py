"""The differentiable renderer: kernels on the CPU and on CUDA, and a plain renderer in torch (`reference`) to compare them
with."""

from __future__ import annotations

from spec.errors import InputError
from spec.extras import how_to_get


def import_torch() -> None:
    """Checks that torch is installed, so that a missing torch is reported before any data is read.

    Raises:
        InputError: torch is not installed.
    """
    try:
        import torch  # noqa: F401
    except ImportError as error:
        raise InputError(f"this needs torch, which is not installed; {how_to_get('torch')}") from error
