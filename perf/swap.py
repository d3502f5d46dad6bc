"""The swap of a machine with `lockstep` (rtl/sort_tmu/swap.py): which groups may enter the sorter, leave it and be rendered."""

from __future__ import annotations

from perf.kernel import step
from perf.watch import FETCHING, HANDING, SORTING


@step
def step_swap(s, group_tile, group_drawn):
    """Begins a step if all stages have done their group. It takes effect in the next cycle.

    Args:
        s: the state.
        group_tile: (groups with intersections,) the last tile of each.
        group_drawn: (groups with intersections,) the place of that tile among those that are rendered.
    """
    if s.lockstep == 0:
        return
    s.enter_limit, s.leave_limit, s.show_limit = s.enter_next, s.leave_next, s.show_next
    announced, finished = s.groups_announced, s.groups_finished
    while announced < len(group_tile) and group_tile[announced] < s.swept:
        announced += 1
    while finished < len(group_drawn) and group_drawn[finished] < s.tile_out:
        finished += 1
    s.groups_announced, s.groups_finished = announced, finished
    entered, left = s.group[SORTING], s.group[HANDING]
    if (entered == s.enter_limit or entered == announced) and left == s.leave_limit and finished == s.show_limit:
        s.enter_next, s.leave_next, s.show_next = entered + 1, entered, left


@step
def may_enter(s):
    """Whether the next intersection may enter the sorter."""
    return s.lockstep == 0 or s.group[SORTING] != s.enter_limit


@step
def may_leave(s):
    """Whether the next intersection may leave the sorter."""
    return s.lockstep == 0 or s.group[HANDING] != s.leave_limit


@step
def may_show(s):
    """Whether the next intersection may pass from the double buffer to the splat fetch."""
    return s.lockstep == 0 or s.group[FETCHING] != s.show_limit


@step
def make_room(s):
    """Lets a group larger than the double buffer, which it fills, be rendered from the next cycle on."""
    if s.groups_finished == s.show_limit:
        s.show_next = s.group[HANDING] + 1
