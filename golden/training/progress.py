"""Shows the progress of a stage: a bar on a terminal, otherwise a line for every tenth of the stage."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Mapping
from typing import Any, TextIO

from tqdm import tqdm

from spec.progress import as_time

MEMORY = 0.95
"""Weight of the previous moving PSNR when a new measurement comes."""

LINES = 10
"""Number of lines for a stage if there is no terminal."""


class Progress:
    """The display of a running stage: iterations, time left of the stage and of the whole chain, loss, moving PSNR, points.

    Args:
        title: text before the bar.
        total: number of iterations of the stage.
        done: number of iterations that an earlier run has taken.
        stream: where to write; a terminal gets a bar.
    """

    def __init__(self, title: str, total: int, done: int = 0, stream: TextIO | None = None) -> None:
        self.title, self.total, self.first, self.stream = title, total, done, stream or sys.stderr
        self.psnr = math.nan
        self.begin = time.monotonic()
        self.shown = done * LINES // max(total, 1)
        self.bar = tqdm(total=total, initial=done, desc=title, unit="it", file=self.stream, dynamic_ncols=True) \
            if self.stream.isatty() else None

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *exception: object) -> None:
        if self.bar is not None:
            self.bar.close()

    def update(self, done: int, record: Mapping[str, Any], whole: float | None = None) -> None:
        """Shows that `done` iterations have been taken, the last of which logged `record`, and that the whole chain will take
        another `whole` seconds, if that is known."""
        psnr = float(record.get("psnr", math.nan))
        if math.isfinite(psnr):
            self.psnr = MEMORY * self.psnr + (1 - MEMORY) * psnr if math.isfinite(self.psnr) else psnr
        numbers = {"loss": f"{float(record['loss']):.4g}"} if "loss" in record else {}
        if math.isfinite(self.psnr):
            numbers["psnr"] = f"{self.psnr:.2f}"
        if "points" in record:
            numbers["points"] = f"{int(record['points']):,}"
        if self.bar is not None:
            numbers |= {} if whole is None else {"all stages": f"{as_time(whole)} left"}
            self.bar.set_postfix(numbers, refresh=False)
            self.bar.update(done - self.bar.n)
        elif done * LINES // max(self.total, 1) > self.shown or done >= self.total:
            self.shown = done * LINES // max(self.total, 1)
            left = (time.monotonic() - self.begin) / max(done - self.first, 1) * max(self.total - done, 0)
            told = "".join(f"{name} {text}, " for name, text in numbers.items()) + f"{as_time(left)} left"
            told += "" if whole is None else f", {as_time(whole)} of all stages"
            print(f"{self.title}: {done}/{self.total}, {told}", file=self.stream, flush=True)
