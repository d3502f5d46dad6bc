"""Sorting and tile merging, in the order of the data.

    tile_merge      the tile merge unit: tile ids in, a group for every tile out; `emit_tile_merge_unit`
    tile_counters   its first stage: entries of each tile
    auto_beta       the merge threshold from the frame's sums
    group_tiles     its second stage: counts to groups
    hierarchical_sorter   the hierarchical sorting unit: groups into their total order; `emit_hierarchical_sorter`
    chunk_sorter    its precise level: chunks of a group, in one piece; `emit_chunk_sorter`
    merge_stage     one of the chunk sorter's merge stages
    spill_dispatch  sorted chunks to the output, or as runs to memory
    run_writer      runs to memory
    merge_plan      which runs are merged when
    run_reader      runs from memory, read ahead
    merge_tree      a tree of comparators that merges them
    handover        line buffer, or double buffer, between the sorting unit and the array; `emit_handover`

The order is that of the whole TileEntry: native tile, depth key, Gaussian index. Three levels make it:

- The coarse level is the binning of entries by native tile, the key's top bits, as they are made: the tile merge unit joins
  neighbouring tiles into groups, and a group's entries are read from memory in any order.
- The precise level is the chunk sorter: a group of at most `sort_chunk` entries is one chunk, sorted at an entry a cycle.
- The overflow level is a merge of runs: a larger group (nearly always a single tile, as one that reaches beta is a group of
  its own) is cut into chunks where they fill, each is sorted and written to memory, and the sorted runs are merged as they
  are read back.

Merging, and not buckets of the depth key: a merge has no degenerate case. Thousands of equal depths, or a depth range that one
splat stretches, fill one bucket and leave it as large as before; runs are cut by count alone. Merged runs are in order whatever
the cut was, no histogram pass comes first, memory is written and read in sequence, and a group's length need not be known
before it ends.
"""
