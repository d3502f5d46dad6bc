"""Tests of the units in `rtl.supertiles`."""
"""Tests of the units in `rtl.supertiles`.

    record_fetch_*  record fetch, with the golden decoder and the cache that `golden.msv2_ref.fetch` models
"""Tests of the units in `rtl.supertiles`.

    tile_test_*     the tile test in both phases of a frame
    clip_*          boxes cut to super-tiles
    colour_*        the colour unit
"""
