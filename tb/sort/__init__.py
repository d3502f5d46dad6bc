"""Unit test of the chunk sorter (`rtl.sort_tmu.chunk_sorter`) against `golden.msv2_ref.sort_tmu`.

    stimuli     chunks by hand, at random and of scenes' groups
    suite       what is run, in which configurations
"""
