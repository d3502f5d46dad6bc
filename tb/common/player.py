"""Playing recordings through a unit: stimuli out to files, one simulation for all of them, results back as records."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
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
        name: for messages.
        inputs: rows of every input stream, by name.
        expected: number of items to come out of every output stream, by name.
        settings: values of the plain inputs.
        patterns: (pattern, seed) of a port's pauses; a port not named never pauses.
        reset: reset before the run.
        abort: cycles after which the run is cut off by the next one's reset; its outputs are not checked. None: to the end.
        quiet: cycles without any output that must follow the last expected item.
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
    """What a run gave.

    Attributes:
        outputs: rows of every output stream.
        cycles: clock cycles from the start to the last item that moved.
        items, stalls: items moved on, and cycles spent waiting with an item at, every port.
        observed: the plain outputs at the end.
        seconds: wall time.
        errors: broken rules, in words.
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
    watchdog: int = 20_000,
) -> list[Recording]:
    """Plays `runs` in order in one simulation; files stay in `folder`.

    Args:
        playback: the unit and its ports.
        runs: what to play.
        folder: where stimuli, results, log and waves go.
        waves: record these.
        progress: show a bar.
        watchdog: cycles without any item moving after which a run is given up.

    Raises:
        SimulationError: the build or the simulation itself fails; broken rules are in the recordings.
    """
    folder = folder.resolve()  # the simulator runs in it
    for number, run in enumerate(runs):
        _write_stimuli(playback, run, folder / str(number))
    orders = {
        "watchdog": watchdog, "progress": progress,
        "observed": [name for name, _ in playback.observed],
        "ports": [s.name for s in (*playback.inputs, *playback.outputs)],
        "runs": [{key: value for key, value in asdict(run).items() if key not in ("inputs", "patterns")} for run in runs],
    }
    (folder / "orders.json").write_text(json.dumps(orders))
    report = folder / "report.json"
    report.unlink(missing_ok=True)
    simulate(
        playback.design(), "tb.common.recordings", folder, waves=waves, env={"PLAYBACK_FOLDER": str(folder)},
        plusargs=[f"+folder={folder}"])
    results = json.loads(report.read_text())
    return [_read(playback, run, result, folder / str(n)) for n, (run, result) in enumerate(zip(runs, results, strict=True))]


def _write_stimuli(playback: Playback, run: Run, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for stream in playback.inputs:
        codec.write_hex(folder / f"{stream.name}.hex", pack(stream.record, run.inputs[stream.name]))
    for stream in (*playback.inputs, *playback.outputs):
        pattern, seed = run.patterns.get(stream.name, (Pattern.NEVER, 0))
        (folder / f"{stream.name}.pauses").write_text("\n".join(str(int(p)) for p in pattern.pauses(seed)))


def _read(playback: Playback, run: Run, result: dict, folder: Path) -> Recording:
    numbers = {key: result[key] for key in ("cycles", "items", "stalls", "observed", "seconds")}
    if run.abort is not None:
        outputs = {stream.name: np.empty(0, stream.record.dtype) for stream in playback.outputs}
        return Recording(outputs, errors=(), **numbers)
    outputs = {
        stream.name: unpack(stream.record, codec.read_hex(folder / f"{stream.name}.out", stream.record.width))
        for stream in playback.outputs}
    errors = tuple(text for bit, text in ERRORS.items() if result["errors"] & bit)
    return Recording(outputs, errors=errors, **numbers)
