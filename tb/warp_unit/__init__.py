"""Unit test of the warp unit (`rtl.warp_unit`) against the golden renderer's target eye.

    device      the unit between files, with a memory that is idle some cycles after its last write
    stimuli     frames that meet every case, as the array's rows; the target eye's as beats and tiles
    cones       a photograph and its true disparities; how close the warped one comes to the other eye's
    suite       what is run, in which configurations
"""
