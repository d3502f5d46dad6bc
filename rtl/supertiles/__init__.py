"""What only machines with lists by super-tile have (`spec.supertiles`).

    tile_test     pairs of splats and super-tiles, and later masks of tiles; its parts are box_steps (two rows of a splat's box
                  at a time), level_table, group_walk (columns that the splat touches, sixteen at a time), pair_expand,
                  mask_expand and event_count; with joint frames pair_union, which makes the pairs of both eyes one
    clip          boxes of splats cut to the super-tiles of their pairs
    buckets       the list of each pair: that of its super-tile or, with depth buckets, of its part of the depth
    bucket_ports  the ports of both
    depth_buckets the one with depth buckets; its parts are bucket_search and bounds_maker
    pair_writer   pairs into the pages of their lists, a beat at a time
    reader        the super-tiles, from the lists' counts and the host's table
    record_fetch  the records of sorted pairs, by their chunks' headers, to projection
    header_cache  the lines of the cache of those headers
    colour        splat records for the batch buffer; its last part is pair_places
    batch_buffer  places of super-tiles in, visits with their entries out
    batch_masks   the tiles of a batch's places, as words by tile
    batch_visits  the visits of a batch's tiles, and the places of their entries
    eyes          what units of machines with joint frames have in common
    list_replay   the lists once more, for tiles of a warped eye with holes
    sweep_turns   for which eyes the pairs of a super-tile are projected, where one may be warped
    warp_strips   the warp unit for two rows of tiles at a time, and the tiles with holes by super-tile
"""
