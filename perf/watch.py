"""The render phase's counters of its stages' input streams, and what was on the way when."""

from __future__ import annotations

from perf import memory
from perf.layout import Layout
from spec.stages import StagePhase, watched

layout = Layout(memory.layout)
layout.counters(*watched(StagePhase.RENDERING, StagePhase.SECOND_EYE))

SORTING, HANDING, FETCHING, BLENDING = range(4)
"""Stages whose times by group are kept; those of rows of pixels are by tile."""

layout.ring("group", 4)
layout.ring("group_open", 4)
