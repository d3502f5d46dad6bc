"""Units that write and read data in memory by tile and by Gaussian. `spec.memory` has the memory map.

    entry_writer     writes intersections into the pages of their tiles during the geometry phase
    list_reader      reads the pages of one group of tiles after the other for the sorter
    page_walk        makes the list reader's requests: it finds the beats that hold a tile's intersections
    header_maker     makes the array's tile headers from the tiles' counts and the host's table
    table_loader     loads the levels of all tiles into the tile test's table
    geometry_reader  reads Gaussians for projection
    tile_settings    unpacks beats of the host's table into one tile per cycle
    beats            requests a run of consecutive beats
"""
