"""How far the machine works ahead: depths of queues, reads on their way, bits of counters. None of them changes a pixel.

Memory that answers after 100 cycles is what the depths are made for: a client that moves a beat a cycle has that many on
their way.
"""

from __future__ import annotations

COUNTER_BITS = 32
"""Of what units count in a frame, and of the host's counters of it."""

WATCHDOG_BITS = 24
"""log2 of the cycles without a beat that end a frame: far above what the smallest array takes to ask for the next one."""

IN_FLIGHT = 256
"""Reads in all, and writes of each client, that may wait for their answers."""

READ_DEPTHS = {"geometry": 128, "tiles": 16, "colour": 128, "entries": 64, "spill": 64, "views": 512}
"""Most beats of each read client on their way or waiting for it: what a latency of 100 cycles takes at the client's rate.

Views are fetched further ahead: while the array works on tiles that blend, memory works for those that do not.
"""

VIEWS_PENDING = 1024
"""Entries whose splats have been asked for before the array takes them: more than the views that `READ_DEPTHS` lets wait."""

CACHE_WAYS = 4
"""Lines of the splat cache that a view may lie in."""

COLOUR_LOOKAHEAD = 128
"""Cycles of the memory's latency that cost the colour unit nothing."""

TILE_TEST_BESIDE = 10
"""Splats in the tile test besides those in the ellipse test: four on the way to it, two behind it, and as many as the queue
takes cycles to show one, with some to spare."""

LEVEL_GROUP = 16
"""Tiles of a word of the tile test's table of levels: neighbours in a row, the first in a column that is a multiple."""

LIST_TILES = 32
"""Tiles with entries whose pointers have been asked for before it is their turn."""

LIST_POINTERS = 64
"""Pointers that may wait: those of four tiles at least."""

LIST_BEATS = 128
"""Beats of lists that may be asked for and not yet unpacked; memory's queues may hold fewer of them."""

HEADER_TILES = 64
"""Tiles that wait for their settings beyond two rows, so that a table's beat that is late costs nothing."""

HEADERS = 16
"""Headers that wait for the array while the splat fetch unit works ahead of it."""

SORT_CUTS = 8
"""Chunks of large groups inside the sorter, which holds two chunks: the last of each may be short."""

SORT_PARTS = 8
"""Spilled groups that wait to be merged."""

SORT_MERGES = 4
"""Merges that have runs in the reader; a run is longer than a way's FIFO, but for a group's last one."""

ARRAY_TILES = 4
"""Tiles between their header's transfer and their last op's leaving the rows; keeps short tiles flowing."""

OUTPUT_DRAINS = 2
"""Drains whose rows the line buffer behind the machine's array holds. One would do, but the array would wait for all of a
tile's rows to leave before the next drains (`python -m msv2.studies drain_waits`)."""

WARP_AHEAD = 4
"""Places that the warp unit's scan of a memory reads ahead, a power of two. As pixels change rows and the scan columns, either
turns to the same memory twice: with half as many places the scan of PAPER's lanes stood still in every eighth cycle."""
