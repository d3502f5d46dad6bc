"""The bit-matched integer renderer: one module per RTL unit, pure functions from record arrays to record arrays.

    quantise    model -> Gaussian words (the DRAM image)
    culling     Gaussian words -> Splat2D and tile entries
    sort_tmu    tile entries -> ordered entries, tile groups
    vrc_array   ordered entries -> pixels
    pipeline    all of it for one frame, with the host's registers; any arrow can be dumped
"""
