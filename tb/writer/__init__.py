"""Unit test of the pixel writer (`rtl.vrc_array.pixel_writer`) against the golden frame in memory.

    device      the unit between files, with a memory that is idle some cycles after its last write
    stimuli     frames as the array's rows, and as beats
    suite       what is run, in which configurations
"""
