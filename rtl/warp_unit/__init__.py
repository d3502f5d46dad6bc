"""The warp unit: the source eye's frame, as it leaves the array, to the target eye's.

    queue       a lane's rows of pixels, and their pixels one by one
    divider     floored quotients, a bit a stage
    disparity   where a pixel goes
    delay       what is carried past the division
    bank        a lane's part of the ring of columns: the nearest pixel stays; complete columns are read and cleared
    window      a strip, every pixel with its neighbours; holes
    fill        medians
    pack        columns to beats
    warp_unit   all of it, and which columns are held
"""
