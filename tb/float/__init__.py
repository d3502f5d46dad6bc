"""Tests of the floating-point units with millions of operands: each result is one operation in float64, rounded once.

    device      the units side by side in one test bench
    stimuli     operands and expected results
    suite       the runs of `python -m tb.sim --test float`
"""
