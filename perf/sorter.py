"""The units behind the chunk sorter, stepped cycle by cycle: spilling, merging and the handover (rtl/sort_tmu/)."""

from __future__ import annotations

from perf import bus
from perf.bus import SPILL, W_SPILL
from perf.kernel import step
from perf.layout import Layout
from perf.lists import layout as before
from perf.watch import BLOCKED_HANDOVER, BUSY_HANDOVER
from spec.memory import BEAT_ENTRIES
from spec.queues import SORT_MERGES

layout = Layout(before.size)
CAPACITY, TAKEN, CHUNK_OUT, PLACE_OUT, SORTED, INCREMENTAL, RING_RUNS, USED, ACTIVE, SPILLED, FREEING = layout.words(
    "capacity taken chunk_out place_out sorted incremental ring_runs used active spilled freeing")
(PACK_FULL, PACK_PLACE, PACK_FENCE, QUEUE_IN, QUEUE_OUT, FENCED, W_BEAT) = layout.words(
    "pack_full pack_place pack_fence queue_in queue_out fenced w_beat")
(PARTS_THERE, OPEN_PART, PLANNING, PLAN_WAY, PLAN_AT, PLANNED, STARTED, FINISHED, PENDING, FREED, TURN, READ_FULL, FETCH_IN,
 FETCH_OUT, MERGE_LEFT, MERGED, OUT_LEFT, TREE_IN, TREE_OUT, SPILL_BASE, READ_BEAT, READING, HEADLESS, BACK_FULL, BACK_PLACE,
 BACK_LAST) = layout.words(
    "parts_there open_part planning plan_way plan_at planned started finished pending freed turn read_full fetch_in "
    "fetch_out merge_left merged out_left tree_in tree_out spill_base read_beat reading headless back_full back_place "
    "back_last")
(H_IN, H_OUT, HALVES, FILLING, FILLED, SHOWING, NEXT, SOURCE, SOURCE_LAST, SOURCE_HALF) = layout.words(
    "h_in h_out halves filling filled showing next source source_last source_half")
H_ENDS, (LINE, H_MASK, H_TIMES) = layout.ring(2), layout.words("line h_mask h_times")  # the line buffer follows all other words

_WRITER_QUEUE, _WAY_BEATS, _WAYS, _TREE, _PENDING = 32, 32, 32, 8, 15
"""RunWriter's depth, RunReader's `way_beats`, the most ways, the entries that the tree holds between its leaves and its output,
and the most merge results that are not yet in memory."""
Q_TIMES, Q_FENCE = layout.ring(_WRITER_QUEUE), layout.ring(_WRITER_QUEUE)
WAY_LEFT, WAY_ROOM, WAY_IN, WAY_OUT, WAY_PLACE, WAY_ENTRIES, WAY_BASE = (layout.ring(_WAYS) for _ in range(7))
WAY_TIMES = layout.ring(2 * _WAY_BEATS * _WAYS)
FETCHED = layout.ring(_WAYS * _WAY_BEATS)
TREE = layout.ring(_TREE)

_TREE_LATENCY = 3  # with the paper's eight ways; a beat reaches its way after three cycles, the last node's output takes one


@step
def step_run_writer(s, t, granted):
    """Steps RunWriter: writes the oldest beat and waits at its fence. Merged beats enter its queue before others."""
    at = s[QUEUE_OUT]
    if at == s[QUEUE_IN] and s[BACK_FULL] == 0 and s[PACK_FULL] == 0:
        return
    fence = s[Q_FENCE + (at & _WRITER_QUEUE - 1)]
    if granted:
        bus.write(s, W_SPILL, s[SPILL_BASE] + s[W_BEAT])
        s[W_BEAT] += 1
        if fence:
            s[FENCED] = 1
        else:
            s[QUEUE_OUT] = at + 1
    elif s[FENCED] and bus.writes_idle(s, t, W_SPILL):
        s[FENCED] = 0
        s[QUEUE_OUT] = at + 1
        s[PARTS_THERE] += fence == 1
        s[PENDING] -= fence == 2
    at = s[QUEUE_IN]
    if (s[BACK_FULL] or s[PACK_FULL]) and at - s[QUEUE_OUT] < _WRITER_QUEUE:
        s[Q_TIMES + (at & _WRITER_QUEUE - 1)] = t + 2
        s[Q_FENCE + (at & _WRITER_QUEUE - 1)] = 2 * s[BACK_LAST] if s[BACK_FULL] else s[PACK_FENCE]
        s[QUEUE_IN] = at + 1
        if s[BACK_FULL]:
            s[BACK_FULL] = 0
        else:
            s[PACK_FULL] = 0


@step
def writer_asks(s, t):
    """Whether the run writer has a beat for memory."""
    at = s[QUEUE_OUT]
    return s[FENCED] == 0 and at != s[QUEUE_IN] and s[Q_TIMES + (at & _WRITER_QUEUE - 1)] <= t


@step
def _spill(s, t, offers, chunk_length, chunk_spill, chunk_last):
    """Steps SpillDispatch: moves an entry of a spilled chunk into its run."""
    chunk, place = s[CHUNK_OUT], s[PLACE_OUT]
    if not offers or chunk_spill[chunk] == 0 or s[PACK_FULL]:
        return
    if place == 0:
        if s[USED] == s[RING_RUNS]:
            return
        s[USED] += 1
    s[ACTIVE] = 1
    last = place + 1 == chunk_length[chunk]
    s[SPILLED] += 1
    s[PACK_PLACE] += 1
    if s[PACK_PLACE] == BEAT_ENTRIES or last:
        s[PACK_FULL], s[PACK_PLACE], s[PACK_FENCE] = 1, 0, last and chunk_last[chunk]
    s[PLACE_OUT] = 0 if last else place + 1
    s[CHUNK_OUT] = chunk + last


@step
def _plan(s, t, ways, job_start, job_length, job_out, job_waits):
    """Steps MergePlan: plans the merges of a group that is in memory, and assigns runs to ways, in two cycles each."""
    job = s[PLANNED]
    if s[PLANNING] == 0:
        if s[OPEN_PART] == 0:
            if s[PARTS_THERE]:
                s[PARTS_THERE] -= 1
                s[OPEN_PART], s[PLAN_AT] = 1, t + 5
        elif t >= s[PLAN_AT] and job - s[FINISHED] < SORT_MERGES and s[PENDING] < (1 if job_waits[job] else _PENDING):
            s[PENDING] += not job_out[job]
            s[PLANNING], s[PLAN_WAY], s[PLAN_AT] = 1, 0, t + 4
        return
    way = s[PLAN_WAY]
    if t < s[PLAN_AT]:
        return
    if way < job_start[job + 1] - job_start[job]:
        if s[WAY_LEFT + way]:
            return
        s[WAY_LEFT + way] = -(-job_length[job_start[job] + way] // BEAT_ENTRIES)
        s[READING] += s[WAY_LEFT + way]
    s[PLAN_WAY], s[PLAN_AT] = way + 1, t + 2
    if way + 1 == ways:
        s[PLANNED], s[PLANNING], s[PLAN_AT] = job + 1, 0, t + 3
        if job_out[job]:
            s[OPEN_PART] = 0


@step
def _read_runs(s, t, ways, granted):
    """Steps RunReader: requests the next beat of a way, and moves received beats into their ways."""
    if granted:
        bus.read(s, SPILL, s[SPILL_BASE] + s[READ_BEAT])
        s[READ_BEAT] += 1
        s[READ_FULL] = 0
    if s[READ_FULL] == 0 and s[READING]:
        way = s[TURN]
        for _ in range(ways):
            way = 0 if way + 1 == ways else way + 1
            if s[WAY_LEFT + way] and s[WAY_ROOM + way]:
                s[WAY_LEFT + way] -= 1
                s[READING] -= 1
                s[WAY_ROOM + way] -= 1
                s[TURN], s[READ_FULL] = way, 1
                s[FETCHED + (s[FETCH_IN] & _WAYS * _WAY_BEATS - 1)] = way
                s[FETCH_IN] += 1
                break
    if bus.offered(s, SPILL, t):
        bus.take(s, SPILL)
        way = s[FETCHED + (s[FETCH_OUT] & _WAYS * _WAY_BEATS - 1)]
        s[FETCH_OUT] += 1
        at = s[WAY_IN + way]
        s[WAY_TIMES + way * 2 * _WAY_BEATS + (at & 2 * _WAY_BEATS - 1)] = t + 3
        s[WAY_IN + way] = at + 1


@step
def _merge(s, t, way_of, job_start, job_length):
    """Steps MergeTree: takes the next entry in order from its way, once every way with entries left shows one."""
    if s[TREE_IN] - s[TREE_OUT] >= _TREE - 1:
        return
    if s[MERGE_LEFT] == 0:
        job = s[STARTED]
        if job == s[PLANNED]:
            return
        s[STARTED] = job + 1
        runs, total = job_start[job + 1] - job_start[job], 0
        for way in range(runs):
            s[WAY_ENTRIES + way], s[WAY_PLACE + way] = job_length[job_start[job] + way], 0
            total += job_length[job_start[job] + way]
        s[MERGE_LEFT], s[HEADLESS] = total, (1 << runs) - 1
    headless, way = s[HEADLESS], 0
    if headless:
        while headless >> way:
            at = s[WAY_OUT + way]
            there = at != s[WAY_IN + way] and s[WAY_TIMES + way * 2 * _WAY_BEATS + (at & 2 * _WAY_BEATS - 1)] <= t
            if there and headless >> way & 1:
                headless &= ~(1 << way)
            way += 1
        s[HEADLESS] = headless
        if headless:
            return
    way = way_of[s[MERGED]]
    s[MERGED] += 1
    s[WAY_ENTRIES + way] -= 1
    s[WAY_PLACE + way] += 1
    if s[WAY_PLACE + way] == BEAT_ENTRIES or s[WAY_ENTRIES + way] == 0:
        s[WAY_PLACE + way] = 0
        s[WAY_OUT + way] += 1
        s[WAY_ROOM + way] += 1
        if s[WAY_ENTRIES + way]:
            s[HEADLESS] = 1 << way
    s[TREE + (s[TREE_IN] & _TREE - 1)] = t + _TREE_LATENCY
    s[TREE_IN] += 1
    s[MERGE_LEFT] -= 1


@step
def _tree_gives(s, t, job_entries):
    """How many entries of the current merge are left, including the oldest one at the tree's output; 0 if none is there."""
    if s[TREE_IN] == s[TREE_OUT] or s[TREE + (s[TREE_OUT] & _TREE - 1)] > t:
        return 0
    return s[OUT_LEFT] if s[OUT_LEFT] else job_entries[s[FINISHED]]


@step
def _take_merged(s, left):
    """Removes the tree's oldest entry; `left` is the value from `_tree_gives`."""
    s[TREE_OUT] += 1
    s[OUT_LEFT] = left - 1
    s[FINISHED] += left == 1


@step
def _merge_back(s, t, job_entries, job_out):
    """Moves an entry of a merge whose result goes back to memory into its beat."""
    left = _tree_gives(s, t, job_entries)
    if left == 0 or job_out[s[FINISHED]] or s[BACK_FULL]:
        return
    s[BACK_PLACE] += 1
    s[BACK_LAST] = left == 1
    if s[BACK_PLACE] == BEAT_ENTRIES or left == 1:
        s[BACK_FULL], s[BACK_PLACE] = 1, 0
    _take_merged(s, left)


@step
def _sorted(s, t, chunk_offers, chunk_spill, job_entries, job_out):
    """Which entry is offered: 0 for none, -1 for one of the chunk sorter, otherwise the value of `_tree_gives`."""
    if s[ACTIVE]:
        left = _tree_gives(s, t, job_entries)
        return left if left and job_out[s[FINISHED]] else 0
    return -1 if chunk_offers and chunk_spill[s[CHUNK_OUT]] == 0 else 0


@step
def step_sort_out(
    s, t, ways, granted, chunk_offers, group_end, chunk_length, chunk_spill, chunk_last, part_runs, job_start, job_length,
    job_entries, job_out, job_waits, way_of,
):
    """Moves a sorted entry to the handover. Returns whether one moved. `chunk_offers`: the chunk sorter offers an entry."""
    offers = _sorted(s, t, chunk_offers, chunk_spill, job_entries, job_out)
    freed, moves = s[FREEING], False
    s[FREEING] = 0
    if offers:
        moves = _hand_over(s, t, group_end[s[SORTED]])
        if moves:
            s[BUSY_HANDOVER] += 1
        else:
            s[BLOCKED_HANDOVER] += 1
    if moves:
        if offers < 0:
            last = s[PLACE_OUT] + 1 == chunk_length[s[CHUNK_OUT]]
            s[PLACE_OUT] = 0 if last else s[PLACE_OUT] + 1
            s[CHUNK_OUT] += last
        else:
            _take_merged(s, offers)
            s[SPILLED] -= 1
            if offers == 1:
                s[FREEING] = part_runs[s[FREED]]
                s[FREED] += 1
        s[SORTED] += 1
    if freed:  # by the entry that left one cycle earlier
        s[USED] -= freed
        s[ACTIVE] = s[USED] != 0
    if s[USED] or (s[RING_RUNS] and chunk_offers):
        _merge_back(s, t, job_entries, job_out)
        _spill(s, t, chunk_offers and not (moves and offers < 0), chunk_length, chunk_spill, chunk_last)
        _merge(s, t, way_of, job_start, job_length)
        _read_runs(s, t, ways, granted)
        _plan(s, t, ways, job_start, job_length, job_out, job_waits)
    return moves


@step
def _hand_over(s, t, ends):
    """Offers an entry to the line buffer or the double buffer. Returns whether it is taken."""
    if s[INCREMENTAL]:
        at = s[H_IN]
        if at - s[H_OUT] >= s[LINE]:
            return False
        s[s[H_TIMES] + (at & s[H_MASK])] = t + 2
        s[H_IN] = at + 1
        return True
    half = s[FILLING]
    if s[HALVES] >> half & 1:
        return False
    s[FILLED] += 1
    if ends or s[FILLED] == s[CAPACITY]:
        s[H_ENDS + half] = s[FILLED]
        s[FILLING], s[FILLED] = 1 - half, 0
        s[HALVES] |= 4 << half  # takes effect in the next cycle
    return True


@step
def handover_offers(s, t):
    """Whether the handover offers an entry."""
    if s[INCREMENTAL]:
        at = s[H_OUT]
        return at != s[H_IN] and s[s[H_TIMES] + (at & s[H_MASK])] <= t
    return s[SOURCE] != 0


@step
def step_handover(s, takes):
    """Steps the output side of the handover."""
    if s[INCREMENTAL]:
        s[H_OUT] += takes
        return
    halves = (s[HALVES] | s[HALVES] >> 2) & ~(s[HALVES] >> 4) & 3  # the state that the previous cycle left
    s[HALVES] = halves
    if takes:
        s[SOURCE] = 0
        s[HALVES] |= (16 << s[SOURCE_HALF]) * s[SOURCE_LAST]
    shown = s[SHOWING]
    if s[SOURCE] == 0 and halves >> shown & 1 and s[NEXT] < s[H_ENDS + shown]:
        s[SOURCE], s[SOURCE_HALF] = 1, shown
        s[NEXT] += 1
        s[SOURCE_LAST] = s[NEXT] == s[H_ENDS + shown]
        if s[SOURCE_LAST]:
            s[NEXT], s[SHOWING] = 0, 1 - shown
