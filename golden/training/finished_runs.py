"""Finds finished runs of `golden/train.py` by their options, so that nothing is trained twice."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from golden.metrics.hvsq import FULL_WIDTH
from golden.scenes.files import read_json
from golden.training.chain import CHECKPOINTS, LOG
from golden.training.checkpoint import Checkpoint, Checkpoints
from golden.training.plots import read_log
from golden.training.recipe import RESULTS
from spec.errors import InputError


@dataclass(frozen=True)
class FinishedRun:
    """A run that has written its report.

    Attributes:
        folder: its output folder.
        options: its options, by the names of the command line.
    """

    folder: Path
    options: dict[str, Any]

    @property
    def fingerprint(self) -> str:
        """A hash of the model that the run wrote."""
        return hashlib.sha256((self.folder / "model.ply").read_bytes()).hexdigest()[:12]

    @property
    def records(self) -> list[dict[str, Any]]:
        """The records of its log."""
        return read_log(self.folder / LOG)

    def last(self) -> Checkpoint | None:
        """Its last checkpoint; None if it is gone or is not that of a finished run."""
        if not (self.folder / CHECKPOINTS).is_dir():
            return None
        try:
            last = Checkpoints(self.folder / CHECKPOINTS, RESULTS).load()
        except InputError:
            return None
        return last if last.stage == len(last.plan) else None


def find_run(folder: Path, wanted: Mapping[str, Any]) -> FinishedRun | None:
    """The newest finished run in a folder of runs that has the options in `wanted`; options with the value None are not
    compared.

    Runs of baselines, without opacity enhancement, or with a gate, pooling, number of views or dense training of their own are
    not considered.
    """
    reports = sorted(folder.glob("*/report.json"), key=lambda path: path.stat().st_mtime, reverse=True)
    for path in reports:
        try:
            options = read_json(path)["options"]
        except (InputError, KeyError):
            continue
        fits = all(options.get(name) == value for name, value in wanted.items() if value is not None)
        own = (options.get("baseline") is None and options.get("opacity-enhancement") is True
               and options.get("pooling-width") == FULL_WIDTH and options.get("pooling") == "blocks"
               and options.get("gate") == "psnr" and options.get("views") is None and options.get("dense") is None)
        if fits and own and (path.parent / "model.ply").exists():
            return FinishedRun(path.parent, options)
    return None
