"""Tests of the units in `rtl.sort_tmu`: the tile merge unit, the chunk sorter, the hierarchical sorter and the handover.

    chunk_*             the chunk sorter, against `golden.msv2_ref.sort`
    hierarchical_suite  the hierarchical sorter, with a memory at its ports, against `golden.msv2_ref.sort`
    tile_merge_*        the tile merge unit, against `golden.msv2_ref.tile_merge`
    handover_suite      the buffer between the sorter and the array
"""
