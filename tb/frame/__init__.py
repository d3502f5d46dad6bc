"""Runs whole frames through the RTL and compares them with the golden renderer bit for bit.

    whole       runs a frame through the whole machine, from Gaussians in memory to pixels in memory
    eyes        runs a frame of two eyes through the whole machine
    bound       a lower bound on a frame's cycles
    simulate    runs a frame through the rendering array alone
"""
