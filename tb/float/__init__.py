"""The float units against float64 and one rounding, by the million.

    device      the units side by side, between files
    stimuli     operands and what must come of them
    suite       the runs of `python -m tb.sim --test float`
"""
