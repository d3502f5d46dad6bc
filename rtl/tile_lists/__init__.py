"""What the machine keeps in memory by tile and by Gaussian, written and read back (`spec.memory` says where it lies).

    entry_writer     tile entries into their tiles' pages while culling runs; `emit_entry_writer`
    list_reader      pages back, a group of tiles behind the other, to the sorter; `emit_list_reader`
    page_walk        its requests: which beats hold a tile's entries
    header_maker     the array's tile headers, from counts and the host's table; `emit_header_maker`
    table_loader     levels of all tiles into the tile test's table; `emit_table_loader`
    geometry_reader  Gaussians to culling; `emit_geometry_reader`
    tile_settings    beats of the host's table to one tile a cycle
    beats            a run of consecutive beats wanted
"""
