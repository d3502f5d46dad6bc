"""Makes the super-tiles, which the batch buffer needs before their pairs, from the lists' counts and the host's table."""

from __future__ import annotations

from collections.abc import Callable

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value, signed
from amaranth.lib import data, stream, wiring
from amaranth.lib.fifo import SyncFIFOBuffered
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout, shape
from rtl.supertiles.eyes import joint_settings, origins
from rtl.tile_lists.beats import check_config, read_port
from rtl.tile_lists.tile_settings import BEAT_TILES
from spec.config import AcceleratorConfig
from spec.constants import SUPER_TILES, SUPER_X, SUPER_Y, TILE
from spec.joint import EYES
from spec.memory import BEAT_BITS, TILE_SETTING_BYTES, check_memory, frame_settings, tile_setting
from spec.records import COUNT_BITS, TILE_BITS, frame_supertiles, list_group
from spec.supertiles import check_supertiles, supertile, supertile_index

SUPERTILE_BEATS = SUPER_TILES // BEAT_TILES
"""Beats of the table that hold a super-tile's settings."""

_TILE_SHIFT = (TILE - 1).bit_length()


class SuperTileReader(wiring.Component):
    """Makes a SuperTile item for each super-tile of a frame, in order: adds up the counts of its lists, reads the settings of
    its tiles, and finds which of them lie in the frame.

    Parameters:
        config: the machine; `row_width`, `list_heads` and the plane's format matter here.

    Ports:
        lists: ListGroup items of every list of a frame, in order. Those of a whole frame are taken even if no other port moves.
        supertiles_base: the table's first beat.
        width, height: size of the frame in pixels, each 1 or more; stable during a frame, as is the base.
        reads, data: read port of memory; the SUPERTILE_BEATS beats of a super-tile are requested when its last list comes. A
            joint frame has as many more for the target.
        joint, shift: settings of the frame, in machines with joint frames.
        supertiles: SuperTile items, one per super-tile, empty ones too; in joint frames two, of the source and of the target.
        stereo, second, number, holes: in machines with a warp unit (`spec.joint_warp`) the setting; whether the lists are those
            of a second sweep; and the number of the offered super-tile, and in the next cycle which of its target's tiles
            have holes. `inside` then has the tiles that the sweep renders.
        clear: strobe: resets `error`.
        error: memory answered with an error. The items of such beats are undefined, but are passed on.

    Storage: a count for each super-tile of the largest frame, and one SuperTile. Throughput: a list per cycle, and an item in
    SUPERTILE_BEATS + 1 cycles. Latency: one cycle from a super-tile's last list to its first request, and one from its last
    beat to the item. A frame's first list is taken only when all beats of the frame before have been requested.
    """

    def __init__(self, config: AcceleratorConfig):
        check_config(config)
        check_supertiles(config)
        check_memory(config)
        self.config = config
        size = {f.name: In(shape(f.format)) for f in frame_settings(config).fields if f.name in ("width", "height")}
        super().__init__({
            "lists": In(stream.Signature(layout(list_group(config)))),
            "supertiles_base": In(BEAT_BITS), **size, **joint_settings(config, "joint", "shift"),
            **read_port(config), **(self._sweep_ports(config) if config.warps_joint else {}),
            "supertiles": Out(stream.Signature(layout(supertile(config)))),
            "clear": In(1), "error": Out(1),
        })

    def _sweep_ports(self, config: AcceleratorConfig) -> dict[str, wiring.Member]:
        return {"stereo": In(1), "second": In(1), "number": Out(supertile_index(config)), "holes": In(SUPER_TILES)}

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.waiting = waiting = SyncFIFOBuffered(width=COUNT_BITS, depth=frame_supertiles(self.config))
        self._ask(m, waiting)
        leaves = self.supertiles.valid & self.supertiles.ready
        settings, whole = self._settings(m, leaves)
        out = self.supertiles.payload
        m.d.comb += [
            self.supertiles.valid.eq(waiting.r_rdy & whole), waiting.r_en.eq(self._last(leaves)), out.pairs.eq(waiting.r_data),
            *(out.level[i].eq(setting.level) for i, setting in enumerate(settings)),
            out.blend.eq(Cat(setting.blend for setting in settings)),
            *(out.plane[3 * i + k].eq(setting.plane[k]) for i, setting in enumerate(settings) for k in range(3)),
        ]
        self._place(m, leaves, Cat(setting.warp for setting in settings) if self.config.warps_joint else None)
        return m

    def _last(self, leaves: Value) -> Value:
        """Whether a super-tile's last item leaves."""
        return leaves & (~self.joint | self.supertiles.payload.eye) if self.config.joint else leaves

    def _ask(self, m: Module, waiting: SyncFIFOBuffered) -> None:
        """Adds up counts, puts the sum of each super-tile into the queue, and requests its settings."""
        item, taken = self.lists.payload, Signal()
        total, summed = Signal(COUNT_BITS), Signal(COUNT_BITS)
        owed = Signal(range((SUPERTILE_BEATS << self.config.joint) * frame_supertiles(self.config) + 1))
        beats = Mux(self.joint, EYES * SUPERTILE_BEATS, SUPERTILE_BEATS) if self.config.joint else SUPERTILE_BEATS
        first, beat = item.tile == 0, Signal(BEAT_BITS, reset_less=True)
        m.d.comb += [
            summed.eq(total + item.count), waiting.w_data.eq(summed),
            self.lists.ready.eq(waiting.w_rdy & ~(first & owed.any())),
            taken.eq(self.lists.valid & self.lists.ready), waiting.w_en.eq(taken & item.ends),
            self.reads.valid.eq(owed.any()), self.reads.payload.beat.eq(beat),
        ]
        asked = self.reads.valid & self.reads.ready
        m.d.sync += owed.eq(owed + Mux(waiting.w_en, beats, 0) - asked)
        with m.If(taken):
            m.d.sync += total.eq(Mux(item.ends, 0, summed))
        with m.If(taken & first):
            m.d.sync += beat.eq(self.supertiles_base)
        with m.Elif(asked):
            m.d.sync += beat.eq(beat + 1)

    def _settings(self, m: Module, leaves: Value) -> tuple[list[data.View], Signal]:
        """The settings of the tiles of one super-tile, and whether all of them have come."""
        record = layout(tile_setting(self.config))
        settings = [Signal(record, name=f"setting_{i}", reset_less=True) for i in range(SUPER_TILES)]
        part, whole, beat = Signal(range(SUPERTILE_BEATS)), Signal(), self.data.payload.word.as_value()
        taken = self.data.valid & self.data.ready
        m.d.comb += self.data.ready.eq(~whole)  # from a register: `leaves` comes late, and memory's queue is read with this
        with m.If(leaves):
            m.d.sync += whole.eq(0)
        with m.If(taken):
            m.d.sync += part.eq(part + 1)
            with m.If(part == SUPERTILE_BEATS - 1):
                m.d.sync += [part.eq(0), whole.eq(1)]
        for i, setting in enumerate(settings):
            with m.If(taken & (part == i // BEAT_TILES)):
                at = 8 * TILE_SETTING_BYTES * (i % BEAT_TILES)
                m.d.sync += setting.eq(beat[at : at + record.size])
        with m.If(self.clear):
            m.d.sync += self.error.eq(0)
        with m.Elif(taken & self.data.payload.error):
            m.d.sync += self.error.eq(1)
        return settings, whole

    def _place(self, m: Module, leaves: Value, warp: Value | None) -> None:
        """Where the super-tile lies, and which of its tiles lie in the frame; where tiles may be warped, which of these the
        sweep renders."""
        out = self.supertiles.payload
        columns, rows = Signal(TILE_BITS + 1), Signal(TILE_BITS + 1)
        x, y = Signal(TILE_BITS), Signal(TILE_BITS)
        right, below = Signal.like(columns), Signal.like(rows)  # tiles from the super-tile's first one to the frame's edges
        begins = origins(m, self.joint, self.shift) if self.config.joint else None
        edge = columns + (begins[0] | begins[1]) if begins else columns  # one of the two is 0
        m.d.comb += [out.x.eq(x), out.y.eq(y), right.eq(edge - x), below.eq(rows - y)]
        across, over = (self._eye(m, leaves, begins, columns - x, x) if begins else
                        (lambda column: right > column, leaves))
        inside: Value = Cat(across(place % SUPER_X) & (below > place // SUPER_X) for place in range(SUPER_TILES))
        if warp is not None:
            inside &= self._wanted(m, warp, over)
        m.d.comb += out.inside.eq(inside)
        m.d.sync += [
            columns.eq((self.width + (TILE - 1)) >> _TILE_SHIFT), rows.eq((self.height + (TILE - 1)) >> _TILE_SHIFT)]
        with m.If(over):
            row_ends = right <= SUPER_X
            m.d.sync += x.eq(Mux(row_ends, 0, x + SUPER_X))
            with m.If(row_ends):
                m.d.sync += y.eq(Mux(below <= SUPER_Y, 0, y + SUPER_Y))

    def _wanted(self, m: Module, warp: Value, over: Value) -> Value:
        """The tiles of the offered item's eye that the sweep renders, wherever they lie. The next item is offered several
        cycles after the last one has left, when the answer for its number has come."""
        number, target, holes = Signal.like(self.number), self.supertiles.payload.eye, Signal.like(self.holes)
        m.d.comb += self.number.eq(number)
        m.d.sync += holes.eq(self.holes)
        with m.If(over):
            m.d.sync += number.eq(number + 1)
        with m.If(self.lists.valid & self.lists.ready & (self.lists.payload.tile == 0)):
            m.d.sync += number.eq(0)
        every = Const((1 << SUPER_TILES) - 1, SUPER_TILES)
        return Mux(self.second, Mux(target, warp & holes, 0), Mux(target & self.stereo, ~warp, every))

    def _eye(
        self, m: Module, leaves: Value, begins: tuple[Signal, Signal], right: Value, x: Signal,
    ) -> tuple[Callable[[int], Value], Value]:
        """Turns from eye to eye, whose frames begin at these columns. Returns which columns of the super-tile lie in the eye's
        frame, and whether a super-tile's last item leaves. `right` is the number of columns from the super-tile's first one to
        the right edge of a frame that begins at column 0."""
        source, target = begins
        turn, origin, edge, over = Signal(), Signal.like(source), Signal(signed(TILE_BITS + 2)), self._last(leaves)
        m.d.comb += [self.supertiles.payload.eye.eq(turn), origin.eq(Mux(turn, target, source))]
        m.d.sync += edge.eq(right + origin)  # the next item is offered two cycles after this one has left, or later
        with m.If(leaves):
            m.d.sync += turn.eq(~over)
        return lambda column: (edge > column) & ((x != 0) | (origin <= column)), over
