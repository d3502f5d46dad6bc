"""Tests of the units in `rtl.vrc_array`: the rendering array, splat fetch and the pixel writer.

    array_*         the rendering array (`rtl.vrc_array.array.VrcArray`), against `golden.msv2_ref.array`
    fetch_*         splat fetch, with the cache that `golden.msv2_ref.fetch` models
    pixel_writer_*  the pixel writer
    traced          tiles of real scenes, as stimuli for the array
"""
