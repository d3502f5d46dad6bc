"""A good checkpoint of training, and how it is read. Nothing else of the fuzzer needs torch."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import torch

from golden.training.checkpoint import FORMAT, Checkpoint, Checkpoints


def checkpoint_files() -> dict[str, bytes]:
    """The files of a folder with one checkpoint."""
    out = io.BytesIO()
    torch.save({"format": FORMAT, "options": {"seed": 1}, "plan": (("dense", 10),), "results": {"psnr": np.float64(20.0)},
                "stage": 0, "state": {"step": 3, "rows": torch.zeros(4, 3), "rng": np.arange(4)}, "iteration": 3,
                "spent": {"dense": {"iterations": 3.0, "seconds": 1.0}}, "threads": 2}, out)
    return {"iteration_000000003_00.pt": out.getvalue()}


def read_checkpoint(folder: Path) -> Checkpoint:
    """The newest checkpoint in a folder that can be read."""
    return Checkpoints(folder).load()
