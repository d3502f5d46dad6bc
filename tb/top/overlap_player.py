"""Plays frames in a row through a machine whose phases overlap: each frame starts as soon as the machine takes it, while the
frame before is rendered.

What a frame has in memory lies at one of two places in turn (`golden.host.two_frames`). Counters add up over the row, so that a
frame's events are the difference between two readings.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from golden.host.memory_image import DisplayPixels, FramePixels, MemoryImage, PackedPixels
from golden.host.two_frames import in_turn
from spec.codes import ErrorCode
from spec.memory import BEAT_BYTES
from spec.registers import events
from tb.common.runner import Waves, simulate
from tb.top.device import Machine
from tb.top.memory import MemorySpeed, broken_rules, memory_beats, plusargs
from tb.top.planned import PlannedFrame
from tb.top.player import Map, setting_writes


@dataclass(frozen=True)
class Row:
    """Frames in a row.

    Attributes:
        name: the row's name, for messages.
        frames: the frames, whose runs are those of frames alone. Of these, `image`, `changes` and `abort` matter: the number of
            cycles after the start of the frame, and of the next settings' writes, at which `control.abort` is written.
        speed: the memory's speed.
        failing: number of a frame and name of a region of it that memory answers with errors; None for none.
        reset: whether the machine is reset before the row.
        cut: the number of cycles after the last frame's start at which the row is abandoned, which a reset must follow.
    """

    name: str
    frames: Sequence[PlannedFrame]
    speed: MemorySpeed = field(default_factory=MemorySpeed)
    failing: tuple[int, str] | None = None
    reset: bool = True
    cut: int | None = None


@dataclass(frozen=True)
class RowFrame:
    """A frame of a row as it ended: its pixels, its error, its events by name, the registers after it, the cycle in which it
    was started, and of frames of two eyes the target eye's pixels."""

    pixels: FramePixels | DisplayPixels | PackedPixels
    error: ErrorCode
    events: dict[str, int]
    registers: dict[str, int]
    begun: int
    target: FramePixels | DisplayPixels | PackedPixels | None = None


@dataclass(frozen=True)
class RowResult:
    """The results of a row: its frames, none where it was cut off; violated rules; and beats that memory counted."""

    frames: tuple[RowFrame, ...]
    errors: tuple[str, ...]
    reads: int
    writes: int


def play_rows(
    machine: Machine, rows: Sequence[Row], folder: Path, *, waves: Waves | None = None, watchdog: int = 200_000,
) -> list[RowResult]:
    """Plays rows one after the other in one simulation; all files stay in `folder`.

    Raises:
        SimulationError: the build or the simulation itself fails, or nothing moves on the bus for `watchdog` cycles.
    """
    folder = folder.resolve()
    folder.mkdir(parents=True, exist_ok=True)
    config = rows[0].frames[0].run.image.config
    registers, files = Map(config), {}
    placed = [in_turn([item.run.image for item in row.frames]) for row in rows]
    orders = {
        "watchdog": watchdog, "reads": registers.observed, "ready": registers.value("status", ready=1)[1],
        "rows": [_orders(registers, row, *place, files, folder) for row, place in zip(rows, placed, strict=True)]}
    (folder / "orders.json").write_text(json.dumps(orders))
    beats = memory_beats(max(image.beats for images, _ in placed for image in images))
    simulate(machine.design(), "tb.top.overlap_frames", folder, waves=waves, env={"PLAYER_FOLDER": str(folder)},
             plusargs=plusargs(folder, beats))
    report = json.loads((folder / "report.json").read_text())
    results = [_result(registers, row, images, item, folder, order["frames"]) for row, (images, _), item, order in zip(
        rows, placed, report, orders["rows"], strict=True)]
    for path in (*folder.glob("*.bin"), *folder.glob("*.dump")):
        path.unlink()
    return results


def outcome(code: ErrorCode, first_code: ErrorCode, place: int, together: int) -> ErrorCode:
    """How a frame ended, from the register `error` behind its end.

    Two frames that were stopped together both have a code. Otherwise at most one frame has one, the last one that ended; a
    BAD_SETTING belongs to none that began.

    Args:
        code, first_code: the parts of the register.
        place: number of the frame among those that the host found to have ended, in their order.
        together: how many these are; 0 for a start that was refused.
    """
    if together == 0:
        return first_code
    if together == 2 and code and first_code:
        return (code, first_code)[place]
    if place < together - 1 or first_code is ErrorCode.BAD_SETTING:
        return ErrorCode.NONE if place < together - 1 else code
    return code or first_code


def _orders(
    registers: Map, row: Row, images: list[MemoryImage], first_writable: int, files: dict[int, int], folder: Path,
) -> dict[str, object]:
    speed, enables = row.speed, {"enable_done": 1, "enable_error": 1}
    if row.failing is not None:
        base, beats = images[row.failing[0]].regions[row.failing[1]]
        speed = replace(speed, failing=(BEAT_BYTES * base, BEAT_BYTES * (base + beats)))
    return {
        "reset": row.reset, "cut": row.cut,
        "memory": {**speed.signals, "first_writable": BEAT_BYTES * first_writable, "watch_first": 0, "watch_end": 0},
        "frames": [_frame_orders(item, image, files, folder) for item, image in zip(row.frames, images, strict=True)],
        "first_writes": [registers.value("interrupt", done=1, error=1), registers.value("control", clear=1, **enables)],
        "start_write": registers.value("control", start=1, **enables),
        "abort_write": registers.value("control", abort=1, **enables),
        "last_writes": [registers.value("interrupt", done=1, error=1)]}


def _frame_orders(item: PlannedFrame, image: MemoryImage, files: dict[int, int], folder: Path) -> dict[str, object]:
    loads, addresses = [], Map(image.config)
    for name, contents in image.contents.items():
        if len(contents):
            if id(contents) not in files:
                files[id(contents)] = len(files)
                image.write(name, folder / f"{files[id(contents)]}.bin")
            loads.append((files[id(contents)], image.regions[name].base, image.regions[name].beats))
    number = len(list(folder.glob("*.order")))
    (folder / f"{number}.order").touch()
    return {
        "loads": loads, "dump": (number, image.frames.base, image.frames.beats), "abort": item.run.abort,
        "refused": item.error is ErrorCode.BAD_SETTING,
        "settings": [(addresses[name], value) for name, value in setting_writes(image.config, image, item.run.changes).items()]}


def _result(
    registers: Map, row: Row, images: list[MemoryImage], item: dict, folder: Path, orders: list[dict],
) -> RowResult:
    errors, config = broken_rules(item["errors"]), images[0].config
    if row.cut is not None:
        return RowResult((), errors, item["reads"], item["writes"])
    frames, before = [], dict.fromkeys(events(config), 0)
    for image, found, order in zip(images, item["frames"], orders, strict=True):
        values = found["registers"]
        error = outcome(*(ErrorCode(registers.part("error", part, values["error"])) for part in ("code", "first_code")),
                        found["place"], found["together"])
        now = {name: values[name] for name in before}
        dump = folder / f"{order['dump'][0]}.dump"
        frames.append(RowFrame(image.frame(dump), error, {name: now[name] - before[name] for name in now}, values,
                               found["begun"], image.target_frame(dump)))
        before = now
    return RowResult(tuple(frames), errors, item["reads"], item["writes"])
