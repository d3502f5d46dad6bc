"""Tells what a study is doing: a line for each step with its time, and an estimate of the time that is left.

The times of a run are kept in the user's cache folder, and the next run estimates from them.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from golden.scenes.files import read_json
from golden.scenes.request import make_folder, write_json
from spec.errors import InputError
from spec.paths import cache_folder


class Progress:
    """The steps of a command.

    Args:
        command: the name under which the times are kept.
        steps: the names of all steps, in the order in which they are taken.
        folder: where the times are kept (default: the user's cache folder).
    """

    def __init__(self, command: str, steps: Sequence[str], folder: Path | None = None) -> None:
        self._steps, self._place = list(steps), 0
        self._file = (folder or cache_folder("durations")) / f"{command}.json"
        try:
            kept = read_json(self._file)
        except InputError:
            kept = {}
        self._known = {name: value for name, value in kept.items() if isinstance(value, int | float)}

    @contextmanager
    def step(self, name: str) -> Iterator[None]:
        """Prints the beginning of a step and, when it is done, its seconds and an estimate of the time that is left."""
        self._place = self._steps.index(name) + 1 if name in self._steps else self._place + 1
        before = f", {_spoken(self._known[name])} the last time" if name in self._known else ""
        print(f"[{self._place}/{max(len(self._steps), self._place)}] {name}{before}", flush=True)
        begin = time.monotonic()
        yield
        seconds = time.monotonic() - begin
        self._known[name] = round(seconds, 2)
        left = self._left()
        print(f"[{self._place}/{max(len(self._steps), self._place)}] {name}: {_spoken(seconds)}"
              + ("" if left is None else f"; about {_spoken(left)} left"), flush=True)
        self._keep()

    def _left(self) -> float | None:
        """The seconds of the steps that are not taken yet; None where one of them is not known, or at the end."""
        rest = self._steps[self._place:]
        return sum(self._known[name] for name in rest) if rest and all(name in self._known for name in rest) else None

    def _keep(self) -> None:
        try:
            make_folder(self._file.parent)
            write_json(self._file, self._known)
        except InputError as error:  # an estimate is not worth an abort
            print(f"the times of the steps are not kept: {error}", file=sys.stderr)


def _spoken(seconds: float) -> str:
    if seconds < 99.5:
        return f"{seconds:.1f} s" if seconds < 9.95 else f"{seconds:.0f} s"
    return f"{round(seconds / 60)} min" if seconds >= 600 else f"{seconds // 60:.0f} min {seconds % 60:.0f} s"
