"""What only machines with lists by super-tile have (`spec.supertiles`).

    record_fetch  the records of sorted pairs, by their chunks' headers, to projection
    header_cache  the lines of the cache of those headers
"""
