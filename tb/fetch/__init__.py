"""Unit test of splat fetch (`rtl.vrc_array.splat_fetch`) against the golden frame's entries and a model of its cache.

    device      the unit between files, memory's latency included
    stimuli     tiles by hand, at random and of scenes' frames
    suite       what is run, in which configurations
    miss_rates  what caches of other sizes and kinds would miss
"""
