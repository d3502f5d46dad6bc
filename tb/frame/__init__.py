"""Whole frames through the RTL, compared with the golden renderer bit for bit.

    whole       through the machine, Gaussians in memory to pixels in memory
    bound       how fast it could be
    simulate    through the rendering array alone
"""
