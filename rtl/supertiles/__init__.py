"""What only machines with lists by super-tile have (`spec.supertiles`).

    tile_test   pairs of splats and super-tiles, and later masks of tiles; its parts are run_clip, pair_expand, mask_expand and
                event_count
    clip        boxes of splats cut to the super-tiles of their pairs
    colour      splat records for the batch buffer; its last part is pair_places
"""
