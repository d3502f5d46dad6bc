"""Unit test of the tile merge unit (`rtl.sort_tmu.tile_merge`) against `golden.msv2_ref.sort_tmu`.

    stimuli     frames' tile ids, by hand, at random and of scenes
    suite       what is run, in which configurations
"""
