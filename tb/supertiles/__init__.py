"""Tests of the units in `rtl.supertiles`, and of the array that takes visits.

    tile_test_*     the tile test in both phases of a frame; joint_tiles has its stimuli of two eyes
    clip_*          boxes cut to super-tiles
    colour_*        the colour unit
    buckets_*       depth buckets over several frames
    order_*         the same with lists in memory and the sorter: the order of pairs, whatever the bounds are
    lists_*         the writer of pairs, whose lists are read back from memory
    reader_*        the super-tiles
    record_fetch_*  record fetch, with the golden decoder and the cache that `golden.msv2_ref.fetch` models
    batch_*         the batch buffer
    array_*         the array
"""
