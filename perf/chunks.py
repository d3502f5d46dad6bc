"""The chunk sorter, a cycle a step (rtl/sort_tmu/chunk_sorter.py, merge_stage.py).

All stages give the same entries in the same chunks, each in another order. So an entry's place is a number that counts on from
chunk to chunk, and a stage is a few of them: how many entries it has taken and given, and which of each run of a pair leaves
next. Which of the two it is hangs on the entries themselves: each is known by its place behind the last stage.
"""

from __future__ import annotations

import numpy as np

from perf.kernel import kernel, step

(_GIVEN, _TAKEN, _LEVEL, _NEED, _OLD, _NEW, _OLD_ENDS, _NEW_ENDS, _APART, _RUN_ENDS, _CHUNK_IN, _CHUNK_OUT) = (
    np.uint64(word) for word in range(12))
"""Words of a stage: entries given and taken; how many wait on the side of the run that comes; the place of an entry that must
stand before the stage, or have been taken, before the next one leaves; of the pair that leaves the next place of both runs and
their ends, and whether the first one's side is not that of the run that comes; the end of that run, its chunk, and that of the
pair. Unsigned, as all places here are: numba takes no time to look whether they count from an array's end."""
_WORDS = np.uint64(16)
_GONE, _AWAKE = np.uint64(1), np.uint64(2)
"""Before the first stage, beside the entries given to it: entries that have left the last one; whether a stage has moved."""
_PLACES = 8
"""Times a run: places that may lie between an entry that waits and the newest. Those before a stage begin there, too."""


def chunk_stages(capacity: int) -> tuple[np.ndarray, np.ndarray]:
    """An empty sorter of chunks up to `capacity`: its stages' words, behind those of the list reader, and room for entries."""
    return np.zeros(int(_WORDS) * capacity.bit_length(), np.int64), np.zeros(2 * _PLACES * capacity, np.int32)


@step
def _pair(stages, b, run, place, taken, chunk_ends):
    """The next two runs of a chunk, or its last one: the first begins at `place`. Entries up to `taken` are in the stage.

    One that has no second leaves when that is known: an entry behind its last one stands before the stage, or the last one is
    in the stage; or at once where the stage before knew.
    """
    chunk = stages[b + _CHUNK_OUT]
    if place == chunk_ends[np.uint64(chunk)]:
        chunk += 1
        stages[b + _CHUNK_OUT] = chunk
    first, ends = chunk_ends[np.uint64(chunk - 1)] if chunk else 0, chunk_ends[np.uint64(chunk)]
    middle = min(place + run, ends)
    stages[b + _OLD], stages[b + _OLD_ENDS], stages[b + _NEW] = place, middle, middle
    stages[b + _NEW_ENDS] = min(middle + run, ends)
    known = middle == ends and (ends - first <= max(1, run >> 1) or taken >= middle)
    stages[b + _NEED] = place if known else middle


@kernel
def begin_stages(stages, chunk_ends):
    """Stages before their first chunk."""
    for k in range(len(stages) // 16 - 1):
        b = np.uint64(k + 1) * _WORDS
        _pair(stages, b, 1 << k, 0, 0, chunk_ends)
        stages[b + _RUN_ENDS] = min(1 << k, chunk_ends[0])


@step
def chunk_offers(stages, gone):
    """An entry stands behind the last stage; `gone`: so many have left."""
    return stages[np.uint64(len(stages)) - _WORDS + _GIVEN] != gone


@step
def step_stages(stages, keys, gone, shown, chunk_ends, arrival):
    """A cycle of all stages; `shown`: an entry stands before them; whether it is taken.

    Where nothing moved and nothing came or left, nothing moves in the next cycle. A stage sees what the one behind it takes in
    this cycle, as that says whether its output is free, and what the one before it gave in the last.
    """
    place, moved = stages[_WORDS + _TAKEN], stages[_AWAKE]
    if stages[_GONE] != gone:
        stages[_GONE] = gone
        moved = 1
    if shown and stages[_GIVEN] == place:
        stages[_GIVEN] = place + 1
        keys[np.uint64(_PLACES + (place & _PLACES - 1))] = arrival[np.uint64(place)]
        moved = 1
    if moved == 0:
        return False
    b, moved, takes = np.uint64(len(stages)) - _WORDS, 0, False
    run, following, given = 1 << (len(stages) // 16 - 2), gone, stages[b + _GIVEN]
    while run:
        before, taken, level = stages[b - _WORDS + _GIVEN], stages[b + _TAKEN], stages[b + _LEVEL]
        takes = before != taken and level <= run
        if given == following and before > stages[b + _NEED]:
            level -= _leave(stages, keys, b, run, given, taken, chunk_ends)
            given += 1
            moved = 1
        if takes:
            taken += 1
            level += 1
            moved = 1
            stages[b + _TAKEN] = taken
            if taken == stages[b + _RUN_ENDS]:
                _turn(stages, b, run, taken, chunk_ends)
                level = taken - given - level
        stages[b + _LEVEL] = level
        given, following = before, taken
        b -= _WORDS
        run >>= 1
    stages[_AWAKE] = moved
    return takes


@step
def _leave(stages, keys, b, run, given, taken, chunk_ends):
    """The next entry of a pair into the stage's output register; whether it was on the side of the run that comes."""
    old, new, old_ends, new_ends = stages[b + _OLD], stages[b + _NEW], stages[b + _OLD_ENDS], stages[b + _NEW_ENDS]
    at, mask, apart = _PLACES * run, _PLACES * run - 1, stages[b + _APART]
    key, other = keys[np.uint64(at + (old & mask))], keys[np.uint64(at + (new & mask))]
    second = np.int64((old == old_ends) | ((new < new_ends) & (other < key)))
    keys[np.uint64(2 * at + (given & 2 * mask + 1))] = other if second else key
    old, new = old + 1 - second, new + second
    stages[b + _GIVEN] = given + 1
    if old + new == old_ends + new_ends:
        stages[b + _APART] = apart ^ (old_ends == new_ends)  # one alone: the next pair begins on the other side
        _pair(stages, b, run, given + 1, taken, chunk_ends)
    else:
        stages[b + _OLD], stages[b + _NEW] = old, new
        stages[b + _NEED] = new if new < new_ends else old
    return 1 - (apart ^ second)


@step
def _turn(stages, b, run, taken, chunk_ends):
    """The run that comes is complete: the next one goes to the other side."""
    chunk = stages[b + _CHUNK_IN]
    if taken == chunk_ends[np.uint64(chunk)]:
        chunk += 1
        stages[b + _CHUNK_IN] = chunk
    stages[b + _APART] ^= 1
    stages[b + _RUN_ENDS] = min(taken + run, chunk_ends[np.uint64(chunk)])
    if stages[b + _OLD_ENDS] == taken and stages[b + _NEW_ENDS] == taken:
        stages[b + _NEED] = stages[b + _OLD]
