"""The units behind the chunk sorter, stepped cycle by cycle: spilling, merging and the handover (rtl/sort_tmu/)."""

from __future__ import annotations

from perf import bus, swap
from perf.bus import SPILL, W_SPILL
from perf.kernel import step
from perf.layout import Layout
from perf.lists import layout as before
from spec.memory import BEAT_ENTRIES
from spec.queues import SORT_MERGES

layout = Layout(before)
layout.words("capacity sort_taken chunk_out place_out sorted incremental ring_runs used active spilled freeing")
layout.words("pack_full pack_place pack_fence run_queue_in run_queue_out fenced")
layout.words("spill_base ring_beats pack_beat back_beat ring_next part_first parts_closed plan_part")
layout.words("""
    parts_there open_part planning plan_way plan_at merges_planned merges_started merges_finished merges_pending parts_freed
    way_turn spill_read_full fetch_in fetch_out merge_left merged out_left tree_in tree_out spill_read_beat reading
    headless back_full back_place back_last""")
layout.words("line_in line_out half_states filling filled showing half_next source source_last source_half line_size line_mask")

_WRITER_QUEUE, _WAY_BEATS, _WAYS, _TREE, _PENDING = 32, 32, 32, 8, 15
"""RunWriter's depth, RunReader's `way_beats`, the most ways, the entries that the tree holds between its leaves and its output,
and the most merge results that are not yet in memory."""
_PARTS = 32  # more spilled groups than the sorter holds
LINE_MOST = 1 << 17
"""Number of entries of the longest line buffer that a configuration can have."""
layout.ring("half_ends", 2)
layout.ring("run_queue_times", _WRITER_QUEUE)
layout.ring("run_queue_fence", _WRITER_QUEUE)
layout.ring("run_queue_beat", _WRITER_QUEUE)
layout.ring("part_offset", _PARTS)  # where a spilled group's first run begins, in beats from the start of the ring
for _name in ("left", "room", "beat", "in", "out", "place", "entries"):
    layout.ring(f"way_{_name}", _WAYS)
layout.ring("way_times", _WAYS, 2 * _WAY_BEATS)
layout.ring("way_fetched", _WAYS * _WAY_BEATS)
layout.ring("tree_times", _TREE)
layout.ring("line_times", LINE_MOST)

_TREE_LATENCY = 3  # with the paper's eight ways; a beat reaches its way after three cycles, the last node's output takes one


@step
def _beat(s, place, part):
    """The beat of a place in a spilled group's memory; `place` is as in RenderPlan.job_begin."""
    if place < 0:
        return s.spill_base + s.ring_beats - 1 - place
    at = place + s.part_offset[part & _PARTS - 1]
    return s.spill_base + (at - s.ring_beats if at >= s.ring_beats else at)


@step
def _after(s, beat):
    """The beat that follows in a run: the ring's first one after its last."""
    return s.spill_base if beat == s.spill_base + s.ring_beats - 1 else beat + 1


@step
def step_run_writer(s, t, granted):
    """Steps RunWriter: writes the oldest beat and waits at its fence. Merged beats enter its queue before others."""
    at = s.run_queue_out
    if at == s.run_queue_in and s.back_full == 0 and s.pack_full == 0:
        return
    fence = s.run_queue_fence[at & _WRITER_QUEUE - 1]
    if granted:
        bus.write(s, W_SPILL, s.run_queue_beat[at & _WRITER_QUEUE - 1])
        if fence:
            s.fenced = 1
        else:
            s.run_queue_out = at + 1
    elif s.fenced and bus.writes_idle(s, t, W_SPILL):
        s.fenced = 0
        s.run_queue_out = at + 1
        s.parts_there += fence == 1
        s.merges_pending -= fence == 2
    at = s.run_queue_in
    if (s.back_full or s.pack_full) and at - s.run_queue_out < _WRITER_QUEUE:
        s.run_queue_times[at & _WRITER_QUEUE - 1] = t + 2
        s.run_queue_fence[at & _WRITER_QUEUE - 1] = 2 * s.back_last if s.back_full else s.pack_fence
        s.run_queue_in = at + 1
        if s.back_full:
            s.run_queue_beat[at & _WRITER_QUEUE - 1] = s.back_beat
            s.back_beat = _after(s, s.back_beat)
            s.back_full = 0
        else:
            s.run_queue_beat[at & _WRITER_QUEUE - 1] = s.pack_beat
            s.pack_beat = _after(s, s.pack_beat)
            s.pack_full = 0


@step
def writer_asks(s, t):
    """Whether the run writer has a beat for memory."""
    at = s.run_queue_out
    return s.fenced == 0 and at != s.run_queue_in and s.run_queue_times[at & _WRITER_QUEUE - 1] <= t


@step
def _spill(s, t, offers, chunk_length, chunk_spill, chunk_last):
    """Steps SpillDispatch: moves an entry of a spilled chunk into its run."""
    chunk, place = s.chunk_out, s.place_out
    if not offers or chunk_spill[chunk] == 0 or s.pack_full:
        return
    if place == 0:
        if s.used == s.ring_runs:
            return
        s.used += 1
        if s.active == 0:
            s.ring_next = 0
        begins = s.ring_next * (s.capacity // BEAT_ENTRIES)
        s.pack_beat = s.spill_base + begins
        s.ring_next = 0 if s.ring_next + 1 == s.ring_runs else s.ring_next + 1
        if s.part_first == 0:
            s.part_first = 1
            s.part_offset[s.parts_closed & _PARTS - 1] = begins
    s.active = 1
    last = place + 1 == chunk_length[chunk]
    s.spilled += 1
    s.pack_place += 1
    if s.pack_place == BEAT_ENTRIES or last:
        s.pack_full, s.pack_place, s.pack_fence = 1, 0, last and chunk_last[chunk]
    s.place_out = 0 if last else place + 1
    s.chunk_out = chunk + last
    if last and chunk_last[chunk]:
        s.part_first = 0
        s.parts_closed += 1


@step
def _plan(s, t, ways, job_start, job_length, job_out, job_waits, job_begin):
    """Steps MergePlan: plans the merges of a group that is in memory, and assigns runs to ways, in two cycles each."""
    job = s.merges_planned
    if s.planning == 0:
        if s.open_part == 0:
            if s.parts_there:
                s.parts_there -= 1
                s.open_part, s.plan_at = 1, t + 5
            return
        pending = 1 if job_waits[job] else _PENDING
        if t >= s.plan_at and job - s.merges_finished < SORT_MERGES and s.merges_pending < pending:
            s.merges_pending += not job_out[job]
            s.planning, s.plan_way, s.plan_at = 1, 0, t + 4
        return
    way = s.plan_way
    if t < s.plan_at:
        return
    if way < job_start[job + 1] - job_start[job]:
        if s.way_left[way]:
            return
        s.way_left[way] = -(-job_length[job_start[job] + way] // BEAT_ENTRIES)
        s.way_beat[way] = _beat(s, job_begin[job_start[job] + way], s.plan_part)
        s.reading += s.way_left[way]
    s.plan_way, s.plan_at = way + 1, t + 2
    if way + 1 == ways:
        s.merges_planned, s.planning, s.plan_at = job + 1, 0, t + 3
        if job_out[job]:
            s.open_part = 0
            s.plan_part += 1


@step
def _read_runs(s, t, ways, granted):
    """Steps RunReader: requests the next beat of a way, and moves received beats into their ways."""
    if granted:
        bus.read(s, SPILL, s.spill_read_beat)
        s.spill_read_full = 0
    if s.spill_read_full == 0 and s.reading:
        way = s.way_turn
        for _ in range(ways):
            way = 0 if way + 1 == ways else way + 1
            if s.way_left[way] and s.way_room[way]:
                s.way_left[way] -= 1
                s.reading -= 1
                s.way_room[way] -= 1
                s.way_turn, s.spill_read_full = way, 1
                s.spill_read_beat = s.way_beat[way]
                s.way_beat[way] = _after(s, s.way_beat[way])
                s.way_fetched[s.fetch_in & _WAYS * _WAY_BEATS - 1] = way
                s.fetch_in += 1
                break
    if bus.offered(s, SPILL, t):
        bus.take(s, SPILL)
        way = s.way_fetched[s.fetch_out & _WAYS * _WAY_BEATS - 1]
        s.fetch_out += 1
        at = s.way_in[way]
        s.way_times[way, at & 2 * _WAY_BEATS - 1] = t + 3
        s.way_in[way] = at + 1


@step
def _merge(s, t, way_of, job_start, job_length):
    """Steps MergeTree: takes the next entry in order from its way, once every way with entries left shows one."""
    if s.tree_in - s.tree_out >= _TREE - 1:
        return
    if s.merge_left == 0:
        job = s.merges_started
        if job == s.merges_planned:
            return
        s.merges_started = job + 1
        runs, total = job_start[job + 1] - job_start[job], 0
        for way in range(runs):
            s.way_entries[way], s.way_place[way] = job_length[job_start[job] + way], 0
            total += job_length[job_start[job] + way]
        s.merge_left, s.headless = total, (1 << runs) - 1
    headless, way = s.headless, 0
    if headless:
        while headless >> way:
            at = s.way_out[way]
            there = at != s.way_in[way] and s.way_times[way, at & 2 * _WAY_BEATS - 1] <= t
            if there and headless >> way & 1:
                headless &= ~(1 << way)
            way += 1
        s.headless = headless
        if headless:
            return
    way = way_of[s.merged]
    s.merged += 1
    s.way_entries[way] -= 1
    s.way_place[way] += 1
    if s.way_place[way] == BEAT_ENTRIES or s.way_entries[way] == 0:
        s.way_place[way] = 0
        s.way_out[way] += 1
        s.way_room[way] += 1
        if s.way_entries[way]:
            s.headless = 1 << way
    s.tree_times[s.tree_in & _TREE - 1] = t + _TREE_LATENCY
    s.tree_in += 1
    s.merge_left -= 1


@step
def _tree_gives(s, t, job_entries):
    """How many entries of the current merge are left, including the oldest one at the tree's output; 0 if none is there."""
    if s.tree_in == s.tree_out or s.tree_times[s.tree_out & _TREE - 1] > t:
        return 0
    return s.out_left if s.out_left else job_entries[s.merges_finished]


@step
def _take_merged(s, left):
    """Removes the tree's oldest entry; `left` is the value from `_tree_gives`."""
    s.tree_out += 1
    s.out_left = left - 1
    s.merges_finished += left == 1


@step
def _merge_back(s, t, job_entries, job_out, job_goal):
    """Moves an entry of a merge whose result goes back to memory into its beat."""
    left = _tree_gives(s, t, job_entries)
    if left == 0 or job_out[s.merges_finished] or s.back_full:
        return
    if left == job_entries[s.merges_finished]:
        s.back_beat = _beat(s, job_goal[s.merges_finished], s.parts_freed)
    s.back_place += 1
    s.back_last = left == 1
    if s.back_place == BEAT_ENTRIES or left == 1:
        s.back_full, s.back_place = 1, 0
    _take_merged(s, left)


@step
def _sorted(s, t, chunk_offers, chunk_spill, job_entries, job_out):
    """Which entry is offered: 0 for none, -1 for one of the chunk sorter, otherwise the value of `_tree_gives`."""
    if s.active:
        left = _tree_gives(s, t, job_entries)
        return left if left and job_out[s.merges_finished] else 0
    return -1 if chunk_offers and chunk_spill[s.chunk_out] == 0 else 0


@step
def step_sort_out(
    s, t, ways, granted, chunk_offers, group_end, chunk_length, chunk_spill, chunk_last, part_runs, job_start, job_length,
    job_entries, job_out, job_waits, way_of, job_begin, job_goal,
):
    """Moves a sorted entry to the handover. Returns whether one moved. `chunk_offers`: the chunk sorter offers an entry."""
    offers = _sorted(s, t, chunk_offers, chunk_spill, job_entries, job_out)
    freed, moves = s.freeing, False
    s.freeing = 0
    if offers and swap.may_leave(s):
        moves = _hand_over(s, t, group_end[s.sorted])
        if moves:
            s.busy_handover += 1
        else:
            s.blocked_handover += 1
            swap.make_room(s)
    if moves:
        if offers < 0:
            last = s.place_out + 1 == chunk_length[s.chunk_out]
            s.place_out = 0 if last else s.place_out + 1
            s.chunk_out += last
        else:
            _take_merged(s, offers)
            s.spilled -= 1
            if offers == 1:
                s.freeing = part_runs[s.parts_freed]
                s.parts_freed += 1
        s.sorted += 1
    if freed:  # by the entry that left one cycle earlier
        s.used -= freed
        s.active = s.used != 0
    if s.used or (s.ring_runs and chunk_offers):
        _merge_back(s, t, job_entries, job_out, job_goal)
        _spill(s, t, chunk_offers and not (moves and offers < 0), chunk_length, chunk_spill, chunk_last)
        _merge(s, t, way_of, job_start, job_length)
        _read_runs(s, t, ways, granted)
        _plan(s, t, ways, job_start, job_length, job_out, job_waits, job_begin)
    return moves


@step
def _hand_over(s, t, ends):
    """Offers an entry to the line buffer or the double buffer. Returns whether it is taken."""
    if s.incremental:
        at = s.line_in
        if at - s.line_out >= s.line_size:
            return False
        s.line_times[at & s.line_mask] = t + 2
        s.line_in = at + 1
        return True
    half = s.filling
    if s.half_states >> half & 1:
        return False
    s.filled += 1
    if ends or s.filled == s.capacity:
        s.half_ends[half] = s.filled
        s.filling, s.filled = 1 - half, 0
        s.half_states |= 4 << half  # takes effect in the next cycle
    return True


@step
def handover_offers(s, t):
    """Whether the handover offers an entry."""
    if s.incremental:
        at = s.line_out
        return at != s.line_in and s.line_times[at & s.line_mask] <= t
    return s.source != 0 and swap.may_show(s)


@step
def step_handover(s, takes):
    """Steps the output side of the handover."""
    if s.incremental:
        s.line_out += takes
        return
    halves = (s.half_states | s.half_states >> 2) & ~(s.half_states >> 4) & 3  # the state that the previous cycle left
    s.half_states = halves
    if takes:
        s.source = 0
        s.half_states |= (16 << s.source_half) * s.source_last
    shown = s.showing
    if s.source == 0 and halves >> shown & 1 and s.half_next < s.half_ends[shown]:
        s.source, s.source_half = 1, shown
        s.half_next += 1
        s.source_last = s.half_next == s.half_ends[shown]
        if s.source_last:
            s.half_next, s.showing = 0, 1 - shown
