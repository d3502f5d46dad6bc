"""Tests of the units in `rtl.supertiles`.

    tile_test_*     the tile test in both phases of a frame
    clip_*          boxes cut to super-tiles
    colour_*        the colour unit
"""
