"""Counters of the rendering phase: the activity at each stage's input, and the times of groups in the stages."""

from __future__ import annotations

from perf import memory
from perf.layout import Layout

layout = Layout(memory.layout.size)

(BUSY_LIST, BLOCKED_LIST, BUSY_SORT, BLOCKED_SORT, BUSY_HANDOVER, BLOCKED_HANDOVER, BUSY_FETCH, BLOCKED_FETCH, BUSY_ARRAY,
 BLOCKED_ARRAY, BUSY_PIXELS, BLOCKED_PIXELS, BUSY_WARP, BLOCKED_WARP) = layout.words(
    "list_read . sort . handover . fetch . array . pixel_write . warp .")
WATCHED = BUSY_LIST

SORTING, HANDING, FETCHING, BLENDING = range(4)
"""Stages for which the times of each group are recorded. For rows of pixels the times are recorded by tile."""

GROUP, OPEN = layout.ring(4), layout.ring(4)
