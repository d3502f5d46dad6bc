"""What only machines with lists by super-tile have (`spec.supertiles`).

    buckets          the list of each pair: that of its super-tile or, with depth buckets, of its part of the depth
    bucket_ports     the ports of both
    pair_writer      pairs into the pages of their lists, a beat at a time
    reader           the super-tiles, from the lists' counts and the host's table
"""
