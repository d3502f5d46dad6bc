"""Plays recordings through a unit: writes the stimuli to files, runs one simulation for all of them, and reads back records."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np

from spec.packing import pack, unpack
from tb.common import codec
from tb.common.patterns import Pattern
from tb.common.playback import ERRORS, Playback
from tb.common.runner import Waves, simulate


@dataclass(frozen=True)
class Run:
    """One recording to play.

    Attributes:
        name: the run's name, for messages.
        inputs: the rows of every input stream, by name.
        expected: the number of items that every output stream must give, by name.
        settings: values of the plain inputs.
        patterns: (pattern, seed) of a port's pauses; a port that is not named never pauses.
        reset: whether to reset the unit before the run.
        abort: the number of cycles after which the next run's reset cuts this run off, in which case its outputs are not
            checked; None to run to the end.
        quiet: the number of cycles without any output that must follow the last expected item.
    """

    name: str
    inputs: Mapping[str, np.ndarray]
    expected: Mapping[str, int]
    settings: Mapping[str, int] = field(default_factory=dict)
    patterns: Mapping[str, tuple[Pattern, int]] = field(default_factory=dict)
    reset: bool = True
    abort: int | None = None
    quiet: int = 200


@dataclass(frozen=True)
class Recording:
    """The results of a run.

    Attributes:
        outputs: the rows of every output stream.
        cycles: clock cycles from the start to the last item that moved.
        items, stalls: by port, the number of items that moved and the number of cycles in which an item waited.
        observed: the plain outputs at the end.
        seconds: wall time.
        errors: descriptions of the violated rules.
    """

    outputs: dict[str, np.ndarray]
    cycles: int
    items: dict[str, int]
    stalls: dict[str, int]
    observed: dict[str, int]
    seconds: float
    errors: tuple[str, ...]


def play(
    playback: Playback, runs: Sequence[Run], folder: Path, *, waves: Waves | None = None, progress: bool = False,
    watchdog: int = 20_000, counted: bool = False,
) -> list[Recording]:
    """Plays `runs` in order in one simulation; all files stay in `folder`.

    Args:
        playback: the unit and its ports.
        runs: the recordings to play.
        folder: the folder for stimuli, results, log and waves.
        waves: the waves to record, or None.
        progress: whether to show a progress bar.
        watchdog: a run is given up after this many cycles in which no item moves.
        counted: whether to count changes of bits and ways of choices, in `tb.common.runner.COUNTS` in `folder`.

    Raises:
        SimulationError: the build or the simulation itself fails. Violated rules do not raise; they are in the recordings.
    """
    folder = folder.resolve()  # the simulator runs in another working directory
    (folder / "orders.json").write_text(json.dumps(prepare(playback, runs, folder, watchdog) | {"progress": progress}))
    report = folder / "report.json"
    report.unlink(missing_ok=True)
    simulate(
        replace(playback.design(), counted=counted), "tb.common.recordings", folder, waves=waves,
        env={"PLAYBACK_FOLDER": str(folder)}, plusargs=[f"+folder={folder}"])
    results = json.loads(report.read_text())
    return [recording_of(playback, run, result, folder / str(n))
            for n, (run, result) in enumerate(zip(runs, results, strict=True))]


def prepare(playback: Playback, runs: Sequence[Run], folder: Path, watchdog: int) -> dict[str, object]:
    """Writes the stimuli of run n into folder/n; returns what the simulation needs to know of the runs, JSON-ready."""
    for number, run in enumerate(runs):
        _write_stimuli(playback, run, folder / str(number))
    return {
        "watchdog": watchdog, "observed": [name for name, _ in playback.observed],
        "ports": [s.name for s in (*playback.inputs, *playback.outputs)],
        "runs": [{key: value for key, value in asdict(run).items() if key not in ("inputs", "patterns")} for run in runs],
    }


def _write_stimuli(playback: Playback, run: Run, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for stream in playback.inputs:
        codec.write_hex(folder / f"{stream.name}.hex", pack(stream.record, run.inputs[stream.name]))
    for stream in (*playback.inputs, *playback.outputs):
        pattern, seed = run.patterns.get(stream.name, (Pattern.NEVER, 0))
        (folder / f"{stream.name}.pauses").write_text("\n".join(str(int(p)) for p in pattern.pauses(seed)))


def recording_of(playback: Playback, run: Run, result: dict, folder: Path) -> Recording:
    """The recording of a run from the simulation's result and the outputs that it left in the folder."""
    numbers = {key: result[key] for key in ("cycles", "items", "stalls", "observed", "seconds")}
    if run.abort is not None:
        outputs = {stream.name: np.empty(0, stream.record.dtype) for stream in playback.outputs}
        return Recording(outputs, errors=(), **numbers)
    outputs = {
        stream.name: unpack(stream.record, codec.read_hex(folder / f"{stream.name}.out", stream.record.width))
        for stream in playback.outputs}
    errors = tuple(text for bit, text in ERRORS.items() if result["errors"] & bit)
    return Recording(outputs, errors=errors, **numbers)
