"""Counters of the rendering phase: the activity at each stage's input, and the times of groups in the stages."""

from __future__ import annotations

from perf import memory
from perf.layout import Layout
from spec.stages import StagePhase, watched

layout = Layout(memory.layout)
layout.counters(*watched(StagePhase.RENDERING, StagePhase.SECOND_EYE))

SORTING, HANDING, FETCHING, BLENDING = range(4)
"""Stages for which the times of each group are recorded. For rows of pixels the times are recorded by tile."""

layout.ring("group", 4)
layout.ring("group_open", 4)
layout.words("""
    lockstep enter_limit leave_limit show_limit enter_next leave_next show_next groups_announced groups_finished""")
