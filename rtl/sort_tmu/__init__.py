"""Tile merging and sorting. The modules are listed in the order in which data pass through them.

    tile_merge      the tile merge unit: reads the tile of every intersection, gives every tile a group
    tile_counters   its first stage: counts the intersections of each tile
    auto_beta       computes the merge threshold from the sums over a frame
    group_tiles     its second stage: turns the counts into groups of tiles
    hierarchical_sorter   the hierarchical sorting unit: sorts each group
    chunk_sorter    its precise level: sorts a chunk, which is a group or a piece of a large one
    merge_stage     one merge stage of the chunk sorter
    spill_dispatch  sends a sorted chunk to the output, or to memory as a run
    run_writer      writes runs to memory
    merge_plan      decides which runs are merged, and when
    run_reader      reads runs from memory ahead of their use
    merge_tree      the tree of comparators that merges these runs
    handover        the line buffer or double buffer between the sorting unit and the array

An intersection is a (splat, tile) pair. Intersections are ordered by the whole Intersection record: native tile, then depth
key, then Gaussian index. The order is made at three levels:

- The coarse level is the binning of intersections by native tile, the top bits of the sort key, at the time they are found.
  The tile merge unit joins neighbouring tiles into groups, and the intersections of a group are read from memory in any order.
- The precise level is the chunk sorter. A group of at most `sort_chunk` intersections is one chunk, which is sorted at one
  intersection per cycle.
- The overflow level is a merge of runs. A larger group is cut into chunks of `sort_chunk` intersections, each chunk is
  sorted and written to memory as a run, and the sorted runs are merged as they are read back. Such a group is nearly always a
  single tile, because a tile that reaches the threshold beta forms a group of its own.

The overflow level merges runs rather than sorting into buckets of the depth key, because a merge has no degenerate case.
Thousands of equal depths, or a depth range that one splat stretches, put everything into one bucket, which is then as large as
the group was. Runs are cut by count alone and merge into the right order wherever the cuts fall. A merge also needs no
histogram pass, it writes and reads memory sequentially, and it need not know a group's length in advance.
"""
