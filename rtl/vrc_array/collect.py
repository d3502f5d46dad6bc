"""Collection of finished rows: takes the rows of a drain, one per cycle, blends their levels, and buffers them for the output.

The rows of cores work one cycle behind each other, so that at most one row of pixels finishes in a cycle. Nothing in the array
can wait. A drain is therefore issued at least `cores_y` cycles after the previous one, and only if the buffer has free space
for all of its rows.

The rows of one drain are thus the least that the buffer must hold; with 16 rows of cores this is a tile. Less would do only if
finished pixels could stay in their cores. The cores have no second set of sums, so the first op of the next tile would have to
wait until each row has left, and the whole array would stand still meanwhile. With a buffer the array already works on the next
tile.

The machine with line buffers needs only this minimum, and its rows leave as they arrive. The baseline has a double buffer,
whose halves are handed over as whole tiles. The minimum, half the storage of the double buffer, costs no time while memory
limits a frame. It costs cycles where intersections arrive at one per cycle and tiles have few of them
(`msv2 study run drain_waits`). `lines` may therefore be larger, and the full machine makes use of that.

The place of a row (tile, position, blend weights) travels beside the array for as long as its pixels travel in it::

    cycle from a drain's strobe    0   1     E + P + 1     E + P + L + 1 E + P + L + 3
    draining                       ~~~~
    place of row 0                     <  >
    transmittance of row 0                   <      >
    sums of row 0                                          <      >
    both, row multiplexer passed                                         <      >     place and weights arrive beside them

where E is the latency of `expand`, and P and L are the row's PIPELINE and SUMS_LATER. Blending (if there are levels) and the
buffer follow.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from operator import or_
from typing import Any

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.pipeline import Pipeline, Staged
from rtl.shapes import layout, shape
from rtl.vrc_array import expand
from rtl.vrc_array.blend import BLEND_LATENCY, Blend, BlendWeights, weights_latency
from rtl.vrc_array.pixel_core import pixel_layout
from rtl.vrc_array.row import PIPELINE, SUMS_LATER
from spec.config import AcceleratorConfig
from spec.records import TILE_BITS, pixel_row
from spec.supertiles import SEQUENCE_BITS

_FAN_IN = 4
"""Rows that one stage of the row multiplexer combines."""


def _place(config: AcceleratorConfig) -> tuple[str, ...]:
    """The fields of a row that say where it lies."""
    return ("tile_x", "tile_y", "row", "column", *(["eye"] if config.joint else []))


def place_latency(config: AcceleratorConfig) -> int:
    """Cycles by which the place of a row is delayed to meet its pixels."""
    return expand.latency(config) + PIPELINE + SUMS_LATER + 2


def place_layout(config: AcceleratorConfig) -> data.StructLayout:
    """What the collection must know of a tile: its position, and the plane of its blend weights."""
    return data.StructLayout({
        "tile_x": TILE_BITS,
        "tile_y": TILE_BITS,
        "blend": 1,
        "plane": data.ArrayLayout(shape(config.formats.plane), 3),
        **({"sequence": SEQUENCE_BITS} if config.supertiles else {}),  # the super-tile
        **({"eye": 1} if config.joint else {}),
    })


def finished_row(config: AcceleratorConfig) -> wiring.Signature:
    """A row of cores as the collection sees it; `rtl.vrc_array.row` states when each signal is valid."""
    pixel = data.ArrayLayout(pixel_layout(config), config.level_banks)
    return wiring.Signature({
        "draining": Out(1),
        "drained": Out(1),
        "pixels": Out(data.ArrayLayout(pixel, config.array_x)),
    })


class Collect(wiring.Component):
    """Turns the finished rows of the array into a stream of pixel rows.

    Parameters:
        config: the machine; `incremental` selects the kind of buffer.
        lines: rows of the line buffer, at least cores_y, for which None stands. With another cores_y rows, or with a tile's
            height if that is more, drains follow each other without a pause as long as pixels are taken at once. The double
            buffer always holds two tiles.

    Ports:
        draining: strobe; a drain is issued. `may_drain` must be high.
        may_drain: a drain may be issued in this cycle.
        places: one word for each tile; it must be there before the tile's first drain, and is taken with its last row.
        rows: the rows of cores.
        pixels: pixel rows, in the order of drains and rows.
        busy: rows are under way or in the buffer.

    Storage: for 16 x 16 cores with depth `lines` = 16 rows of 1,292 bits; 32 rows in the double buffer. Throughput: one row per
    cycle. Latency from `draining` to the first pixel row: place_latency + 1 cycles, BLEND_LATENCY more with levels, and 2 more
    for the buffer; the double buffer delivers a tile's first row only when its last row is in.
    """

    def __init__(self, config: AcceleratorConfig, *, lines: int | None = None):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        if lines is not None and (not isinstance(lines, int) or isinstance(lines, bool)):
            raise TypeError(f"lines must be an integer or None, not {lines!r}")
        if lines is not None and not config.incremental:
            raise ValueError(f"lines must be None where the buffer holds two tiles, not {lines!r}")
        if lines is not None and lines < config.array_y:
            raise ValueError(f"lines must be at least {config.array_y}, not {lines!r}")
        self.config, self.tile_rows = config, config.region**2 // config.array_x
        self.lines = (config.array_y if lines is None else lines) if config.incremental else 2 * self.tile_rows
        super().__init__(self._ports())

    def _ports(self) -> dict[str, wiring.Member]:
        config = self.config
        return {
            "draining": In(1),
            "may_drain": Out(1),
            "places": In(stream.Signature(place_layout(config))),
            "rows": In(finished_row(config)).array(config.array_y),
            "pixels": Out(stream.Signature(layout(pixel_row(config)))),
            "busy": Out(1),
        }

    def elaborate(self, platform: object) -> Module:
        m = Module()
        self._deliver(m, self._places(m))
        return m

    def _deliver(self, m: Module, place: dict[str, Staged]) -> data.View:
        """Blends the rows whose place is valid, buffers them, and says when a drain may be issued. Returns the rows before
        blending, place_latency cycles after the start of their place."""
        end = place_latency(self.config)
        valid = place["valid"].at(end)
        pixels = self._picked(m)
        if self.config.level_banks == 2:
            mixed = self._blended(m, place, valid, pixels)
            end += BLEND_LATENCY
        else:
            mixed = [lane[0] for lane in pixels]
        room, shown = Signal(), Signal()
        comes, leaves = place["valid"].at(end), self.pixels.valid & self.pixels.ready
        if self.config.incremental:
            self._claim_rows(m, room, shown, leaves)
        else:
            self._claim_tiles(m, room, shown, comes, leaves)
        wait = Signal(range(self.config.array_y))
        self._admit(m, room, wait == 0)
        m.d.sync += wait.eq(Mux(self.draining, self.config.array_y - 1, wait - wait.any()))
        self._buffer(m, {name: place[name].at(end) for name in ("valid", *_place(self.config))}, mixed, shown)
        return pixels

    def _admit(self, m: Module, room: Value, apart: Value) -> None:
        """Says whether a drain may be issued: `room` is free in the buffer, and it is far enough from the drain before."""
        m.d.comb += self.may_drain.eq(room & apart)

    def _claims(self) -> Value:
        """Whether a drain is issued whose rows need space in the buffer."""
        return self.draining

    def _in_tile(self, place: Value, axis: int) -> Value:
        """A row (`axis` 1) or column (0) of the array's part of the tile as one of the tile."""
        return place

    def _valid(self, m: Module, p: Pipeline, running: Value, head: data.View) -> dict[str, Staged]:
        """Whether the row under way leaves as pixels, as `valid`."""
        return {"valid": p.control("valid", running)}

    def _claim_rows(self, m: Module, room: Signal, shown: Signal, leaves: Value) -> None:
        """Each drain claims space for its rows; the space of a row is free again when the row leaves."""
        rows, free = self.config.array_y, Signal(range(self.lines + 1), init=self.lines)
        m.d.comb += [room.eq(free >= rows), shown.eq(1), self.busy.eq(free != self.lines)]
        m.d.sync += free.eq(free - Mux(self._claims(), rows, 0) + leaves)

    def _claim_tiles(self, m: Module, room: Signal, shown: Signal, comes: Value, leaves: Value) -> None:
        """A tile's first drain claims a half. The half is shown when its last row is in, and free when that row has left."""
        free, whole, block = Signal(range(3), init=2), Signal(range(3)), Signal(range(self.config.blocks))
        came, left = Signal(range(self.tile_rows)), Signal(range(self.tile_rows))
        claims, fills, frees = Signal(), Signal(), Signal()
        m.d.comb += [
            room.eq(free.any() | block.any()),
            shown.eq(whole.any()),
            self.busy.eq(free != 2),
            claims.eq(self._claims() & ~block.any()),
            fills.eq(comes & (came == self.tile_rows - 1)),
            frees.eq(leaves & (left == self.tile_rows - 1)),
        ]
        m.d.sync += [
            # numbers of rows are powers of two, so the counters wrap
            free.eq(free - claims + frees), whole.eq(whole + fills - frees),
            came.eq(came + comes), left.eq(left + leaves), block.eq(block + self._claims())]

    def _places(self, m: Module) -> dict[str, Staged]:
        """The place of each row of a drain, starting in the cycle after the strobe."""
        config, head = self.config, self.places.payload
        running, row = Signal(), Signal(range(config.array_y))
        column, block_row = Signal(range(config.region // config.array_x)), Signal(range(config.region // config.array_y))
        row_ends = running & (row == config.array_y - 1)
        column_ends, tile_ends = column == config.region // config.array_x - 1, block_row == config.region // config.array_y - 1
        m.d.comb += self.places.ready.eq(row_ends & column_ends & tile_ends)
        m.d.sync += [running.eq(self.draining | running & ~row_ends), row.eq(Mux(running & ~row_ends, row + 1, 0))]
        with m.If(row_ends):
            m.d.sync += column.eq(Mux(column_ends, 0, column + 1))
            with m.If(column_ends):
                m.d.sync += block_row.eq(Mux(tile_ends, 0, block_row + 1))
        p = Pipeline(m, load=running)
        fields = {
            "tile_x": head.tile_x, "tile_y": head.tile_y, "row": self._in_tile(Cat(row, block_row), 1),
            "column": self._in_tile(Cat(Const(0, (config.array_x - 1).bit_length()), column), 0),
        }
        if config.joint:
            fields["eye"] = head.eye
        place = {name: p.data(name, value) for name, value in fields.items()}
        if config.level_banks == 2:
            place |= {"blend": p.data("blend", head.blend), "plane": p.data("plane", head.plane)}
        return {**self._valid(m, p, running, head), **place}

    def _picked(self, m: Module) -> data.View:
        """The pixels of the row that finishes, after two stages of multiplexing; transmittances are delayed to their sums."""
        def cat(pick: Callable[[Any], Value]) -> list[Value]:
            return [Cat(pick(bank) for lane in row.pixels for bank in lane) for row in self.rows]

        t = self._joined(m, "t", [row.draining for row in self.rows], cat(lambda pixel: pixel.transmittance))
        later = t
        for cycle in range(SUMS_LATER):
            t, later = later, Signal.like(t, name=f"t_later{cycle + 1}", reset_less=True)
            m.d.sync += later.eq(t)
        sums = self._joined(m, "sums", [row.drained for row in self.rows], cat(lambda pixel: Cat(*pixel.colour, pixel.depth)))
        shape, t_width = self.rows[0].pixels.shape(), len(self.rows[0].pixels[0][0].transmittance)
        picked, sum_width = Signal(shape, name="picked"), len(self.rows[0].pixels[0][0].as_value()) - t_width
        for i, pixel in enumerate(bank for lane in picked for bank in lane):
            m.d.comb += pixel.as_value().eq(Cat(sums.word_select(i, sum_width), later.word_select(i, t_width)))
        return picked

    def _joined(self, m: Module, name: str, strobes: list[Value], values: list[Value]) -> Signal:
        """The value whose strobe is high, two cycles later."""
        groups = []
        for i in range(0, len(values), _FAN_IN):
            group = Signal(len(values[0]), name=f"{name}_group_{i // _FAN_IN}", reset_less=True)
            pairs = zip(strobes[i : i + _FAN_IN], values[i : i + _FAN_IN], strict=True)
            m.d.sync += group.eq(reduce(or_, (Mux(strobe, value, 0) for strobe, value in pairs)))
            groups.append(group)
        joined = Signal(len(values[0]), name=name, reset_less=True)
        m.d.sync += joined.eq(reduce(or_, groups))
        return joined

    def _blended(self, m: Module, place: dict[str, Any], valid: Value, pixels: data.View) -> list[data.View]:
        """One blended pixel per column, BLEND_LATENCY cycles later."""
        m.submodules.weights = weights = BlendWeights(self.config)
        m.submodules.blend = blend = Blend(self.config)
        start = place_latency(self.config) - weights_latency(self.config)
        for name in ("valid", "blend", "plane", "row", "column"):
            m.d.comb += getattr(weights, name).eq(place[name].at(start))
        m.d.comb += [blend.valid.eq(valid), blend.weights.eq(weights.weights), blend.pixels.eq(pixels)]
        return list(blend.mixed)

    def _buffer(self, m: Module, place: dict[str, Any], mixed: list[data.View], shown: Signal) -> None:
        """Adds the buffer. Its first row is offered while `shown` is high; values that `config` leaves out are not stored."""
        members = dict(self.pixels.payload.shape())
        if not self.config.depth:
            del members["depth"]
        stored = data.StructLayout({name: field.shape for name, field in members.items()})
        # One of its words is the output register
        m.submodules.lines = lines = SyncFIFOBuffered(width=stored.size, depth=self.lines + 1)
        word = Signal(stored)
        m.d.comb += [word[name].eq(place[name]) for name in _place(self.config)]
        for x, pixel in enumerate(mixed):
            m.d.comb += [word.colour[3 * x + c].eq(pixel.colour[c]) for c in range(3)]
            m.d.comb += word.transmittance[x].eq(pixel.transmittance)
            if self.config.depth:
                m.d.comb += word.depth[x].eq(pixel.depth)
        out = data.View(stored, lines.r_data)
        m.d.comb += [lines.w_data.eq(word), lines.w_en.eq(place["valid"])]
        m.d.comb += [self.pixels.valid.eq(lines.r_rdy & shown), lines.r_en.eq(self.pixels.ready & shown)]
        m.d.comb += [self.pixels.payload[name].eq(out[name]) for name in members]
