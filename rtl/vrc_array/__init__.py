"""The volume rendering array and what stands on either side of it, in the order of the data.

    splat_fetch   sorted tile entries to the array's entries, through a cache of splat views
    splat_tags    the tags of that cache
    array         the whole: streams at both ends, tile-level early stop, `emit_vrc_array`
    setup         entries to pixel ops, background ops included
    polynomial    the setup unit's arithmetic
    blocks        issue: drains held back; arrays smaller than a tile pass over it block by block
    expand        one polynomial to a row of exponents
    row           a row of pixel cores; rows work one cycle behind each other
    pixel_core    alpha, transmittance and sums of one pixel
    collect       finished rows into the output buffer
    blend         two levels to one
    pixel_writer  pixel rows to the frame in memory
"""
