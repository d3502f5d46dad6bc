"""Packed frames: the frame in the format for displays, without loss, in about half of its bytes.

A frame of DisplayPixels is cut into *blocks* of BLOCK_WIDTH by BLOCK_HEIGHT pixels. A tile has BLOCKS of them, its *parts*,
from top to bottom; part p of tile t is block BLOCKS * t + p, where tiles are numbered row by row. Each block is packed by
itself, into as many whole beats as it needs, so a reader can begin anywhere, and tiles may be written in any order.

**Place in memory.** Block b has a slot of SLOT_BEATS beats, as many as its pixels take unpacked, at beat SLOT_BEATS * b of the
frame. Only the beats that it needs are written and read; the others keep what they held. So a block's address follows from its
number alone, a tile's blocks lie together, and no space has to be allocated while the frame is written. Packing saves bytes
that are moved, and no space. Behind the slots of all tiles lies the *table*, at beat SLOT_BEATS * BLOCKS * tiles: a
PackedEntry for every block, in the order of their numbers, ENTRIES to a beat. What follows the last entry in its beat means
nothing.

**Size.** The field `size` of an entry is the number of the block's beats: 1 to SLOT_BEATS - 1 with a PackedHeader, SLOT_BEATS
for a *plain* block, which has no header and is as large as its pixels, and 0 for a block that has no pixel of the frame. A
block is plain exactly where it would not be smaller with a header.

**Differences.** All arithmetic is modulo 256. Of a pixel r, g, b, coverage a, the channels are c = (r - g, g, b - g, a). With
c(x, y) = 0 for x < 0 or y < 0, the difference of each channel is

    d(x, y) = c(x, y) - c(x-1, y) - c(x, y-1) + c(x-1, y-1)

for the pixels that lie in the frame, and 0 for those beyond its right and lower edges, on which no pixel of the frame depends.
In a block with a header, d(0, 0) is 0 too, and the header has c(0, 0) in its place.

**Groups.** The differences of GROUP neighbours of a row, of one channel, are a *group*. A row has GROUPS of them: group number
CHANNELS * h + k has channel k of pixels GROUP * h to GROUP * h + GROUP - 1. With differences as two's complement, the group's
*code* says how many bits each of them has: the smallest n of 0..6 for which all lie in -2^(n-1) .. 2^(n-1) - 1 (n = 0: all are
0), or ALL_PLANES where none of these is enough; this code stands for 8 bits. The group is then stored as bit planes, one byte
each, as many as it has bits: bit i of byte j is bit j of the difference of pixel i. A code of n planes means that bits n - 1
and higher of a difference are equal.

**Bytes.** A block with a header has the header first, then the groups of row 0 by their numbers, of row 1, and so on; no byte
lies between them, and the bytes behind the last group are 0. A plain block has 8 planes of every group, in the same order.

**Check.** The field `check` of an entry is a remainder (CRC) over all bits of the block's beats, lowest first, each beat from
its lowest bit up. The state is CHECK_BITS wide and starts as the low bits of the block's number, with CHECK_START added by
exclusive or. For each bit, the state is shifted up by one; where the bit that leaves differs from the data's bit,
CHECK_POLYNOMIAL is added by exclusive or. The polynomial is primitive and its period longer than a block, so that one or two
wrong bits, and all wrong bits within CHECK_BITS neighbours, are noticed in every case; anything else, such as beats of an
older frame or of another block, with a probability of 1 - 2^-12. `check` is 0 where `size` is 0.

**Errors.** PackedError names what is wrong with a block. They are looked for in the order of their numbers, and the first one
is told.

**Two eyes.** A joint frame (`spec.joint`) is two packed frames, each with its slots, table and numbers of blocks as if it were
alone: the source's at `frame_base`, the target's at `target_frame_base`.

**Cost.** A plain block costs its pixels and an entry, 258 bytes for 256: noise costs 0.8 % more than unpacked.
"""

from __future__ import annotations

from spec.codes import Code
from spec.config import AcceleratorConfig
from spec.constants import TILE
from spec.formats import UQ
from spec.memory import BEAT_BYTES, DISPLAY_PIXEL_BYTES, WORD_BITS, WORDS
from spec.records import TILE_BITS, Field, Record, eye, uint

BLOCK_WIDTH = TILE
"""Pixels of a block's row: blocks are as wide as a tile."""

BLOCK_HEIGHT = 4
"""Rows of a block."""

BLOCKS = TILE // BLOCK_HEIGHT
"""Blocks of a tile."""

CHANNELS = DISPLAY_PIXEL_BYTES
"""Channels of a pixel: r - g, g, b - g, coverage."""

GROUP = 8
"""Differences of a group."""

GROUPS = CHANNELS * BLOCK_WIDTH // GROUP
"""Groups of a block's row."""

BLOCK_GROUPS = GROUPS * BLOCK_HEIGHT
"""Groups of a block."""

CODE_BITS = 3
"""Bits of a group's code."""

ALL_PLANES = (1 << CODE_BITS) - 1
"""The code of 8 planes; any other code is the number of planes."""

PLANES = 8
"""Planes of a group with code ALL_PLANES, and of every group of a plain block."""

SLOT_BEATS = BLOCK_WIDTH * BLOCK_HEIGHT * DISPLAY_PIXEL_BYTES // BEAT_BYTES
"""Beats of a block's slot, and of a plain block."""

HEADER_BYTES = CHANNELS + CODE_BITS * BLOCK_GROUPS // 8
"""Bytes of a PackedHeader."""

PLANES_MOST = (SLOT_BEATS - 1) * BEAT_BYTES - HEADER_BYTES
"""Planes of all groups that a block with a header holds at most; a block with more of them is plain."""

CHECK_BITS = 12
"""Bits of a block's check."""

CHECK_POLYNOMIAL = 0x053
"""The polynomial x^12 + x^6 + x^4 + x + 1 without its highest term."""

CHECK_START = 0xFFF
"""What is added to the block's number, so that a block of zeros does not have a check of 0."""

ENTRY_BITS = 16
"""Bits of a PackedEntry."""

ENTRIES = 8 * BEAT_BYTES // ENTRY_BITS
"""Entries of the table in a beat: those of ENTRIES / BLOCKS tiles."""

BLOCK_BITS = 2 * TILE_BITS + (BLOCKS - 1).bit_length()
"""Bits of a block's number."""


class PackedError(Code):
    """What is wrong with a block of a packed frame."""

    NONE = 0
    """Nothing."""
    MISSING = 1
    """The size is 0, but the block has pixels of the frame: it was never written."""
    SIZE = 2
    """The size is above SLOT_BEATS, or the block has no pixel of the frame, but a size or a check."""
    LENGTH = 3
    """The codes of the header add up to another number of beats than the size."""
    CHECK = 4
    """The check differs: the beats are not those that were packed."""


def packed_entry(config: AcceleratorConfig) -> Record:
    """A block's entry in the table of a packed frame."""
    return Record("PackedEntry", packed_entry.__doc__, (
        Field("size", uint(4), "beats of the block: 1..7 with a header, 8 plain, 0 outside the frame"),
        Field("check", uint(CHECK_BITS), "remainder over the block's beats"),
    ))


def packed_header(config: AcceleratorConfig) -> Record:
    """What a block of a packed frame begins with, unless it is plain."""
    return Record("PackedHeader", packed_header.__doc__, (
        Field("first", UQ(8, 0), "channels of the first pixel: r - g, g, b - g, coverage", CHANNELS),
        Field("code", uint(CODE_BITS), "code of each group, row by row", BLOCK_GROUPS),
    ))


def block_row(config: AcceleratorConfig) -> Record:
    """A row of a block in the format for displays. The rows of a block follow each other, row 0 first."""
    return Record("BlockRow", block_row.__doc__, (
        Field("pixel", uint(8), "r, g, b, coverage of each pixel, left to right", CHANNELS * BLOCK_WIDTH),
        Field("inside", uint(BLOCK_WIDTH.bit_length()), "how many of them, from the left, lie in the frame"),
        Field("row", uint((BLOCK_HEIGHT - 1).bit_length()), "number of the row"),
        Field("block", uint(BLOCK_BITS), "number of the block"), *eye(config),
    ))


def packed_beat(config: AcceleratorConfig) -> Record:
    """A beat of a packed block; a block beyond the frame has one item, which is no beat."""
    return Record("PackedBeat", packed_beat.__doc__, (
        Field("word", uint(WORD_BITS), "the beat, lowest address first", WORDS),
        Field("block", uint(BLOCK_BITS), "number of the block"), *eye(config),
        Field("size", uint(4), "beats of the block up to this one; 0: no beat"),
        Field("last", uint(1), "the block's last item: `size` and `check` are those of its PackedEntry"),
        Field("check", uint(CHECK_BITS), "remainder over the block's beats up to this one"),
    ))


def listed_block(config: AcceleratorConfig) -> Record:
    """A block that is to be unpacked: its number, and its entry of the table. It has pixels of the frame."""
    return Record("ListedBlock", listed_block.__doc__, (
        *packed_entry(config).fields, Field("block", uint(BLOCK_BITS), "number of the block")))


def display_row(config: AcceleratorConfig) -> Record:
    """A row of a block as it comes out of a packed frame; pixels beyond the frame mean nothing."""
    return Record("DisplayRow", display_row.__doc__, (
        Field("pixel", uint(8), "r, g, b, coverage of each pixel, left to right", CHANNELS * BLOCK_WIDTH),
        Field("error", uint(PackedError.width()), "with the block's last row: what is wrong with it (PackedError); else 0"),
    ))


def block_size(planes: int) -> int:
    """Beats of a block whose groups have so many planes together, 0..PLANES * BLOCK_GROUPS."""
    return SLOT_BEATS if planes > PLANES_MOST else -(-(HEADER_BYTES + planes) // BEAT_BYTES)


def packed_beats(width: int, height: int) -> int:
    """Beats of the region of a packed frame, slots and table, of so many pixels."""
    tiles = -(-width // TILE) * -(-height // TILE)
    return SLOT_BEATS * BLOCKS * tiles + -(-BLOCKS * tiles // ENTRIES)


def table_beat(width: int, height: int) -> int:
    """The beat of the table, from the beginning of the frame."""
    return SLOT_BEATS * BLOCKS * -(-width // TILE) * -(-height // TILE)


PACKED_RECORDS = (packed_entry, packed_header, block_row, packed_beat, listed_block, display_row)
