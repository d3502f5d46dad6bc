"""A model in chunks: headers are read and tested, and the Gaussians of chunks that may be seen are read and decoded.

    header_reader     headers from memory
    level_bounds      the tiles that splats of each quality bound can touch, as octagons
    chunk_test        headers of chunks of which something may be seen
    chunk_reader      the Gaussians of tested chunks from memory, in front of projection
    decode            decoders of compact records, as logic without registers
    geometry_decode   compact geometry to the words of `spec.records`
"""
