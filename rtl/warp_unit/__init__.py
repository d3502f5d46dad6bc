"""The warp unit: the source eye's frame, as it leaves the array, to the target eye's.

    queue       a lane's rows of pixels, and their pixels one by one
    divider     floored quotients, a bit a stage
    disparity   where a pixel goes
    delay       what is carried past the division
    bank        a lane's part of the open and of the closed strip: the nearest pixel stays
    window      the closed strip, every pixel with its neighbours; holes
    fill        medians
    pack        columns to beats
    warp_unit   all of it, and the order of strips
"""
