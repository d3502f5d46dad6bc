"""Tile lists (`rtl.tile_lists`) written to memory and read back, against `golden.msv2_ref.tile_lists`.

    memory      a memory whose answers are late
    device      the units around it
    stimuli     frames by hand, at random and of scenes
    suite       what is run, in which configurations
    combining   what waiting for more entries of a beat would save
"""
