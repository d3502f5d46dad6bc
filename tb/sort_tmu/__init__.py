"""Unit tests of the chunk sorter and of the hierarchical sorter around it against `golden.msv2_ref.sort`.

    stimuli         chunks and groups by hand, at random and of scenes
    suite           the chunk sorter's: what is run, in which configurations
    hierarchical    the hierarchical sorter's (`rtl.sort_tmu.hierarchical_sorter`), with a memory at its ports
"""
