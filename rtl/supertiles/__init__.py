"""What only machines with lists by super-tile have (`spec.supertiles`).

    record_fetch  the records of sorted pairs, by their chunks' headers, to projection
    header_cache  the lines of the cache of those headers
    batch_buffer  places of super-tiles in, visits with their entries out
    batch_masks   the tiles of a batch's places, as words by tile
    batch_visits  the visits of a batch's tiles, and the places of their entries
"""
