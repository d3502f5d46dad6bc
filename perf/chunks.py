"""The chunk sorter, a cycle a step (rtl/sort_tmu/chunk_sorter.py, merge_stage.py).

All stages give the same entries in the same chunks, each in another order. So an entry's place is a number that counts on from
chunk to chunk, and a stage is a few of them: how many entries it has taken and given, and which of each run of a pair leaves
next. Which of the two it is hangs on the entries themselves: each is known by its place behind the last stage.
"""

from __future__ import annotations

import numpy as np

from perf.kernel import kernel, step

(_GIVEN, _TAKEN, _SIDE, _RUN_ENDS, _CHUNK_IN, _LEVELS, _LEVEL_1, _OLD, _NEW, _OLD_ENDS, _NEW_ENDS, _OLDER, _WAITS,
 _CHUNK_OUT) = (np.uint64(word) for word in range(14))
"""Words of a stage: entries given and taken; side and end of the run that comes, its chunk; entries on each side; of the pair
that leaves the next place of both runs and their ends, the first one's side, whether it waits to know that it has no second,
its chunk. Unsigned, as all places here are: numba takes no time to look whether they count from an array's end."""
_WORDS = np.uint64(16)
_GONE, _AWAKE = np.uint64(1), np.uint64(2)
"""Before the first stage, beside the entries given to it: entries that have left the last one; stages that may do something."""
_PLACES = 8
"""Times a run: places that may lie between an entry that waits and the newest. Those before a stage begin there, too."""


def chunk_stages(capacity: int) -> tuple[np.ndarray, np.ndarray]:
    """An empty sorter of chunks up to `capacity`: its stages' words, behind those of the list reader, and room for entries."""
    return np.zeros(int(_WORDS) * capacity.bit_length(), np.int64), np.zeros(2 * _PLACES * capacity, np.int32)


@step
def _pair(stages, b, run, place, chunk_ends):
    """The next two runs of a chunk, or its last one: the first begins at `place`."""
    chunk = stages[b + _CHUNK_OUT]
    if place == chunk_ends[np.uint64(chunk)]:
        chunk += 1
        stages[b + _CHUNK_OUT] = chunk
    first, ends = chunk_ends[np.uint64(chunk - 1)] if chunk else 0, chunk_ends[np.uint64(chunk)]
    middle = min(place + run, ends)
    stages[b + _OLD], stages[b + _OLD_ENDS], stages[b + _NEW] = place, middle, middle
    stages[b + _NEW_ENDS] = min(middle + run, ends)
    stages[b + _WAITS] = middle == ends and ends - first > max(1, run >> 1)


@kernel
def begin_stages(stages, chunk_ends):
    """Stages before their first chunk."""
    for k in range(len(stages) // 16 - 1):
        b = np.uint64(k + 1) * _WORDS
        _pair(stages, b, 1 << k, 0, chunk_ends)
        stages[b + _RUN_ENDS] = min(1 << k, chunk_ends[0])


@step
def chunk_offers(stages, gone):
    """An entry stands behind the last stage; `gone`: so many have left."""
    return stages[np.uint64(len(stages)) - _WORDS + _GIVEN] != gone


@step
def step_stages(stages, keys, gone, shown, chunk_ends, arrival):
    """A cycle of all stages; `shown`: an entry stands before them; whether it is taken.

    A stage that did nothing does nothing until one beside it has: it sleeps. One that takes an entry wakes the one before it,
    whose output is free, in the same cycle; one that gives wakes the one behind it, which sees the entry in the next.
    """
    count, taken = len(stages) // 16 - 1, stages[_WORDS + _TAKEN]
    awake = stages[_AWAKE]
    if stages[_GONE] != gone:
        stages[_GONE] = gone
        awake |= 1 << count - 1
    if shown and stages[_GIVEN] == taken:
        stages[_GIVEN] = taken + 1
        keys[np.uint64(_PLACES + (taken & _PLACES - 1))] = arrival[np.uint64(taken)]
        awake |= 1
    if awake == 0:
        return False
    later, takes = 0, False
    for k in range(count - 1, -1, -1):
        if awake >> k & 1:
            b = np.uint64(k + 1) * _WORDS
            following = stages[b + _WORDS + _TAKEN] if k < count - 1 else gone
            before, taken, given, run = stages[b - _WORDS + _GIVEN], stages[b + _TAKEN], stages[b + _GIVEN], 1 << k
            side = stages[b + _SIDE]
            takes = before != taken and stages[b + _LEVELS + np.uint64(side)] <= run
            if given == following and _leave(stages, keys, b, before, taken, given, run, chunk_ends):
                later |= 3 << k
            if takes:
                _take(stages, b, taken + 1, side, run, chunk_ends)
                later |= 1 << k
                awake |= 1 << k >> 1
        else:
            takes = False
    stages[_AWAKE] = later & (1 << count) - 1
    return takes


@step
def _take(stages, b, taken, side, run, chunk_ends):
    """An entry to its side; `taken` counts it."""
    stages[b + _TAKEN] = taken
    stages[b + _LEVELS + np.uint64(side)] += 1
    if taken == stages[b + _RUN_ENDS]:
        chunk = stages[b + _CHUNK_IN]
        if taken == chunk_ends[np.uint64(chunk)]:
            chunk += 1
            stages[b + _CHUNK_IN] = chunk
        stages[b + _SIDE] = 1 - side
        stages[b + _RUN_ENDS] = min(taken + run, chunk_ends[np.uint64(chunk)])


@step
def _leave(stages, keys, b, before, taken, given, run, chunk_ends):
    """The next entry of a pair into the stage's output register, if it may leave; whether it does."""
    old, new, old_ends, new_ends = stages[b + _OLD], stages[b + _NEW], stages[b + _OLD_ENDS], stages[b + _NEW_ENDS]
    if stages[b + _WAITS]:
        leaves = before > old_ends or taken == old_ends
    else:
        leaves = before > (new if new < new_ends else old)
    if leaves:
        at, mask = _PLACES * run, _PLACES * run - 1
        key, other = keys[np.uint64(at + (old & mask))], keys[np.uint64(at + (new & mask))]
        second = np.int64((old == old_ends) | ((new < new_ends) & (other < key)))
        keys[np.uint64(2 * at + (given & 2 * mask + 1))] = other if second else key
        stages[b + _WAITS] = 0
        stages[b + _OLD], stages[b + _NEW] = old + 1 - second, new + second
        stages[b + _LEVELS + np.uint64(stages[b + _OLDER] ^ second)] -= 1
        stages[b + _GIVEN] = given + 1
        if old + new + 1 == old_ends + new_ends:
            stages[b + _OLDER] ^= new_ends == old_ends
            _pair(stages, b, run, given + 1, chunk_ends)
    return leaves
