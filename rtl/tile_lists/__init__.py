"""What the machine keeps in memory by tile and by Gaussian, written and read back (`spec.memory` says where it lies).

    entry_writer     tile entries into their tiles' pages while culling runs
    list_reader      pages back, a group of tiles behind the other, to the sorter
    page_walk        its requests: which beats hold a tile's entries
    header_maker     the array's tile headers, from counts and the host's table
    table_loader     levels of all tiles into the tile test's table
    geometry_reader  Gaussians to culling
    tile_settings    beats of the host's table to one tile a cycle
    beats            a run of consecutive beats wanted
"""
