"""Where training runs: the CPU, or a CUDA device with NVIDIA Warp's kernels."""

from __future__ import annotations

import importlib.util
from types import ModuleType

import torch

from spec.errors import InputError
from spec.extras import how_to_get

DEVICES = ("auto", "cpu", "cuda")
"""The devices that `--device` accepts; `auto` is CUDA if everything that it needs is there, and the CPU otherwise."""

BACKENDS = ("numba", "warp")
"""The backends that blend: numba on the CPU; Warp on CUDA, and on the CPU where tests ask for it."""


def missing_for_cuda() -> str | None:
    """What keeps training off CUDA on this machine, and what to do about it; None if nothing does."""
    if torch.version.cuda is None:
        return f"torch {torch.__version__} is built for the CPU alone; install a build of it with CUDA"
    if not torch.cuda.is_available():
        return f"torch {torch.__version__} (CUDA {torch.version.cuda}) finds no device: is there a GPU, and its driver?"
    if importlib.util.find_spec("warp") is None:
        return f"NVIDIA Warp is not installed; {how_to_get('warp')}"
    return None


def resolve_device(name: str) -> torch.device:
    """The device that the argument `--device` names.

    Raises:
        InputError: the name is unknown, or CUDA is asked for and there is no device, no torch that can use it, or no Warp.
    """
    if name not in DEVICES:
        raise InputError(f"device {name!r} is not accepted: {', '.join(DEVICES)} are")
    missing = None if name == "cpu" else missing_for_cuda()
    if name == "cuda" and missing is not None:
        raise InputError(f"device cuda cannot be used: {missing}")
    return torch.device("cpu" if name == "cpu" or missing is not None else "cuda")


def resolve_backend(device: torch.device, backend: str | None) -> str:
    """The backend that blends on a device: numba on the CPU and Warp elsewhere, unless `backend` names one.

    Raises:
        ValueError: the name is unknown, or numba is asked for with tensors that are not on the CPU.
    """
    if backend is None:
        return "numba" if device.type == "cpu" else "warp"
    if backend not in BACKENDS:
        raise ValueError(f"backend must be one of {BACKENDS} or None, not {backend!r}")
    if backend == "numba" and device.type != "cpu":
        raise ValueError(f"backend numba takes tensors on the CPU, not on {device}")
    return backend


def import_blend_warp() -> ModuleType:
    """Imports `golden.diff.blend_warp`.

    Raises:
        InputError: Warp is not installed.
    """
    try:
        from golden.diff import blend_warp
    except ImportError as error:
        raise InputError(f"NVIDIA Warp is not installed, and blends there; {how_to_get('warp')}") from error
    return blend_warp
