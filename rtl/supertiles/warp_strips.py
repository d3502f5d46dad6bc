"""The warp unit of machines with lists by super-tile: two strips of the target at a time, because tiles of two rows come by
turns (`spec.joint_warp`).

       rows ─┬─ even rows of tiles ─► StripWarp ─┬─► turns ─► writes
             └─ odd rows of tiles ──► StripWarp ─┘
      known tiles ─────► each knows what it must not write
                              └─ tiles with holes ─► HoleTiles, by super-tile
"""

from __future__ import annotations

from typing import Any

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, memory, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.shapes import layout, shape
from rtl.stream import Buffer
from rtl.supertiles.eyes import columns_apart, origins
from rtl.warp_unit.pack import Pack
from rtl.warp_unit.warp_unit import EVENTS, WarpUnit
from rtl.warp_unit.window import picked
from spec.config import AcceleratorConfig
from spec.constants import SUPER_TILES, SUPER_X, SUPER_Y, TILE
from spec.joint_warp import check_sweeps
from spec.memory import WORDS, frame_settings, write_request
from spec.queues import COUNTER_BITS
from spec.records import TILE_BITS, frame_supertiles, frame_tiles, pixel_row, tile_index
from spec.supertiles import supertile_index

_TILE_SHIFT, _WORD_BITS, _PLACES = (TILE - 1).bit_length(), (WORDS - 1).bit_length(), (SUPER_X - 1).bit_length()

_SETTINGS = ("width", "height", "source_right", "disparity_scale", "target_frame_base")


def known_write(config: AcceleratorConfig) -> data.StructLayout:
    """A tile of the target whose table has been read: whether it is known."""
    return data.StructLayout({"en": 1, "tile": tile_index(config).width, "known": 1})


class KnownPack(Pack):
    """`Pack` that writes no pixel of a known tile.

    More ports:
        known, before: whether the tile of the group's column is known, and the tile before it; in the first tile of a strip
            `before` is 1.
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        super().__init__(config)
        self.known, self.before = Signal(), Signal()
        self._aparts = [Signal(_WORD_BITS + 1, name=f"apart_{lane}", reset_less=True) for lane in range(config.warp_lanes)]

    def elaborate(self, platform: object) -> Module:
        m = super().elaborate(platform)
        # Known tiles lengthen the way from a group's place to its end, so these products are registers.
        m.d.sync += [apart.eq(lane * self.width) for lane, apart in enumerate(self._aparts)]
        return m

    def _apart(self, lane: int) -> Value:
        return self._aparts[lane]

    def _complete(self) -> data.StructLayout:
        return data.StructLayout({**super()._complete().members, "known": 1, "before": 1, "x": _TILE_SHIFT})

    def _lanes(self, lanes: Value, word: Value) -> Value:
        x, written = self.column[:_TILE_SHIFT], []
        for lane in range(self.config.warp_lanes):  # of a beat that ends in a known tile, what lies before it may be written
            at = (word[:_WORD_BITS] + self._apart(lane)[:_WORD_BITS])[:_WORD_BITS]
            written.append(~self.known | ~self.before & (at > x))
        return lanes & Cat(written)

    def _kept(self, new: data.View) -> list[Any]:
        return [new.known.eq(self.known), new.before.eq(self.before), new.x.eq(self.column[:_TILE_SHIFT])]

    def _keep(self, m: Module, head: data.View, moves: Value, pick: Value) -> None:
        self._last_sent = kept = Signal(
            data.StructLayout({"known": 1, "before": 1, "x": _TILE_SHIFT, "at": _WORD_BITS}), name="kept", reset_less=True)
        # The place of the beat's last pixel, which `_send` finds a cycle later as the low bits of a long sum.
        below = picked(pick, [self._apart(lane)[:_WORD_BITS] for lane in range(len(pick))])
        with m.If(moves):
            m.d.sync += [*(kept[name].eq(head[name]) for name in ("known", "before", "x")),
                         kept.at.eq(head.word[:_WORD_BITS] + below)]

    def _strobe(self, strobe: Value, word: int) -> Value:
        kept = self._last_sent
        return strobe & ~Mux(kept.at <= kept.x + word, kept.known, kept.before)


class StripWarp(WarpUnit):
    """`WarpUnit` for every second row of tiles: it takes the rows of these tiles alone, and writes their strips.

    Parameters:
        config: the machine, with stereo; `cores_x` is the width of a row of pixels.
        odd: whether the first row of tiles is the second one of the frame.

    Ports that differ from WarpUnit's:
        known: what is written to the memory of known tiles, before a frame.
        tile_ends, holes: strobe: the strip's next tile is through; whether it is a hole tile, that is, holes are left in it and
            it is not known.
        strip_ends: strobe, with the last of them in a strip.
        invalid_tiles: counts known tiles, too.

    Storage besides WarpUnit's, but for its mask: a bit for each tile of a frame.
    """

    def __init__(self, config: AcceleratorConfig, odd: bool) -> None:
        self._odd = odd
        super().__init__(config)

    def _mask_ports(self) -> dict[str, wiring.Member]:
        return {"known": In(known_write(self.config)), "tile_ends": Out(1), "holes": Out(1), "strip_ends": Out(1)}

    def _packer(self) -> Pack:
        return KnownPack(self.config)

    def _own_rows(self) -> tuple[Value, Value, int]:
        height, base, apart = super()._own_rows()
        if self._odd:
            height, base = Mux(self.height > TILE, self.height - TILE, 0), base + (self.width << _TILE_SHIFT)
        return height[: len(self.height)] if self._odd else height, base, apart + 1

    def _mask(self, m: Module, pack: Pack) -> tuple[Signal, Signal]:
        assert isinstance(pack, KnownPack)
        m.submodules.known_tiles = store = memory.Memory(shape=1, depth=frame_tiles(self.config), init=[])
        write, read = store.write_port(), store.read_port()
        before, left, tile_ends = Signal(), Signal(), Signal()
        tile, row, last = Signal.like(self.known.tile), Signal.like(self.known.tile), Signal()
        columns, upcoming = self._last[_TILE_SHIFT:] + 1, Signal.like(tile)
        below = Signal.like(tile)  # the first tile of the next strip, which is many cycles away
        m.d.comb += [
            write.en.eq(self.known.en), write.addr.eq(self.known.tile), write.data.eq(self.known.known),
            left.eq(before | pack.filled.payload.left),
            tile_ends.eq(pack.column_ends & pack.column[:_TILE_SHIFT].all() | pack.strip_ends),
            upcoming.eq(Mux(pack.strip_ends, below, Mux(tile_ends, tile + 1, tile))),
            read.addr.eq(upcoming), pack.known.eq(read.data), pack.before.eq(last),
            self.tile_ends.eq(tile_ends), self.holes.eq(left & ~read.data), self.strip_ends.eq(pack.strip_ends)]
        m.d.sync += [tile.eq(upcoming), below.eq(row + 2 * columns)]
        with m.If(pack.commits):
            m.d.sync += before.eq(left & ~tile_ends)
        with m.If(tile_ends):
            m.d.sync += last.eq(read.data | pack.strip_ends)
        with m.If(pack.strip_ends):
            m.d.sync += row.eq(upcoming)
        with m.If(self.begin):
            first = columns if self._odd else Const(0)
            m.d.sync += [tile.eq(first), row.eq(first), last.eq(1)]
        return tile_ends, left


def _hole_ports(config: AcceleratorConfig) -> dict[str, wiring.Member]:
    """The ports by which others learn which tiles have holes."""
    return {"number": In(supertile_index(config)).array(2), "tiles": Out(SUPER_TILES).array(2),
            "hole_tiles": Out(range(frame_tiles(config) + 1))}


class HoleTiles(wiring.Component):
    """Keeps, for every super-tile, which tiles of the target have holes that are to be rendered.

    Parameters:
        config: the machine, with a warp unit and joint frames.

    Ports:
        tile_ends, holes, strip_ends: those of the units of even and of odd rows of tiles.
        joint, shift, width: settings.
        begin: strobe: before a frame's first tile. clear: strobe between frames; the memory is then cleared, a super-tile a
            cycle, long before the first tile comes.
        number, tiles: numbers of super-tiles, and in the next cycle which of their tiles have holes, one bit each.
        hole_tiles: hole tiles since `begin`, two cycles behind their ends.

    Storage: a bit for each tile of the super-tiles of the largest frame.
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        self._supertiles = frame_supertiles(config)
        settings = {f.name: In(shape(f.format)) for f in frame_settings(config).fields if f.name in ("joint", "shift", "width")}
        super().__init__({
            **{name: In(SUPER_Y) for name in ("tile_ends", "holes", "strip_ends")}, **settings, "begin": In(1), "clear": In(1),
            **_hole_ports(config)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        _, origin = origins(m, self.joint, self.shift)
        columns, clearing, at = Signal(TILE_BITS), Signal(init=1), Signal(range(self._supertiles))
        wide = (self.width + (TILE - 1) >> _TILE_SHIFT) + columns_apart(self.joint, self.shift)
        m.d.sync += columns.eq(wide + (SUPER_X - 1) >> _PLACES)
        with m.If(clearing):
            m.d.sync += [at.eq(at + 1), clearing.eq(at != self._supertiles - 1)]
        with m.If(self.clear):
            m.d.sync += [at.eq(0), clearing.eq(1)]
        # Ends of tiles come late in their cycle.
        ends, holes, strips = (Signal(SUPER_Y, name=name) for name in ("ends", "are_holes", "strips"))
        m.d.sync += [ends.eq(self.tile_ends), holes.eq(self.holes), strips.eq(self.strip_ends)]
        answers = [self._row(m, row, (ends[row], holes[row], strips[row]), origin, columns, clearing, at)
                   for row in range(SUPER_Y)]
        for port in range(2):
            m.d.comb += self.tiles[port].eq(Cat(row[port] for row in answers))
        m.d.sync += self.hole_tiles.eq(self.hole_tiles + sum(ends & holes))
        with m.If(self.begin):
            m.d.sync += self.hole_tiles.eq(0)
        return m

    def _row(
        self, m: Module, row: int, tile: tuple[Value, Value, Value], origin: Value, columns: Value, clearing: Value, at: Value,
    ) -> list[Value]:
        """The memory of one row of tiles of each super-tile; returns its answers. `tile`: whether a tile ends, is a hole tile,
        and is the strip's last."""
        m.submodules[f"row_{row}"] = store = memory.Memory(shape=SUPER_X, depth=self._supertiles, init=[])
        write, reads = store.write_port(), [store.read_port() for _ in range(2)]
        place, bits, word = Signal(_PLACES, name=f"place_{row}"), Signal(SUPER_X, name=f"bits_{row}"), Signal(SUPER_X)
        number, begins = (Signal.like(self.number[0], name=f"{name}_{row}") for name in ("number", "begins"))
        ends, hole, strip = tile
        over = Signal(name=f"over_{row}")
        m.d.comb += [
            word.eq(bits | (hole << place)), over.eq(place.all() | strip),
            write.en.eq(clearing | ends), write.addr.eq(Mux(clearing, at, number)), write.data.eq(Mux(clearing, 0, word)),
            *(read.addr.eq(self.number[port]) for port, read in enumerate(reads))]
        with m.If(ends):
            m.d.sync += [place.eq(place + 1), bits.eq(Mux(over, 0, word)), number.eq(number + over)]
        with m.If(ends & strip):
            m.d.sync += [place.eq(origin[:_PLACES]), number.eq(begins + columns + origin[_PLACES:]),
                         begins.eq(begins + columns)]
        with m.If(self.begin):
            m.d.sync += [place.eq(origin[:_PLACES]), bits.eq(0), number.eq(origin[_PLACES:]), begins.eq(0)]
        return [read.data for read in reads]


class WarpStrips(wiring.Component):
    """Warps the source's rows, in the order of super-tiles, into the target's frame.

    Parameters:
        config: the machine, with a warp unit and joint frames, as the writer of its frame sees it
            (`spec.supertiles.frame_rows`).

    Ports:
        rows: PixelRow items of the source; tiles come super-tile by super-tile. None is taken before `begin`.
        writes, writes_idle: the memory's write port.
        width, height, source_right, disparity_scale, target_frame_base, joint, shift: settings of the frame.
        known: tiles of the target whose table has been read, before a frame.
        begin: strobe before a frame's first row; clears `finished` and the events. clear: strobe between frames.
        finished: all rows of the frame have come since `begin`, and memory has what is warped. Stays high until `begin`.
        busy: a pixel is inside or not in memory yet, or rings are being cleared after a reset.
        number, tiles, hole_tiles: see HoleTiles.
        warped, filled, invalid_tiles: events since `begin`, in known tiles, too.

    Storage, throughput and latency: WarpUnit's, twice, where the tiles of one strip after the other leave the units idle by
    turns. A write takes a cycle more.
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        check_sweeps(config)
        self.config = config
        names = (*_SETTINGS, "joint", "shift")
        settings = {f.name: In(shape(f.format)) for f in frame_settings(config).fields if f.name in names}
        super().__init__({
            "rows": In(stream.Signature(layout(pixel_row(config)))),
            "writes": Out(stream.Signature(layout(write_request(config)))), "writes_idle": In(1), **settings,
            "known": In(known_write(config)), "begin": In(1), "clear": In(1), "finished": Out(1), "busy": Out(1),
            **_hole_ports(config), **{name: Out(COUNTER_BITS) for name in EVENTS}})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.holes = holes = HoleTiles(self.config)
        units = [StripWarp(self.config, bool(odd)) for odd in range(SUPER_Y)]
        odd = self.rows.payload.tile_y[0]
        for number, unit in enumerate(units):
            m.submodules[f"strip_{number}"] = unit
            mine = odd if number else ~odd
            m.d.comb += [
                *(getattr(unit, name).eq(getattr(self, name)) for name in (*_SETTINGS, "known", "begin")),
                unit.rows.payload.eq(self.rows.payload), unit.rows.valid.eq(self.rows.valid & mine),
                unit.writes_idle.eq(1),
                *(getattr(holes, name)[number].eq(getattr(unit, name)) for name in ("tile_ends", "holes", "strip_ends"))]
        m.d.comb += [
            self.rows.ready.eq(Mux(odd, units[1].rows.ready, units[0].rows.ready)),
            *(getattr(holes, name).eq(getattr(self, name)) for name in ("joint", "shift", "width", "begin", "clear")),
            *(holes.number[port].eq(self.number[port]) for port in range(2)),
            *(self.tiles[port].eq(holes.tiles[port]) for port in range(2)), self.hole_tiles.eq(holes.hole_tiles)]
        sending = self._send(m, units)
        one_row = Signal()  # the frame has no odd row of tiles
        m.d.sync += one_row.eq(self.height <= TILE)
        m.d.comb += [
            self.finished.eq(units[0].finished & (units[1].finished | one_row) & ~sending & self.writes_idle),
            self.busy.eq(units[0].busy | units[1].busy | sending)]
        for name in EVENTS:
            m.d.sync += getattr(self, name).eq(sum(getattr(unit, name) for unit in units))
        return m

    def _send(self, m: Module, units: list[StripWarp]) -> Value:
        """Sends the beats of both units, in turn where both have one; returns whether one is on its way."""
        m.submodules.leaving = leaving = Buffer(self.writes.payload.shape())
        wiring.connect(m, leaving.source, wiring.flipped(self.writes))
        turn, second = Signal(), Signal()
        first, other = (unit.writes for unit in units)
        m.d.comb += [
            second.eq(other.valid & (turn | ~first.valid)),
            leaving.sink.valid.eq(first.valid | other.valid),
            leaving.sink.payload.eq(Mux(second, other.payload, first.payload)),
            first.ready.eq(leaving.sink.ready & ~second), other.ready.eq(leaving.sink.ready & second)]
        with m.If(leaving.sink.valid & leaving.sink.ready):
            m.d.sync += turn.eq(~second)
        return leaving.source.valid
