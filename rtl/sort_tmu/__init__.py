"""Sorting and tile merging, in the order of the data.

    tile_merge     the tile merge unit: tile ids in, a group for every tile out; `emit_tile_merge_unit`
    tile_counters  its first stage: entries of each tile
    auto_beta      the merge threshold from the frame's sums
    group_tiles    its second stage: counts to groups
    chunk_sorter   the precise half of the hierarchical sorting unit: chunks into their total order; `emit_chunk_sorter`
    merge_stage    one of its merge stages

What stands between the two, and above the sorter, is the level that makes chunks. It takes TileGroup items, knows from their
counts how many entries a group has, fetches those from memory and sends them as chunks:

- A group of at most `chunk_capacity` entries is one chunk, in any order; the tiles inside it need no order either. A group
  without entries needs no chunk; one may be sent.
- A larger group (nearly always a single tile, as one that reaches beta is a group of its own) becomes several chunks, one
  behind the other: by native tile first, then by coarse buckets of the depth key. The buckets are disjoint ranges of (tile,
  key, index), read from memory in that order, so that sorted chunks behind each other are the sorted group. One pass over
  the group's keys gives the histogram that places the bounds; entries go to their buckets in memory and come back a bucket at
  a time. A bucket that is still too large is cut by more bits of the key and, among equal keys, of the index: the order is
  total, so a cut always exists. `ChunkSorter.oversize` says that a chunk came out too large.
- The sorter knows chunks only. Its output ends them with `last`; which tiles and groups they are is again told by the TileGroup
  counts, and chunks need no tag: nothing overtakes.
"""
