"""Unit test of the tile test (`rtl.culling.tile_test`) against `golden.msv2_ref.tiling`.

    stimuli     splats and level tables by hand, at random and of scenes' frames; what a frame must cost
    suite       what is run, in which configurations
"""
