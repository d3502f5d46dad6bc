"""Checkpoints of a chain of stages: written completely or not at all, the last two kept, and refused by a run with other
options."""

from __future__ import annotations

import io
import re
import warnings
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch

from golden.diff.gaussians import Gaussians
from golden.scenes.files import atomic_output
from golden.scenes.request import make_folder
from golden.training.failure import room_needed
from spec.errors import InputError

KEEP = 2
"""Number of checkpoints kept: the newest, and the one before in case the newest cannot be read."""

FORMAT = 1
"""Version of a checkpoint's content."""

_NUMPY = (np.ndarray, np.dtype, np._core.multiarray._reconstruct, np._core.multiarray.scalar,
          *{type(np.dtype(code)) for code in "?bBhHiIlLqQefd"})


@dataclass(frozen=True)
class Checkpoint:
    """The state of a chain.

    Attributes:
        options: the run's options by name; a run that resumes must have the same.
        plan: name and expected iterations of each stage.
        results: the finished stages' results by name.
        stage: index of the current stage; the number of stages once all are finished.
        state: that stage's state, or None if it has not started.
        iteration: number of iterations taken by all stages.
        spent: iterations and seconds of each stage that has begun.
        threads: torch's number of threads, on which the order of its sums depends.
    """

    options: dict[str, Any]
    plan: tuple[tuple[str, int], ...]
    results: dict[str, Any]
    stage: int
    state: dict[str, Any] | None
    iteration: int
    spent: dict[str, dict[str, float]]
    threads: int


class Checkpoints:
    """The checkpoints in a folder.

    Args:
        folder: the folder; it is created if need be.
        classes: classes, beside Gaussians and numpy's arrays, that results and states consist of. A checkpoint with any
            other class is not read, so that a file from elsewhere cannot run code.
    """

    def __init__(self, folder: Path, classes: tuple[type, ...] = ()) -> None:
        self.folder = make_folder(folder)
        self.classes = [Gaussians, *_NUMPY, *classes]

    def paths(self) -> list[Path]:
        """The checkpoints, oldest first."""
        return sorted(self.folder.glob("iteration_*.pt"))

    def save(self, checkpoint: Checkpoint) -> Path:
        """Writes a checkpoint and removes those older than the last two.

        Raises:
            TrainingError: the disk is full; existing checkpoints are untouched.
        """
        content = io.BytesIO()  # if torch wrote the file itself, it would hide why a write failed
        values = {field.name: getattr(checkpoint, field.name) for field in fields(checkpoint)}
        torch.save({"format": FORMAT, **values}, content)
        path = self.folder / f"iteration_{checkpoint.iteration:09d}_{checkpoint.stage:02d}.pt"
        with room_needed(path, self.kept()), atomic_output(path) as file:
            file.write(content.getbuffer())
        for old in self.paths()[:-KEEP]:
            old.unlink(missing_ok=True)
        return path

    def kept(self) -> str:
        """The part of an error message that names the last checkpoint."""
        paths = self.paths()
        return f"the last checkpoint is intact: {paths[-1]}" if paths else "there was no checkpoint yet"

    def load(self) -> Checkpoint:
        """Loads the newest checkpoint that can be read.

        Raises:
            InputError: there is none.
        """
        paths = self.paths()
        if not paths:
            raise InputError(f"{self.folder}: holds no checkpoint to resume from; run without --resume")
        failures = []
        for path in reversed(paths):
            try:
                checkpoint = self._read(path)
            except Exception as error:  # torch's reader of pickles raises nearly anything on a broken file
                failures.append(f"{path}: is no readable checkpoint ({_reason(error)})")
                continue
            for failure in failures:
                warnings.warn(f"{failure}; going on from {path}", stacklevel=2)
            return checkpoint
        raise InputError("; ".join(failures))

    def _read(self, path: Path) -> Checkpoint:
        with torch.serialization.safe_globals(self.classes):
            values = torch.load(path, map_location="cpu", weights_only=True)
        if values.pop("format") != FORMAT:
            raise ValueError("of another version")
        return Checkpoint(**values)

    def clear(self) -> None:
        """Removes all checkpoints."""
        for path in self.paths():
            path.unlink(missing_ok=True)


def _reason(error: Exception) -> str:
    """What is wrong with a file, in one line; torch's own message is long."""
    foreign = re.search(r"Unsupported global: GLOBAL (\S+)", str(error))
    if foreign:
        return f"it holds a {foreign[1]}, which no stage here saves"
    return str(error).partition("\n")[0] or type(error).__name__


def check_options(checkpoint: Checkpoint, options: dict[str, Any], plan: tuple[tuple[str, int], ...]) -> None:
    """Refuses a checkpoint of a run with other options.

    Raises:
        InputError: an option differs; the message names it, both values, and what is accepted.
    """
    for name in sorted({*options, *checkpoint.options}):
        now, then = options.get(name), checkpoint.options.get(name)
        if now != then:
            raise InputError(
                f"--resume with {name} {now!r} is not accepted: the run that is resumed has {name} {then!r}; "
                "give the same, or another --out")
    if tuple(checkpoint.plan) != tuple(plan):
        raise InputError(
            f"--resume is not accepted: the run that is resumed has the stages {checkpoint.plan}, this version plans {plan}; "
            "give another --out")
