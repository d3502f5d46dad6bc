"""Runs training stages one after the other, with a log, progress, checkpoints, interrupt and resume, and a stop when numbers
diverge.

A chain that was interrupted and resumed gives, bit for bit, the result of an uninterrupted one: stages are deterministic, their
states are complete (`golden.training.stage`), and a finished stage's result is not changed any more.
"""

from __future__ import annotations

import copy
import json
import math
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, NoReturn

import torch

from golden.diff.gaussians import Gaussians
from golden.scenes.files import atomic_output
from golden.training.checkpoint import Checkpoint, Checkpoints, check_options
from golden.training.failure import TrainingError, room_needed
from golden.training.progress import Progress
from golden.training.remaining import Remaining
from golden.training.stage import Stage
from spec.errors import InputError

CHECKPOINT_SECONDS = 60.0
"""Time between checkpoints within a stage."""

CHECKPOINTS = "checkpoints"
"""Folder of a run's checkpoints."""

LOG = "log.jsonl"
"""The log's file name. It holds one JSON object for each iteration: iteration, stage, what the stage logs (loss, points,
psnr, ...), and seconds."""

FIELDS = frozenset(field.name for field in fields(Gaussians))
"""Names under which stages' states keep trained parameters; these must stay finite."""


class Interrupted(KeyboardInterrupt):
    """The user's interrupt, raised after the current iteration has been finished and checkpointed."""


@dataclass(frozen=True)
class Planned:
    """A stage of a chain before it starts.

    Attributes:
        name: the stage's name, unique in the chain.
        total: number of iterations that it is expected to take.
        make: makes the stage from the results of the stages before, by name. The results are copies that it may change.
    """

    name: str
    total: int
    make: Callable[[dict[str, Any]], Stage]


def non_finite(state: object, prefix: str = "") -> Iterator[str]:
    """Dotted names of the trained parameters in a stage's state that hold an infinity or NaN."""
    if isinstance(state, Gaussians):
        state = state.tensors()
    items = state.items() if isinstance(state, Mapping) else enumerate(state) if isinstance(state, (list, tuple)) else ()
    for key, value in items:
        name = f"{prefix}{key}"
        if isinstance(value, torch.Tensor):
            # The sum in the tensor's own precision takes a tenth of the time; only if it overflows, the other one decides.
            if key in FIELDS and not math.isfinite(float(value.detach().sum())) and not math.isfinite(
                    float(value.detach().sum(dtype=torch.float64))):
                yield name
        else:
            yield from non_finite(value, f"{name}.")


class Chain:
    """Runs stages in an output folder.

    Args:
        plan: the stages in order.
        folder: the output folder, in which `checkpoints/` and `log.jsonl` are written.
        options: the run's options, plain values by name; a resumed run must have the same.
        resume: continue from the folder's last checkpoint.
        classes: classes that results and states consist of, see `Checkpoints`.
        checkpoint_seconds: seconds between checkpoints within a stage; the end of each stage has one in any case.

    Raises:
        InputError: there is nothing to resume, or the run has other options; or, without `resume`, the folder holds an
            unfinished run.
    """

    def __init__(
        self, plan: Sequence[Planned], folder: Path, options: dict[str, Any], *, resume: bool = False,
        classes: tuple[type, ...] = (), checkpoint_seconds: float = CHECKPOINT_SECONDS,
    ) -> None:
        self.plan, self.folder, self.options = tuple(plan), folder, options
        self.checkpoint_seconds = checkpoint_seconds
        self.checkpoints = Checkpoints(folder / CHECKPOINTS, classes)
        self.log_path = folder / LOG
        self.results: dict[str, Any] = {}
        self.spent: dict[str, dict[str, float]] = {}
        self.iteration = self.index = 0
        self._state: dict[str, Any] | None = None
        self._remaining: Remaining
        totals = tuple((stage.name, stage.total) for stage in self.plan)
        if resume:
            self._resume(totals)
        else:
            self._begin(totals)

    def run(self) -> dict[str, Any]:
        """Runs the stages that are left and returns all results by stage name.

        Raises:
            Interrupted: after SIGINT, once the current iteration is finished and checkpointed.
            TrainingError: a loss or parameter is not finite, or the disk is full; the last checkpoint is intact.
        """
        self._remaining = Remaining([(stage.name, stage.total) for stage in self.plan], self.spent)
        with _interrupts() as interrupted, self._logging() as log:
            for index in range(self.index, len(self.plan)):
                self.index = index
                self._run_stage(self.plan[index], log, interrupted)
        return self.results

    def _begin(self, totals: tuple[tuple[str, int], ...]) -> None:
        if self.checkpoints.paths():
            last = self.checkpoints.load()
            if last.stage < len(last.plan):
                raise InputError(
                    f"{self.folder}: holds a run stopped at iteration {last.iteration}; go on with it by --resume, give "
                    f"another --out, or delete {self.checkpoints.folder}")
        self.checkpoints.clear()
        self.log_path.unlink(missing_ok=True)
        self._save(None)

    def _resume(self, totals: tuple[tuple[str, int], ...]) -> None:
        last = self.checkpoints.load()
        check_options(last, self.options, totals)
        self.results, self.spent, self.iteration = dict(last.results), dict(last.spent), last.iteration
        self.index, self._state = last.stage, last.state
        torch.set_num_threads(last.threads)
        self._truncate_log()

    def _truncate_log(self) -> None:
        """Removes what was logged after the checkpoint, including lines that a crash left incomplete."""
        kept = []
        for line in self.log_path.read_bytes().splitlines(keepends=True) if self.log_path.exists() else ():
            try:
                iteration = json.loads(line)["iteration"]
            except (ValueError, KeyError, TypeError):
                break
            if iteration > self.iteration:
                break
            kept.append(line)
        with room_needed(self.log_path, self.checkpoints.kept()), atomic_output(self.log_path) as file:
            file.writelines(kept)

    @contextmanager
    def _logging(self) -> Iterator[Callable[[dict[str, Any]], None]]:
        """Appends records to the log without buffering, so that every checkpointed iteration is in the log."""
        with open(self.log_path, "ab", buffering=0) as file:
            def log(record: dict[str, Any]) -> None:
                with room_needed(self.log_path, self.checkpoints.kept()):
                    file.write((json.dumps(record) + "\n").encode())

            yield log

    def _run_stage(
        self, planned: Planned, log: Callable[[dict[str, Any]], None], interrupted: Callable[[], bool],
    ) -> None:
        stage = planned.make(copy.deepcopy(self.results))
        if self._state is not None:
            stage.load(self._state)
            self._state = None
        spent = self.spent.setdefault(planned.name, {"iterations": 0, "seconds": 0.0})
        position = f"{self.index + 1}/{len(self.plan)} {planned.name}"
        with Progress(position, stage.total, stage.done) as progress:
            saved = resumed = time.monotonic()
            last = None
            before = spent["seconds"]
            while not stage.finished:
                record = stage.step()
                self.iteration += 1
                now = time.monotonic()
                spent["iterations"] += 1
                spent["seconds"] = before + now - resumed
                self._check(stage, record)
                seconds = sum(each["seconds"] for each in self.spent.values())
                log({"iteration": self.iteration, "stage": planned.name, **_plain(record), "seconds": round(seconds, 3)})
                if last is not None:  # the first iteration prepares: it compiles kernels, or measures what came in
                    self._remaining.took(planned.name, now - last)
                last = now
                progress.update(stage.done, record, self._remaining.seconds(planned.name, stage.done))
                if interrupted():
                    self._save(stage)
                    raise Interrupted(f"interrupted at iteration {self.iteration}, in {planned.name}")
                if now - saved >= self.checkpoint_seconds:
                    self._save(stage)
                    saved = time.monotonic()
            self._finite_state(stage)
        self.results[planned.name] = copy.deepcopy(stage.result())
        self.index += 1
        self._save(None)
        if interrupted():
            raise Interrupted(f"interrupted at iteration {self.iteration}, after {planned.name}")

    def _check(self, stage: Stage, record: Mapping[str, Any]) -> None:
        """Stops the chain if an iteration's loss is not finite, or a parameter of a stage that has `gaussians` is not."""
        loss = float(record.get("loss", 0.0))
        found = list(non_finite(getattr(stage, "gaussians", None)))
        if not math.isfinite(loss) or found:
            self._diverged(stage, record, loss, found or list(non_finite(stage.state())))

    def _finite_state(self, stage: Stage) -> dict[str, Any]:
        """The stage's state, in which every trained parameter is finite; no other state is checkpointed."""
        state = stage.state()
        found = list(non_finite(state))
        if found:
            self._diverged(stage, {}, 0.0, found)
        return state

    def _diverged(self, stage: Stage, record: Mapping[str, Any], loss: float, found: list[str]) -> NoReturn:
        what = [] if math.isfinite(loss) else [f"the loss is {loss}"]
        what += [f"{found[0]} holds values that are not finite"] if found else []
        view = f", view {record['view']}" if "view" in record else ""
        raise TrainingError(
            f"{stage.name}: stopped after iteration {self.iteration} ({stage.done} of the stage{view}): {' and '.join(what)}; "
            f"{self.checkpoints.kept()}")

    def _save(self, stage: Stage | None) -> None:
        state = None if stage is None else self._finite_state(stage)
        self.checkpoints.save(Checkpoint(
            self.options, tuple((each.name, each.total) for each in self.plan), self.results, self.index, state, self.iteration,
            self.spent, torch.get_num_threads()))


def _plain(record: Mapping[str, Any]) -> dict[str, Any]:
    """A record's numbers ready for JSON; numbers that were not measured in this iteration (NaN, infinite) are left out."""
    values = {name: value.item() if hasattr(value, "item") else value for name, value in record.items()}
    return {name: value for name, value in values.items() if not isinstance(value, float) or math.isfinite(value)}


@contextmanager
def _interrupts() -> Iterator[Callable[[], bool]]:
    """Yields a function that tells whether SIGINT came during the block; a second SIGINT interrupts at once.

    Python delivers signals only to the main thread; in other threads the function always returns False.
    """
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    came = []

    def note(number: int, frame: object) -> None:
        came.append(number)
        signal.signal(signal.SIGINT, before)

    before = signal.signal(signal.SIGINT, note)
    try:
        yield lambda: bool(came)
    finally:
        signal.signal(signal.SIGINT, before)
