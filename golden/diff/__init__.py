"""The differentiable renderer: kernels on the CPU and on CUDA, and one plain renderer in torch (`reference`) beside them."""

from __future__ import annotations

from spec.errors import InputError


def import_torch() -> None:
    """Checks that torch is there before anything is read.

    Raises:
        InputError: it is not installed.
    """
    try:
        import torch  # noqa: F401
    except ImportError as error:
        raise InputError("training needs torch, which is not installed: make setup, or pip install -e '.[train]'") from error
