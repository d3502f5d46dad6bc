"""Tests of the warp unit (`rtl.warp_unit`) against the golden renderer's target eye.

    device      the unit in a test bench, with a memory that becomes idle some cycles after its last write
    stimuli     frames that cover every case of the warp: the array's rows, and the expected beats and tiles of the target eye
    cones       a photograph with true disparities; measures how close the warped photograph comes to the other eye's
    suite       the test plans and their configurations
"""
