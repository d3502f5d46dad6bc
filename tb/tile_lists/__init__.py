"""Tests of the tile lists (`rtl.tile_lists`), which are written to memory and read back, against `golden.msv2_ref.tile_lists`.

    memory      a memory with latency, as Verilog
    device      the units, connected to the memory
    stimuli     frames by hand, at random and from scenes
    suite       the test plans and their configurations
"""
