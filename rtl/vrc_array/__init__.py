"""The volume rendering array and its neighbours. The modules are listed in the order in which data pass through them.

    splat_fetch   looks up the splat record of each sorted intersection, through a cache
    splat_tags    the tags of that cache
    array         the whole array, with streams at both ends and early stop of a tile
    setup         turns intersections into pixel ops and adds the background ops
    polynomial    the arithmetic of the setup unit
    blocks        issues ops; it holds back drains, and passes an array smaller than a tile over the tile block by block
    expand        expands one polynomial into a row of exponents
    row           a row of pixel cores; each row works one cycle behind the row above
    pixel_core    computes alpha, transmittance and sums of one pixel
    collect       collects finished rows in the output buffer
    blend         blends the two levels of a tile into one
    pixel_writer  writes pixel rows to the frame in memory

Machines with super-tiles keep the state of pixels between visits of a tile:

    batch_array   the whole array, as `array`; its parts are those above with what loads and stores need
    batch_setup, batch_blocks, batch_row, batch_collect
    pixel_state   the state memory, and which tiles have stopped
"""
