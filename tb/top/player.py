"""Playing frames through the machine: memory images to files, one simulation for all of them, frames and counters back."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from golden.host.memory_image import DisplayPixels, FramePixels, MemoryImage
from spec.config import AcceleratorConfig
from spec.host_settings import settings
from spec.memory import BEAT_BYTES
from spec.registers import ErrorCode, register_map
from tb.common.runner import Waves, simulate
from tb.top.device import Machine
from tb.top.memory import MemorySpeed, broken_rules, memory_beats, plusargs


@dataclass(frozen=True)
class FrameRun:
    """One frame to play.

    Attributes:
        name: for messages.
        image: memory and settings.
        speed: of the memory.
        reset: reset before the frame.
        poison: fill memory with garbage before the frame; without, it is as the last frame left it.
        changes: settings written instead of the image's, by register name.
        abort: cycles after the start at which `control.abort` is written; None: never.
        cut: cycles after the start at which the frame is left, for a following one with `reset`; None: played to the end.
        settle: cycles from the reset to the start; what is cleared once after a reset is then clear.
        late: `abort` and `cut` count from the target eye's pass on instead, give or take some; with counters alone.
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


@dataclass(frozen=True)
class FrameResult:
    """What a frame gave.

    Attributes:
        pixels: the frame, whatever its state, in the format that the run asks for; of two eyes, the source's.
        error: why it ended early, or NONE.
        done: it ended well.
        registers: control registers and counters at the end, by name; 64-bit counters as one number.
        cycles: from the start's answer to the interrupt.
        reads, writes: beats that memory saw.
        busy: cycles in which memory had a beat to move.
        seconds, cpu_seconds: of the simulation, wall and the processor's.
        errors: broken rules, in words.
        target: the target eye's frame, of frames of two.
    """

    pixels: FramePixels | DisplayPixels
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
    target: DisplayPixels | None = None


def setting_writes(config: AcceleratorConfig, image: MemoryImage, changes: dict[str, int]) -> dict[str, int]:
    """32-bit values of every setting's register, by name, in order; ValueError where a change names none."""
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
    """The registers of a configuration, by name."""

    def __init__(self, config: AcceleratorConfig):
        self.registers = {register.name: register for register in register_map(config)}

    def __getitem__(self, name: str) -> int:
        return self.registers[name].offset

    def value(self, name: str, **bits: int) -> tuple[int, int]:
        """Address and value of a register with these bits set."""
        register = self.registers[name]
        places = {b.name: b for b in register.bits}
        return register.offset, sum(value << places[bit].low for bit, value in bits.items())

    def part(self, name: str, bits: str, value: int) -> int:
        """The named bits of a register's value."""
        found = next(b for b in self.registers[name].bits if b.name == bits)
        return (value & found.mask) >> found.low

    @property
    def observed(self) -> dict[str, int]:
        """Addresses of what is read after a frame: control registers and counters."""
        first = self["control"]
        plain = [r for r in self.registers.values() if r.offset >= first and r.format is None]
        return {r.name: r.offset for r in plain}


def play_frames(
    machine: Machine, runs: Sequence[FrameRun], folder: Path, *, waves: Waves | None = None, progress: bool = False,
    watchdog: int = 200_000,
) -> list[FrameResult]:
    """Plays `runs` in order in one simulation; files stay in `folder`.

    Args:
        machine: the device under test.
        runs: what to play; all of one configuration.
        folder: where images, frames, log and waves go.
        waves: record these.
        progress: show a bar.
        watchdog: cycles without anything moving on the bus after which a frame is given up.

    Raises:
        SimulationError: the build or the simulation itself fails, a register access is refused among that; broken rules are in
            the results.
    """
    registers, folder = prepare(runs, folder, progress, watchdog)
    beats = memory_beats(max(run.image.beats for run in runs))
    simulate(
        machine.design(), "tb.top.frames", folder, waves=waves, env={"PLAYER_FOLDER": str(folder)},
        plusargs=plusargs(folder, beats))
    return collect(registers, runs, folder)


def prepare(runs: Sequence[FrameRun], folder: Path, progress: bool, watchdog: int) -> tuple[Map, Path]:
    """Images and orders.json into the folder; the registers, and the folder's full name: the simulator runs in it."""
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
    """Results from report.json and the frames' dumps; the large files go."""
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
        "pixels": image.width * image.height * (2 if "target_frame" in image.regions else 1),
        "pixel_bytes": image.pixel_bytes, "loads": loads, "dump": (number, frame.base, frame.beats),
        "memory": {
            **run.speed.signals, "first_writable": BEAT_BYTES * image.regions["views"].base,
            "watch_first": BEAT_BYTES * frame.base, "watch_end": BEAT_BYTES * frame.end},
        "writes": [
            *((registers[name], value) for name, value in setting_writes(image.config, image, run.changes).items()),
            registers.value("control", clear=1, **enables), registers.value("control", start=1, **enables)],
        "abort_write": registers.value("control", abort=1, **enables),
        "last_writes": [registers.value("interrupt", done=1, error=1)],
    }


def _result(registers: Map, run: FrameRun, item: dict, dump: Path) -> FrameResult:
    errors = list(broken_rules(item["errors"]))
    if item["end"] == "stuck":
        errors.append("nothing moved on the bus for the length of the watchdog")
    values = dict(item["registers"])
    for low in [name for name in values if name.endswith("_low")]:
        name = low.removesuffix("_low")
        values[name] = values.pop(low) | values.pop(f"{name}_high") << 32
    return FrameResult(
        run.image.frame(dump), ErrorCode(registers.part("error", "code", values.get("error", 0))),
        bool(registers.part("status", "done", values.get("status", 0))), values, item["cycles"], item["reads"], item["writes"],
        item["busy"], item["seconds"], item["cpu_seconds"], tuple(errors), run.image.target_frame(dump))
