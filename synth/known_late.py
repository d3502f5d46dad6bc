"""Pairs of units that do not fit into one clock today, by machine, with the picoseconds that are missing (`synth.budget`).

The list may only shrink: a test fails if a pair is later than its entry, if a pair is late that has none, or if an entry allows
more than its pair needs. What could be done about each is in docs/synthesis.md.
"""

from __future__ import annotations

KNOWN_LATE: dict[str, dict[tuple[str, str], int]] = {
    "paper": {
        ("render.sorter", "render.sorter"): 545,
        ("render.sorter", "render.sorter.reader"): 442,
        ("render.array", "counters"): 328,
        ("render", "counters"): 296,
        ("render.tile_merge", "render.tile_merge"): 122,
        ("render.array.collect", "render.writer"): 119,
        ("geometry.projection", "geometry.projection"): 85,
        ("geometry.tile_test", "geometry.tile_test"): 85,
        ("controller", "render.headers"): 56,
        ("controller", "queue_colour"): 53,
        ("registers", "render.fetch"): 52,
        ("geometry.writer", "geometry.writer"): 50,
        ("render.array.setup", "render.array.setup"): 50,
        ("render.writer", "render.writer"): 47,
        ("render.array.expand", "render.array.expand"): 44,
        ("geometry.colour", "geometry.colour"): 39,
        ("geometry.reader", "geometry.reader"): 37,
        ("render.headers", "render.headers"): 37,
        ("render.sorter.tree", "render.sorter.reader"): 37,
        ("registers", "geometry.colour"): 36,
        ("render.array.collect", "render.array.collect"): 36,
        ("registers", "queue_colour"): 34,
        ("render.array.vrc_row", "render.array.vrc_row"): 33,
        ("render.sorter.reader", "render.sorter.reader"): 33,
        ("render.array.sequencer", "render.array.expand"): 19,
        ("render.fetch", "render.array.setup"): 11,
        ("geometry.loader", "render.headers"): 3,
        ("registers", "render.writer"): 2,
    },
    "v3": {
        ("render.array", "counters"): 329,
        ("render", "counters"): 297,
        ("render.sorter", "render.sorter"): 296,
        ("render.sorter", "render.sorter.reader"): 197,
        ("render.array.setup", "render.array"): 187,
        ("render.colour", "render.colour"): 173,
        ("geometry.buckets", "geometry.buckets"): 142,
        ("render.fetch", "render.fetch"): 118,
        ("render.array.collect", "render.writer"): 109,
        ("render.sorter.tree", "render.sorter.reader"): 99,
        ("geometry.path.projection", "geometry.path.projection"): 85,
        ("render.sorter.reader", "render.sorter.reader"): 79,
        ("render.array.state", "render.array"): 51,
        ("geometry.path.tile_test", "geometry.path.tile_test"): 48,
        ("geometry.chunk_test", "geometry.chunk_test"): 44,
        ("render.array.setup", "render.array.setup"): 28,
        ("render.array.collect", "render.array"): 14,
        ("geometry.headers", "master"): 12,
        ("registers", "geometry.path.projection"): 12,
        ("registers", "render.writer"): 12,
    },
}
