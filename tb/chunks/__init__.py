"""Simulations of the units that test and read chunks, against the golden renderer.

    decode_stimuli, decode_suite    compact geometry to words
    reader_stimuli, reader_suite    Gaussians of chunks from memory
"""
