"""The warp unit, a cycle a step (rtl/warp_unit/)."""

from __future__ import annotations

from perf.blending import layout as before
from perf.kernel import step
from perf.layout import Layout

layout = Layout(before.size)
PRESENT, DONE, ROW, WRITE = layout.words("present done row write")


@step
def finished(s):
    """All strips are in memory, or there is nothing to warp."""
    return s[PRESENT] == 0


@step
def step_warp(s, t, granted, offered, row, fills):
    """Whether the row on offer is taken."""
    return offered
