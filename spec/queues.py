"""Depths of queues, numbers of outstanding reads, and widths of counters. None of them changes a pixel.

The depths are chosen for a memory that answers after 100 cycles: a client that moves one beat per cycle then has 100 beats
outstanding.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from spec.config import AcceleratorConfig

COUNTER_BITS = 32
"""Bits of the units' event counts of a frame, and of the host's counters of them."""

WATCHDOG_BITS = 24
"""log2 of the number of cycles without a memory beat after which the watchdog ends a frame. The smallest array needs far fewer
between two beats."""

IN_FLIGHT = 256
"""Most reads of all clients together, and most writes of each client, that may wait for their answers."""

READ_DEPTHS = {"geometry": 128, "tiles": 16, "colour": 128, "entries": 64, "spill": 64, "views": 512, "chunks": 32}
"""Most beats of each read client that are outstanding or wait in its queue: what the client's rate needs at a latency of 100
cycles.

Splat records (`views`) are read further ahead: while the array works on blend tiles, which take longer, memory already reads
for the tiles after them.
"""

SUPERTILE_READ_DEPTHS = READ_DEPTHS | {"tiles": 32, "first": 32}
"""The same in machines with super-tiles. There the table of tiles is loaded at a tile per cycle, which takes 25 beats at a
latency of 100 cycles; in other machines it is a smaller part of a frame. `first` reads it in machines with overlapped phases,
and the headers of chunks."""


def read_depths(config: AcceleratorConfig) -> dict[str, int]:
    """The depths of a machine's read queues by client: those above, but at most the machine's `read_beats`."""
    depths = SUPERTILE_READ_DEPTHS if config.supertiles else READ_DEPTHS
    return {client: min(depth, config.read_beats) for client, depth in depths.items()}


VIEWS_PENDING = 1024
"""Most intersections whose splat records have been requested before the array takes them. This is more than the splat records
that `READ_DEPTHS` lets wait."""

CACHE_WAYS = 4
"""Ways of the splat cache: the number of lines in which a splat record may lie."""

CHUNKS_AHEAD = 16
"""Most chunks whose Gaussians have been requested and not all arrived: chunks of 9 Gaussians and more then hide a latency of
130 cycles. Shorter ones need no more, because the chunk test lets at most one chunk pass every 8 cycles."""

HEADERS_PENDING = 144
"""Most pairs in the record fetch unit that wait for the header of their chunk or of one before: a header may take 130 cycles to
come, while a pair enters in every cycle. The others cover the unit's own registers and the bus."""

RECORDS_PENDING = 144
"""Most pairs of the record fetch unit whose records have been requested: as HEADERS_PENDING, for the records."""

HEADERS_MISSED = 32
"""Most headers in the record fetch unit that wait until the record of their pair comes: a header in five pairs. `READ_DEPTHS`
lets as many be outstanding. In frames of real scenes it is a header in twenty pairs or fewer."""

RECORD_BEATS = 256
"""Most beats of records that wait for the colour unit while their pairs pass projection and tile test. These take about 220
cycles, in each of which a beat comes."""

COLOURS_BESIDE = 8
"""Most splats between the datapath of harmonics and the places of the batch buffer, in machines with joint frames, where what
is known of a splat besides its colour waits beside that datapath."""

COLOUR_LOOKAHEAD = 128
"""Cycles of memory latency that the colour unit hides by reading ahead."""

TILE_TEST_BESIDE = 10
"""Most splats in the tile test besides those in the ellipse test: four on the way to it, two behind it, as many as the queue
has cycles of latency, and some to spare."""

LINES_AHEAD = 128
"""Steps of the tile test by super-tiles whose pairs wait while earlier ones leave one by one, so that splats of many pairs,
which lie side by side in a model, stop the ellipse test less often."""

LEVEL_GROUP = 16
"""Tiles per word of the tile test's level table: neighbours in a row, of which the first has a column that is a multiple of
this number."""

LIST_TILES = 32
"""Most tiles with intersections whose page pointers the list reader requests ahead."""

LIST_POINTERS = 64
"""Most page pointers that wait in the list reader: those of at least four tiles."""

LIST_BEATS = 128
"""Most beats of tile lists that may be requested and not yet unpacked; the memory's queues may hold fewer of them."""

HEADER_TILES = 64
"""Tiles, beyond two rows of them, that may wait for their settings, so that a delayed beat of the tile table costs nothing."""

HEADERS = 16
"""Most headers that wait for the array while the splat fetch unit works ahead of it."""

SUPERTILES_AHEAD = 2
"""Super-tiles, in joint frames those of both eyes, that wait for the batch buffer while pairs behind them are projected again.
Each keeps the array for 256 cycles or more, and projection, tile test and colours take about as long."""

SUPERTILES_TURNING = 4
"""Super-tiles of both eyes that wait on either side of projection in machines with a warp unit, where a pair may be projected
for one eye: as many as can follow each other while a pair is on its way through projection, if they are small."""

LISTS_AHEAD = 32
"""Lists that wait for the list reader while the super-tile reader already has them: as many as a super-tile has at most. A
super-tile is known only by its last list, and sorted pairs wait for it while the list reader cannot move."""

SORT_CUTS = 8
"""Most chunks of large groups inside the sorter. It holds the intersections of two full chunks, but the last chunk of each
group may be short."""

SORT_PARTS = 8
"""Most spilled groups that wait to be merged."""

SORT_MERGES = 4
"""Most merges that have runs in the reader of spilled runs. Every run but the last one of a group is longer than the FIFO of a
merge way."""

ARRAY_TILES = 4
"""Most tiles between the transfer of their header and the moment when their last op leaves the rows of the array. Several are
needed to keep short tiles flowing."""

OUTPUT_DRAINS = 2
"""Number of drains whose rows the line buffer behind the array holds. One would suffice, but the array would then wait until
all rows of a tile have left before the next tile drains (`msv2 study run drain_waits`)."""

WARP_AHEAD = 4
"""Places, a power of two, that the warp unit's scan reads ahead from each memory. Pixels move from row to row and the scan from
column to column, so both turn to the same memory twice in a row; with half as many places the scan of PAPER's lanes stood still
in every eighth cycle."""
