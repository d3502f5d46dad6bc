"""The masks of a batch: places come with their tiles, and leave as words of the places of one tile.

Places are collected in a square of flip-flops, a row a place. A whole group of places moves into a second square, from which
the column of every tile that has a place there is written to memory as a word, one in a cycle, while the next group comes.
Words without a place are not written. A bit for each word says whether it has one, so that nobody reads the others.
"""

from __future__ import annotations

from amaranth.hdl import Cat, Const, Module, Mux, Signal, Value
from amaranth.lib import data, memory, wiring
from amaranth.lib.wiring import In, Out

from rtl.select import select
from spec.config import AcceleratorConfig
from spec.supertiles import batch_tile_bits, batch_tiles, check_supertiles

MASK_PLACES = 32
"""Most places of a word of masks."""


def mask_places(config: AcceleratorConfig) -> int:
    """Places of a word, a power of two."""
    return min(MASK_PLACES, config.batch_places)


def mask_words(config: AcceleratorConfig) -> int:
    """Words of a tile in a half of the batch buffer."""
    return config.batch_places // mask_places(config)


def word_bits(config: AcceleratorConfig) -> int:
    """Bits of a word's number; 0 where a tile has only one word."""
    return (mask_words(config) - 1).bit_length()


def lowest(bits: Value) -> Value:
    """The lowest set bit alone; 0 where none is set. It is as many gates deep as the logarithm of the number of bits."""
    below, reach = Value.cast(bits << 1)[:len(bits)], 1
    while reach < len(bits):
        below, reach = below | (below << reach)[:len(bits)], 2 * reach
    return bits & ~below


def several(bits: Value) -> Value:
    """Whether more than one bit is set. It does not wait for `lowest`, and is as deep as the logarithm of the number of
    bits."""
    parts = [(bit, Const(0)) for bit in bits]  # whether a part has a bit that is set, and whether it has several
    while len(parts) > 1:
        pairs = [(one | other, more | others | one & other)
                 for (one, more), (other, others) in zip(parts[::2], parts[1::2], strict=False)]
        parts = pairs + parts[2 * len(pairs):]
    return parts[0][1]


def place_of(one_hot: Value) -> Value:
    """The number of the only set bit, in as many bits as the largest number has."""
    return Cat(Cat(bit for n, bit in enumerate(one_hot) if n >> k & 1).any() for k in range((len(one_hot) - 1).bit_length()))


class BatchMasks(wiring.Component):
    """Takes the tiles of one place after the other, and keeps them as words by tile, those of two batches side by side.

    Parameters:
        config: the machine; only `batch_places` and `joint` are used.

    Ports:
        take: strobe: a place comes; it must not come unless `ready`.
        tiles: the place's tiles among those of `batch_tiles`, one bit each.
        closes: the place is its batch's last.
        ready: a place can be taken.
        half: half of the batch that is being filled; constant from its first place until `settled` after its last.
        begin: strobe: the batch is complete and `settled`; another one begins in the next cycle.
        settled: all places that came are in `summary`.
        summary: for each tile one bit a word: whether the word has a place of the tile.
        waiting, waiting_half: tiles with a word that is still to be written, and the half of these words.
        read_en, read_tile, read_word, read_half: reads a word with a bit in `summary`, of a tile that does not wait.
        read_data: the word that was read, from the next cycle until the next read.

    Storage, with N = `batch_tiles`: 2 squares of N x 32 flip-flops; N x batch_places / 32 flip-flops of `summary`; a memory of
    2 x N x batch_places / 32 words of 32 bits. Throughput: one place a cycle; a batch's last group moves at once only
    if the words of the group before it have been written, which takes a cycle for each tile with a place in it::

        cycle           0       1       2       3       4              the group ends with the place B, which has two tiles
        take         <  A  ><  B  >                <  C  >             C is the first place of the next batch
        settled      ~~~~~~~~~~~~~~~________~~~~~~~~~~~~~~
        begin        _______________________~~~~~~~_______
        waiting                            < A+B  ><  B   >            A's only tile comes first
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        check_supertiles(config)
        self.config, tiles = config, batch_tiles(config)
        super().__init__({
            "take": In(1), "tiles": In(tiles), "closes": In(1), "ready": Out(1),
            "half": In(1), "begin": In(1), "settled": Out(1),
            "summary": Out(data.ArrayLayout(mask_words(config), tiles)),
            "waiting": Out(tiles), "waiting_half": Out(1),
            "read_en": In(1), "read_tile": In(batch_tile_bits(config)), "read_word": In(word_bits(config)), "read_half": In(1),
            "read_data": Out(mask_places(config)),
        })

    def elaborate(self, platform: object) -> Module:
        m = Module()
        size, tiles = mask_places(self.config), batch_tiles(self.config)
        rows, seen = Signal(data.ArrayLayout(tiles, size)), Signal(tiles)
        place, complete = Signal(range(size)), Signal()  # the next place of the group; the group waits to move on
        moves = Signal()
        m.d.comb += [self.ready.eq(~complete | moves), self.settled.eq(~complete)]
        with m.If(moves):
            m.d.sync += [rows.eq(0), seen.eq(0), complete.eq(0)]
        with m.If(self.take):
            m.d.sync += [
                rows[place].eq(self.tiles), seen.eq(Mux(moves, 0, seen) | self.tiles),
                place.eq(Mux(self.closes, 0, place + 1)), complete.eq(self.closes | (place == size - 1))]
        self._write(m, rows, seen, complete, moves)
        return m

    def _write(self, m: Module, rows: data.View, seen: Signal, complete: Signal, moves: Signal) -> None:
        """Takes a complete group, notes its tiles in `summary`, and writes the words of these tiles."""
        words, tiles = mask_words(self.config), batch_tiles(self.config)
        m.submodules.words = store = memory.Memory(
            shape=mask_places(self.config), depth=2 * tiles * words, init=[])
        write, read = store.write_port(), store.read_port(transparent_for=())
        held, left, first = Signal(rows.shape(), reset_less=True), Signal(tiles), Signal(tiles)
        word, half, group = Signal(word_bits(self.config), reset_less=True), Signal(), Signal(range(words))
        columns = (Cat(row[tile] for row in held) for tile in range(tiles))
        m.d.comb += [
            first.eq(lowest(left)),
            moves.eq(complete & ~several(left)),
            write.en.eq(left.any()), write.addr.eq(Cat(word, place_of(first), half)), write.data.eq(select(first, columns)),
            self.waiting.eq(left), self.waiting_half.eq(half),
            read.en.eq(self.read_en), read.addr.eq(Cat(self.read_word, self.read_tile, self.read_half)),
            self.read_data.eq(read.data),
        ]
        m.d.sync += left.eq(left & ~first)
        with m.If(moves):
            m.d.sync += [held.eq(rows), left.eq(seen), word.eq(group), half.eq(self.half), group.eq(group + 1)]
            m.d.sync += [bits.bit_select(group, 1).eq(seen[tile]) for tile, bits in enumerate(self.summary)]
        with m.If(self.begin):
            m.d.sync += [self.summary.eq(0), group.eq(0)]
