"""Simulations of the units that test and read chunks, against the golden renderer.

    chunk_test_stimuli, _suite      headers through the chunk test
    chunk_graph_suite               the same test's datapath alone, with its reasons
    decode_stimuli, decode_suite    compact geometry to words
    reader_stimuli, reader_suite    Gaussians of chunks from memory
"""
