"""The warp unit: warps the source eye's frame, as it leaves the array, into the target eye's frame.

    queue       stores a lane's rows of pixels and delivers their pixels one by one
    divider     floored quotients, one bit per stage
    disparity   computes where a pixel goes
    delay       delays values that bypass the division
    bank        a lane's part of the ring of columns: the nearest pixel wins; complete columns are read and cleared
    window      scans a strip, gives every pixel its neighbours, and finds holes
    fill        fills holes with medians
    pack        packs columns of pixels into beats of rows
    warp_unit   the whole unit, and the rule of which columns are in the ring
"""
