"""Deals a batch to its tiles: which tiles are visited, and at which places of the batch buffer their entries lie.

    batches -> tile by tile -> word by word -> memory of masks -> bit by bit -> items
                    |
                 visits

Every stage works ahead of the next one, so the words of a tile are on their way while the places of the tile before are still
leaving. A word without places is passed over by its summary bit.
"""

from __future__ import annotations

from collections.abc import Callable

from amaranth.hdl import Cat, Module, Mux, ShapeLike, Signal, Value, unsigned
from amaranth.lib import data, stream, wiring
from amaranth.lib.wiring import In, Out

from rtl.select import select
from rtl.shapes import layout
from rtl.stream import Buffer
from rtl.supertiles.batch_masks import lowest, mask_places, mask_words, place_of, several, word_bits
from rtl.supertiles.eyes import joint_settings, origins
from spec.config import AcceleratorConfig
from spec.constants import SUPER_TILES, SUPER_X
from spec.supertiles import (
    SEQUENCE_BITS,
    SUPER_PLACES,
    batch_tile_bits,
    batch_tiles,
    check_supertiles,
    supertile,
    tile_visit,
)


def batch_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A complete batch: its super-tile, its half of the buffer, whether it is its super-tile's last, and of each tile the words
    of masks that have a place. In machines with joint frames, what a super-tile has of each tile exists for both eyes."""
    tiles = {name: shape for name, shape in layout(supertile(config)).members.items() if name not in ("pairs", "eye")}
    if config.joint:
        tiles |= both_eyes(config)
    return data.StructLayout({
        **tiles, "sequence": SEQUENCE_BITS, "half": 1, "final": 1,
        "summary": data.ArrayLayout(mask_words(config), batch_tiles(config))})


def both_eyes(config: AcceleratorConfig) -> dict[str, ShapeLike]:
    """What a SuperTile has of each of its tiles, for the tiles of both eyes."""
    one, tiles = layout(supertile(config)).members, batch_tiles(config)
    level, plane = (data.ArrayLayout.cast(one[name]).elem_shape for name in ("level", "plane"))
    return {"inside": unsigned(tiles), "level": data.ArrayLayout(level, tiles), "blend": unsigned(tiles),
            "plane": data.ArrayLayout(plane, 3 * tiles)}


def item_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A step of the array: the address of a place in both halves together, with what the visited tile uses of it; or, with
    `end`, the end of a visit; or, with `none`, neither of both. `closes`: nothing of this half is read any more."""
    return data.StructLayout({
        "address": config.batch_places.bit_length(), "level": 2, "blend": 1, "end": 1, "none": 1, "closes": 1})


def _tile_layout(config: AcceleratorConfig) -> data.StructLayout:
    """A tile whose words are to be read. `visit`: it is visited, with or without words; otherwise nothing but the end of its
    batch passes on. `closes`: the last one of a batch."""
    return data.StructLayout({
        "words": mask_words(config), "tile": batch_tile_bits(config), "half": 1, "sequence": SEQUENCE_BITS, "level": 2,
        "blend": 1, "visit": 1, "closes": 1})


def _word_layout(config: AcceleratorConfig) -> data.StructLayout:
    """What accompanies a word of masks. `empty`: there is no word; `ends`: the last one of a visit; `closes`: the last one of a
    batch."""
    return data.StructLayout({
        "word": word_bits(config), "tile": batch_tile_bits(config), "half": 1, "sequence": SEQUENCE_BITS, "level": 2,
        "blend": 1, "empty": 1, "ends": 1, "closes": 1})


class BatchVisits(wiring.Component):
    """Turns batches into visits and the places of their entries.

    Parameters:
        config: the machine; `batch_places`, `joint` and `formats.plane` are used.

    Ports:
        batches: `batch_layout` items.
        visits: TileVisit items.
        items: `item_layout` items: the places of each visit in order, then one with `end`. The last item of a batch has
            `closes`; it is one with `none` where no visit of the batch comes last, because all tiles that were left have
            stopped.
            An item that has not been taken is not held: when its tile stops, it becomes the end of the visit or is withdrawn.
        done, current, joint, shift: as those of BatchBuffer.
        waiting, waiting_half, read_en, read_tile, read_word, read_half, read_data: of BatchMasks.
        busy: a batch is inside.

    Throughput: one item a cycle. A visit has one item more than it has entries. Latency: 4 cycles from a batch to its first
    item; no cycle passes between visits or between batches, as long as batches come early enough. A visit that ends early costs
    up to two cycles more. The memory writes a batch's last words tile by tile, too, and so is ahead of the visits, except where
    tiles are left out that have stopped.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        check_supertiles(config)
        self.config = config
        super().__init__({
            **joint_settings(config, "joint", "shift"),
            "batches": In(stream.Signature(batch_layout(config))),
            "visits": Out(stream.Signature(layout(tile_visit(config)))),
            "items": Out(stream.Signature(item_layout(config))),
            "done": In(batch_tiles(config)), "current": In(SEQUENCE_BITS),
            "waiting": In(batch_tiles(config)), "waiting_half": In(1), "read_en": Out(1),
            "read_tile": Out(batch_tile_bits(config)), "read_word": Out(word_bits(config)), "read_half": Out(1),
            "read_data": In(mask_places(config)),
            "busy": Out(1),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        done, current = Signal.like(self.done), Signal.like(self.current)
        m.d.sync += [done.eq(self.done), current.eq(self.current)]

        def stopped(sequence: Value) -> Value:
            """The tiles of a super-tile that are known to have stopped."""
            return done & (current == sequence).replicate(len(done))

        tiles = stream.Signature(_tile_layout(self.config)).create(path=("tiles",))
        words = stream.Signature(_word_layout(self.config)).create(path=("words",))
        batch_valid = self._choose_tiles(m, tiles, stopped)
        tile_valid = self._choose_words(m, tiles, words, stopped)
        bits_valid = self._choose_places(m, words, stopped)
        m.d.comb += self.busy.eq(batch_valid | tile_valid | words.valid | bits_valid | self.visits.valid)
        return m

    def _choose_tiles(self, m: Module, tiles: stream.Interface, stopped: Callable[[Value], Value]) -> Value:
        """Passes on a tile a cycle, with its visit; returns whether there is a batch."""
        m.submodules.ahead = ahead = Buffer(self.visits.payload.shape())
        wiring.connect(m, ahead.source, wiring.flipped(self.visits))
        batch, valid = Signal(self.batches.payload.shape(), reset_less=True), Signal()
        count = batch_tiles(self.config)
        left, seen = Signal(count), Signal(count)  # tiles to visit; those visited before in their super-tile
        wanted, chosen, rest = Signal(count), Signal(count), Signal(count)
        visit, tile, goes = ahead.sink.payload, tiles.payload, Signal()
        comes = self.batches.payload
        planes = [Cat(batch.plane[3 * n + k].as_unsigned() for k in range(3)) for n in range(count)]
        column = (SUPER_X - 1).bit_length()
        m.d.comb += [
            wanted.eq(left & (batch.final.replicate(count) | ~stopped(batch.sequence))),
            chosen.eq(lowest(wanted)), rest.eq(wanted & ~chosen),
            tile.words.eq(select(chosen, batch.summary)),
            tile.tile.eq(place_of(chosen)), tile.half.eq(batch.half), tile.sequence.eq(batch.sequence),
            tile.level.eq(select(chosen, batch.level)), tile.blend.eq((chosen & batch.blend).any()),
            tile.visit.eq(wanted.any()), tile.closes.eq(~several(wanted)),
            visit.tile_x.eq(self._column(m, chosen, batch.x, tile.tile[:column])),
            visit.tile_y.eq(batch.y | tile.tile[column:SUPER_PLACES]),
            visit.outer.eq(tile.level.any()), visit.blend.eq(tile.blend), visit.plane.eq(select(chosen, planes)),
            visit.place.eq(tile.tile[:SUPER_PLACES]), visit.sequence.eq(batch.sequence),
            visit.fresh.eq(~(chosen & seen).any()), visit.final.eq(batch.final),
            tiles.valid.eq(valid & (ahead.sink.ready | ~tile.visit)), goes.eq(tiles.valid & tiles.ready),
            ahead.sink.valid.eq(goes & tile.visit),
            self.batches.ready.eq(~valid | goes & tile.closes),
        ]
        if self.config.joint:
            m.d.comb += visit.eye.eq(tile.tile[-1])
        with m.If(goes):
            m.d.sync += [left.eq(rest), seen.eq(Mux(tile.closes & batch.final, 0, seen | chosen))]
        with m.If(self.batches.ready):
            m.d.sync += valid.eq(self.batches.valid)
            with m.If(self.batches.valid):
                used = Cat(words.any() for words in comes.summary)
                m.d.sync += [batch.eq(comes), left.eq(comes.inside & (comes.final.replicate(count) | used))]
        return valid

    def _column(self, m: Module, chosen: Value, first: Value, place: Value) -> Value:
        """The column of the chosen tile in its eye's frame; `first` is that of the super-tile in the grid of super-tiles, and
        `place` the tile's in the super-tile.

        How far every column of tiles lies from `first` follows from the settings, and an origin is at most the width of a
        super-tile. So nothing is added behind the choice: the low bits and the borrow are chosen, and the borrow chooses the
        high bits. The distances are registered: settings are stable long before they are used.
        """
        if not self.config.joint:
            return first | place
        low, offset = (SUPER_X - 1).bit_length(), Signal((SUPER_X - 1).bit_length() + 1)
        away, columns = [], []
        for eye, origin in enumerate(origins(m, self.joint, self.shift)):
            tiles = chosen[eye * SUPER_TILES:(eye + 1) * SUPER_TILES]
            for column in range(SUPER_X):
                away.append(Signal(low + 1, name=f"away_{eye}_{column}", reset_less=True))
                m.d.sync += away[-1].eq(column - origin)
                columns.append(tiles[column::SUPER_X].any())
        m.d.comb += offset.eq(select(columns, away))
        return Cat(offset[:low], Mux(offset[low], first[low:] - 1, first[low:]))

    def _choose_words(
        self, m: Module, tiles: stream.Interface, words: stream.Interface, stopped: Callable[[Value], Value],
    ) -> Value:
        """Reads a word a cycle, of those that have a place; returns whether there is a tile."""
        tile, valid = Signal(tiles.payload.shape(), reset_less=True), Signal()
        word, rest, first = Signal(words.payload.shape(), reset_less=True), Signal.like(tile.words), Signal.like(tile.words)
        is_stopped, final, waits, goes = Signal(), Signal(), Signal(), Signal()
        m.d.comb += [
            waits.eq(self.waiting.bit_select(tile.tile, 1) & (self.waiting_half == tile.half)),
            is_stopped.eq(stopped(tile.sequence).bit_select(tile.tile, 1)),
            first.eq(lowest(tile.words)), rest.eq(tile.words & ~first), final.eq(is_stopped | ~several(tile.words)),
            goes.eq(valid & (~words.valid | words.ready) & ~waits),
            self.read_en.eq(goes & tile.words.any()),
            self.read_tile.eq(tile.tile), self.read_word.eq(place_of(first)), self.read_half.eq(tile.half),
            tiles.ready.eq(~valid | goes & final), words.payload.eq(word),
        ]
        with m.If(tiles.ready):
            m.d.sync += valid.eq(tiles.valid)
            with m.If(tiles.valid):
                m.d.sync += tile.eq(tiles.payload)
        with m.Elif(goes):
            m.d.sync += tile.words.eq(rest)
        with m.If(~words.valid | words.ready):
            m.d.sync += words.valid.eq(goes)
        with m.If(goes):
            m.d.sync += [word[name].eq(tile[name]) for name in ("tile", "half", "sequence", "level", "blend")]
            m.d.sync += [word.word.eq(place_of(first)), word.empty.eq(is_stopped | ~tile.words.any()),
                         word.ends.eq(tile.visit & final), word.closes.eq(tile.closes & final)]
        return valid

    def _choose_places(self, m: Module, words: stream.Interface, stopped: Callable[[Value], Value]) -> Value:
        """Passes on a place of a word a cycle, and the end of a visit behind its last word; returns whether there is a word."""
        bits, first, rest = (Signal(mask_places(self.config), name=name) for name in ("bits", "first", "rest"))
        word, valid = Signal(words.payload.shape(), reset_less=True), Signal()
        item, has, passes, finished, goes = self.items.payload, Signal(), Signal(), Signal(), Signal()
        m.d.comb += [
            has.eq(bits.any() & ~stopped(word.sequence).bit_select(word.tile, 1)),
            first.eq(lowest(bits)), rest.eq(bits & ~first),
            passes.eq(has | word.ends | word.closes), finished.eq(~has | ~word.ends & ~several(bits)),
            self.items.valid.eq(valid & passes), goes.eq(valid & (self.items.ready | ~passes)),
            item.address.eq(Cat(place_of(first), word.word, word.half)), item.level.eq(word.level), item.blend.eq(word.blend),
            item.end.eq(~has & word.ends), item.none.eq(~has & ~word.ends), item.closes.eq(~has & word.closes),
            words.ready.eq(~valid | goes & finished),
        ]
        with m.If(words.ready):
            m.d.sync += [valid.eq(words.valid), bits.eq(Mux(words.payload.empty, 0, self.read_data))]
            with m.If(words.valid):
                m.d.sync += word.eq(words.payload)
        with m.Elif(goes):
            m.d.sync += bits.eq(rest)
        return valid
