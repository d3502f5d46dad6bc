"""The bit-matched integer renderer: one module for each stage, pure functions from record arrays to record arrays.

    projection    Gaussian words -> projected splats (mean, conic, depth, bounding box)
    tile_test     projected splats -> intersections, that is (splat, tile) pairs
    colour        spherical harmonics -> one colour for each level
    tile_lists    intersections -> pages of the tiles in memory
    tile_merge    number of intersections in each tile -> groups of tiles
    sort          intersections -> intersections in rendering order
    fetch         intersections -> hits and misses of the splat cache
    array         intersections in rendering order -> pixels
    warp          pixels of the source eye -> pixels of the target eye
    pipeline      all stages of one frame; the output of any of them can be dumped
    eyes, plan    a frame of two eyes; a frame with only the effects that it needs
"""
