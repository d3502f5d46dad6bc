"""`msv2 study run drain_waits`: measures the cycles in which the end of a tile waits for free space in the array's
output buffer, for several kinds of buffer.

The study simulates the array and the pixel writer behind it on frames of real scenes, and compares every beat of memory. Memory
is either ideal, with one entry and one beat of pixels per cycle, or shared. A shared memory moves 25.6 bytes per cycle. An
entry takes 8 of them for its place in the list, and a beat for its splat record except for one entry in ENTRIES_A_HIT. Pixels
have priority.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from golden.msv2_ref.frame_memory import frame_pixels
from golden.msv2_ref.pipeline import Frame
from msv2.studies.page import table
from rtl.emit import to_verilog
from rtl.shapes import layout
from rtl.vrc_array.array import VrcArray
from rtl.vrc_array.pixel_writer import PixelWriter
from spec.command_line import command_parser
from spec.config import PAPER_SMALL, AcceleratorConfig
from spec.constants import ENTRY_BYTES, TILE
from spec.memory import BEAT_BYTES, DRAM_BYTES_PER_CYCLE, write_request
from spec.overrides import add_config_arguments, config_from
from spec.paths import ROOT
from spec.private import private_folder
from spec.queues import COUNTER_BITS
from spec.records import array_splat, frame_tiles, tile_header
from tb.common.exact import Planned, planned, run_plan
from tb.common.playback import Playback, Stream
from tb.common.scenes import traced_frames
from tb.vrc_array.array_device import background_bits
from tb.vrc_array.pixel_writer_stimuli import rows_of, writes_of

MACHINE = PAPER_SMALL.name
"""The machine if no other one is asked for: one whose array takes whole tiles."""

ENTRIES_A_HIT = 8
"""One entry in this many finds its splat record in the cache, which is about what frames of real scenes show."""

_UNIT = round(10 * BEAT_BYTES)
_ENTRY = round(10 * (ENTRY_BYTES + BEAT_BYTES * (1 - 1 / ENTRIES_A_HIT)))
_CYCLE = round(10 * DRAM_BYTES_PER_CYCLE)
_OBSERVED = ("ops", "skipped", "waits", "pixels")


class ArrayAndWriter(wiring.Component):
    """The array and the pixel writer. Where `limited` is set, both share the bytes of the memory."""

    def __init__(self, config: AcceleratorConfig, lines: int | None):
        self.config, self._array = config, VrcArray(config, lines=lines)
        super().__init__({
            "tiles": In(stream.Signature(layout(tile_header(config)))),
            "entries": In(stream.Signature(layout(array_splat(config)))),
            "writes": Out(stream.Signature(layout(write_request(config)))),
            "background": In(3 * config.formats.colour.width),
            "width": In(14), "height": In(14), "tile_count": In(range(frame_tiles(config) + 1)), "limited": In(1),
            **{name: Out(COUNTER_BITS) for name in _OBSERVED}, "finished": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.array = array = self._array
        m.submodules.writer = writer = PixelWriter(self.config)
        wiring.connect(m, wiring.flipped(self.tiles), array.tiles)
        wiring.connect(m, array.pixels, writer.rows)
        bytes_left = Signal(range(16 * _UNIT))  # in tenths of bytes
        pays_write, pays_entry = ~self.limited | (bytes_left >= _UNIT), Signal()
        wrote, entered = self.writes.valid & self.writes.ready, self.entries.valid & self.entries.ready
        m.d.comb += [
            pays_entry.eq(~self.limited | (bytes_left >= Mux(writer.writes.valid, _UNIT, 0) + _ENTRY)),
            self.writes.payload.eq(writer.writes.payload),
            self.writes.valid.eq(writer.writes.valid & pays_write),
            writer.writes.ready.eq(self.writes.ready & pays_write),
            array.entries.payload.eq(self.entries.payload),
            array.entries.valid.eq(self.entries.valid & pays_entry),
            self.entries.ready.eq(array.entries.ready & pays_entry),
            array.background.eq(self.background),
            *(getattr(writer, name).eq(getattr(self, name)) for name in ("width", "height", "tile_count")),
            *(getattr(self, name).eq(getattr(array, name)) for name in ("ops", "skipped", "waits")),
            writer.writes_idle.eq(1), self.pixels.eq(writer.pixels), self.finished.eq(writer.finished),
        ]
        rest = bytes_left - Mux(wrote, _UNIT, 0) - Mux(entered, _ENTRY, 0) + _CYCLE
        m.d.sync += bytes_left.eq(Mux(~self.limited, 0, Mux(rest >= 12 * _UNIT, 12 * _UNIT, rest)))
        return m


def buffers(config: AcceleratorConfig) -> Iterator[tuple[str, AcceleratorConfig, int | None]]:
    """The name, the machine and the number of rows of each kind of buffer."""
    yield f"least, {config.cores_y} rows", config, None
    yield f"{2 * config.cores_y} rows", config, 2 * config.cores_y
    yield "two whole tiles", config.with_(incremental=False), None


def playback(config: AcceleratorConfig, lines: int | None) -> Playback:
    """The array and the writer, emitted as Verilog, with a file at each stream."""
    sizes = (("width", 14), ("height", 14), ("tile_count", frame_tiles(config).bit_length()), ("limited", 1))
    return Playback(
        name=f"drains-{config.cores_x}x{config.cores_y}", module="array_and_writer",
        verilog=to_verilog(ArrayAndWriter(config, lines), "array_and_writer"),
        inputs=(Stream("tiles", tile_header(config)), Stream("entries", array_splat(config))),
        outputs=(Stream("writes", write_request(config)),),
        settings=(("background", 3 * config.formats.colour.width), *sizes),
        observed=(*((name, COUNTER_BITS) for name in _OBSERVED), ("finished", 1)), apart=("pixel_core",))


def plan_of(frames: dict[str, Frame]) -> list[Planned]:
    """Every frame, with ideal and with shared memory."""
    plan = []
    for name, frame in frames.items():
        r, pixels = frame.registers, frame_pixels(frame)
        rows = rows_of(frame.config, pixels, np.random.default_rng(0))
        for shared in (0, 1):
            plan.append(planned(
                f"{name}, {('ideal', 'shared')[shared]} memory", {"tiles": frame.headers, "entries": frame.array_entries},
                {"writes": writes_of(frame.config, pixels, rows, 0)},
                settings={
                    "background": background_bits(frame.config, r.background), "width": r.width, "height": r.height,
                    "tile_count": -(-r.width // TILE) * -(-r.height // TILE), "limited": shared},
                observed={"finished": 1, "pixels": r.width * r.height if frame.config.counters else 0}))
    return plan


def measure(config: AcceleratorConfig, size: str, folder: Path) -> tuple[list[tuple[str, ...]], bool]:
    """The rows of the table, and whether every bit was right."""
    plan, lines, right = plan_of(traced_frames(config, size)), [], True
    for kind, machine, rows in buffers(config):
        with private_folder(folder / kind.replace(" ", "-").replace(",", "")) as place:
            outcome = run_plan(playback(machine, rows), plan, place)
        right &= not outcome.failures
        for item in plan:
            recording, entries = outcome.recordings[item.name], len(item.run.inputs["entries"])
            seen = recording.observed
            lines.append((item.name, kind, f"{entries:,}", f"{seen['ops']:,}", f"{seen['skipped']:,}",
                          f"{recording.cycles:,}", f"{seen['waits']:,}", "" if item.name in outcome.failures else "equal"))
    return sorted(lines), right


def main(argv: Sequence[str] | None = None) -> int:
    """Prints the table; returns 1 when a bit differs."""
    parser = command_parser("msv2 study run drain_waits", __doc__.split("\n\n")[0])
    add_config_arguments(parser, MACHINE)
    parser.add_argument("--size", default="160x96", metavar="WxH", help="size of the frames, at least 50x40 (default: 160x96)")
    args = parser.parse_args(argv)
    config = config_from(args, MACHINE)
    lines, right = measure(config, args.size, ROOT / "build" / "drains" / config.name)
    print(table(("frame", "buffer", "entries", "ops", "skipped", "cycles", "of them waited", "bits"), lines))
    return 0 if right else 1
