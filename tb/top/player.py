"""Plays frames through the machine: writes memory images to files, runs one simulation for all frames, and reads back frames
and counters."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from golden.host.memory_image import DisplayPixels, FramePixels, MemoryImage, PackedPixels
from spec.codes import ErrorCode
from spec.config import AcceleratorConfig
from spec.host_settings import settings
from spec.memory import BEAT_BYTES
from spec.registers import register_map
from tb.common.runner import Waves, random_start, simulate
from tb.top.device import Machine
from tb.top.memory import MemorySpeed, broken_rules, memory_beats, plusargs
from tb.top.progress import Pass

PACKED_PIXEL_BYTES = 2
"""Bytes that a pixel of a packed frame takes in memory, about; for the progress bar."""


@dataclass(frozen=True)
class FrameRun:
    """One frame to play.

    Attributes:
        name: the run's name, for messages.
        image: the memory image with the frame's settings.
        speed: the memory's speed.
        reset: whether to reset the machine before the frame.
        poison: whether to fill memory with random data before the frame; otherwise it stays as the previous frame left it.
        changes: values of settings that replace those of the image, by register name.
        abort: the number of cycles after the start at which `control.abort` is written; None for never.
        cut: the number of cycles after the start at which the frame is abandoned, which a reset must follow; None to play it to
            the end.
        settle: the number of cycles between reset and start, for memories that the machine clears once after a reset.
        late: whether `abort` and `cut` count approximately from the start of the target eye's pass instead; this needs a
            machine with counters.
        expected: the expected work of each pass, for the progress bar; without it, the bar counts pixels only.
    """

    name: str
    image: MemoryImage
    speed: MemorySpeed = field(default_factory=MemorySpeed)
    reset: bool = True
    poison: bool = True
    changes: dict[str, int] = field(default_factory=dict)
    abort: int | None = None
    cut: int | None = None
    settle: int = 0
    late: bool = False
    expected: tuple[Pass, ...] = ()


@dataclass(frozen=True)
class FrameResult:
    """The results of a frame.

    Attributes:
        pixels: the frame in memory, whether complete or not, in the run's pixel format; for two eyes, the source eye's.
        error: the reason why the frame ended early, or NONE.
        done: whether the frame ended without an error.
        registers: control registers and counters at the end, by name; each 64-bit counter is one number.
        cycles: cycles from the answer to the start command until the interrupt.
        reads, writes: the numbers of beats that the memory counted.
        busy: the number of cycles in which the memory had a beat to transfer.
        activates, refreshes: the numbers of these commands of LPDDR3 channels; 0 with the ideal memory.
        idle_cycles: cycles from the reset, or from the end of the frame before, until the frame begins.
        seconds, cpu_seconds: wall time and processor time of the simulation.
        errors: descriptions of the violated rules.
        target: the target eye's frame, for frames of two eyes.
    """

    pixels: FramePixels | DisplayPixels | PackedPixels
    error: ErrorCode
    done: bool
    registers: dict[str, int]
    cycles: int
    reads: int
    writes: int
    busy: int
    seconds: float
    cpu_seconds: float
    errors: tuple[str, ...]
    target: FramePixels | DisplayPixels | PackedPixels | None = None
    activates: int = 0
    refreshes: int = 0
    idle_cycles: int = 0


def setting_writes(config: AcceleratorConfig, image: MemoryImage, changes: dict[str, int]) -> dict[str, int]:
    """The 32-bit value of every setting's register, by name and in order. Raises ValueError where a change names no setting."""
    values = {}
    for s in settings(config):
        raw = image.settings[s.field.name]
        raw = raw[s.index] if s.field.count > 1 else raw
        low, high = s.field.raw_range
        if not low <= raw <= high:
            raise ValueError(f"{s.name} must be in {low}..{high}, not {raw!r}")
        values[s.name] = raw
    unknown = changes.keys() - values.keys()
    if unknown:
        raise ValueError(f"changes must name settings, not {sorted(unknown)!r}")
    return {name: value & 0xFFFFFFFF for name, value in (values | changes).items()}


class Map:
    """The registers of a configuration by name; indexing gives a register's address."""

    def __init__(self, config: AcceleratorConfig):
        self.registers = {register.name: register for register in register_map(config)}

    def __getitem__(self, name: str) -> int:
        return self.registers[name].offset

    def value(self, name: str, **bits: int) -> tuple[int, int]:
        """Address and value of a register in which these bit fields have these values."""
        register = self.registers[name]
        places = {b.name: b for b in register.bits}
        return register.offset, sum(value << places[bit].low for bit, value in bits.items())

    def part(self, name: str, bits: str, value: int) -> int:
        """The value of a named bit field within a register's value."""
        found = next(b for b in self.registers[name].bits if b.name == bits)
        return (value & found.mask) >> found.low

    @property
    def observed(self) -> dict[str, int]:
        """Addresses of the registers that are read after a frame: control registers and counters."""
        first = self["control"]
        plain = [r for r in self.registers.values() if r.offset >= first and r.format is None]
        return {r.name: r.offset for r in plain}


def play_frames(
    machine: Machine, runs: Sequence[FrameRun], folder: Path, *, waves: Waves | None = None, progress: bool = False,
    watchdog: int = 200_000, start: int = 1,
) -> list[FrameResult]:
    """Plays `runs` in order in one simulation; all files stay in `folder`.

    Args:
        machine: the device under test.
        runs: the frames to play; all must have the same configuration.
        folder: the folder for images, frames, log and waves.
        waves: the waves to record, or None.
        progress: whether to show a progress bar.
        watchdog: a frame is given up after this many cycles in which nothing moves on the bus.
        start: the seed of the random bits with which an unknown machine (`Machine.unknown`) begins.

    Raises:
        SimulationError: the build or the simulation itself fails, which includes refused register accesses. Violated rules do
            not raise; they are in the results.
    """
    registers, folder = prepare(runs, folder, progress, watchdog)
    beats = memory_beats(max(run.image.beats for run in runs))
    simulate(
        machine.design(), "tb.top.frames", folder, waves=waves, env={"PLAYER_FOLDER": str(folder)},
        plusargs=[*plusargs(folder, beats), *(random_start(start) if machine.unknown else ())])
    return collect(registers, runs, folder)


def prepare(runs: Sequence[FrameRun], folder: Path, progress: bool, watchdog: int) -> tuple[Map, Path]:
    """Writes images and orders.json into the folder. Returns the registers and the folder's absolute path, because the
    simulator runs in it."""
    folder = folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    config = runs[0].image.config
    if any(run.image.config != config for run in runs):
        raise ValueError("runs must be of one configuration")
    registers, files = Map(config), {}
    orders = {
        "watchdog": watchdog, "progress": progress, "reads": registers.observed,
        "frames": [_orders(registers, run, number, files, folder) for number, run in enumerate(runs)]}
    (folder / "orders.json").write_text(json.dumps(orders))
    (folder / "report.json").unlink(missing_ok=True)
    return registers, folder


def collect(registers: Map, runs: Sequence[FrameRun], folder: Path) -> list[FrameResult]:
    """Reads the results from report.json and the frames' dumps, and deletes the large files."""
    items = json.loads((folder / "report.json").read_text())
    results = [
        _result(registers, run, item, folder / f"{number}.dump")
        for number, (run, item) in enumerate(zip(runs, items, strict=True))]
    for path in (*folder.glob("*.bin"), *folder.glob("*.dump")):
        path.unlink()
    return results


def _orders(registers: Map, run: FrameRun, number: int, files: dict[int, int], folder: Path) -> dict[str, object]:
    image, frame = run.image, run.image.frames
    loads = []
    for name, rows in image.contents.items():
        if not len(rows):
            continue
        if id(rows) not in files:
            files[id(rows)] = len(files)
            image.write(name, folder / f"{files[id(rows)]}.bin")
        region = image.regions[name]
        loads.append((files[id(rows)], region.base, region.beats, run.poison and not loads))
    enables = {"enable_done": 1, "enable_error": 1}
    return {
        "name": run.name, "reset": run.reset, "abort": run.abort, "cut": run.cut,
        "settle": run.settle, "late": registers["cycles_target_low"] if run.late else None,
        "passes": [asdict(item) for item in run.expected or (_pixels_only(image),)],
        "pixel_bytes": image.pixel_bytes or PACKED_PIXEL_BYTES, "loads": loads, "dump": (number, frame.base, frame.beats),
        "memory": {
            **run.speed.signals, "first_writable": BEAT_BYTES * image.first_writable,
            "watch_first": BEAT_BYTES * frame.base, "watch_end": BEAT_BYTES * frame.end},
        "writes": [
            *((registers[name], value) for name, value in setting_writes(image.config, image, run.changes).items()),
            registers.value("control", clear=1, **enables), registers.value("control", start=1, **enables)],
        "abort_write": registers.value("control", abort=1, **enables),
        "last_writes": [registers.value("interrupt", done=1, error=1)],
    }


def _error(registers: Map, value: int) -> ErrorCode:
    """The error of a frame that was alone in the machine, which may have two, for a frame in each phase."""
    return ErrorCode(registers.part("error", "code", value) or registers.part("error", "first_code", value))


def _pixels_only(image: MemoryImage) -> Pass:
    pixels = image.width * image.height * (2 if "target_frame" in image.regions else 1)
    return Pass(0, 0, pixels, pixels)


def _result(registers: Map, run: FrameRun, item: dict, dump: Path) -> FrameResult:
    errors = list(broken_rules(item["errors"]))
    if item["end"] == "stuck":
        errors.append("nothing moved on the bus for the length of the watchdog")
    values = dict(item["registers"])
    for low in [name for name in values if name.endswith("_low")]:
        name = low.removesuffix("_low")
        values[name] = values.pop(low) | values.pop(f"{name}_high") << 32
    return FrameResult(
        run.image.frame(dump), _error(registers, values.get("error", 0)),
        bool(registers.part("status", "done", values.get("status", 0))), values, item["cycles"], item["reads"], item["writes"],
        item["busy"], item["seconds"], item["cpu_seconds"], tuple(errors), run.image.target_frame(dump),
        item["activates"], item["refreshes"], item["idle_cycles"])
