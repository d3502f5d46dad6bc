"""The projection unit's test: near test, projection and box test, in Verilator.

    stimuli     points by hand, at random and of rendered frames, and what the golden renderer makes of them
    suite       the plans, and how fast
"""
