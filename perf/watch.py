"""The render phase's counters of its stages' input streams, and what was on the way when."""

from __future__ import annotations

from perf import memory
from perf.layout import Layout

layout = Layout(memory.layout.size)

(BUSY_LIST, BLOCKED_LIST, BUSY_SORT, BLOCKED_SORT, BUSY_HANDOVER, BLOCKED_HANDOVER, BUSY_FETCH, BLOCKED_FETCH, BUSY_ARRAY,
 BLOCKED_ARRAY, BUSY_PIXELS, BLOCKED_PIXELS, BUSY_WARP, BLOCKED_WARP) = layout.words(
    "list_read . sort . handover . fetch . array . pixel_write . warp .")
WATCHED = BUSY_LIST

SORTING, HANDING, FETCHING, BLENDING = range(4)
"""Stages whose times by group are kept; those of rows of pixels are by tile."""

GROUP, OPEN = layout.ring(4), layout.ring(4)
