"""Unit test of the rendering array (`rtl.vrc_array.array.VrcArray`) against `golden.msv2_ref.array`.

    device      the array between files
    stimuli     corners and random frames
    traced      tiles of real scenes
    check       comparison
    suite       what is run, in which configurations
"""
