"""The chunk sorter, stepped cycle by cycle (rtl/sort_tmu/chunk_sorter.py, merge_stage.py).

All stages output the same entries in the same chunks, but each in another order. So the model numbers the places of entries
consecutively over all chunks. The state of a stage consists of such numbers: how many entries it has taken and given, and which
entry of either run of a pair leaves next. Which of these two leaves first depends on the entries. Each entry is represented by
its place in the final order, so that comparing places compares keys.
"""

from __future__ import annotations

import numpy as np

from perf.kernel import kernel, step

(_GIVEN, _TAKEN, _LEVEL, _NEED, _OLD, _NEW, _OLD_ENDS, _NEW_ENDS, _APART, _RUN_ENDS, _CHUNK_IN, _CHUNK_OUT) = (
    np.uint64(word) for word in range(12))
"""Words of a stage.

    _GIVEN, _TAKEN          the numbers of entries given and taken
    _LEVEL                  how many entries wait on the side of the incoming run
    _NEED                   the place of an entry that must have reached the stage's input before the next entry leaves
    _OLD, _NEW, _OLD_ENDS, _NEW_ENDS    of the outgoing pair, the next places of both runs, and their ends
    _APART                  whether the side of the pair's first run is not that of the incoming run
    _RUN_ENDS, _CHUNK_IN    the end of the incoming run, and its chunk
    _CHUNK_OUT              the chunk of the outgoing pair

Indices are unsigned because numba then need not check whether they count from the end of an array.
"""
_WORDS = np.uint64(16)
_GONE, _AWAKE = np.uint64(1), np.uint64(2)
"""Words before those of the first stage: the number of entries that have left the last stage, and whether any stage moved in
the previous cycle. The word _GIVEN there counts the entries offered to the first stage."""
_PLACES = 8
"""The ring buffer of a stage's entries has _PLACES times the length of its runs. The buffer of the stage with runs of length r
begins at index _PLACES r."""


def chunk_stages(capacity: int) -> tuple[np.ndarray, np.ndarray]:
    """An empty sorter of chunks up to `capacity`: the words of its stages, behind those for its input, and space for
    entries."""
    return np.zeros(int(_WORDS) * capacity.bit_length(), np.int64), np.zeros(2 * _PLACES * capacity, np.int32)


@step
def _pair(stages, b, run, place, taken, chunk_ends):
    """Sets up the next pair of runs of a chunk, or its last single run. The first run begins at `place`, and the stage has
    taken the entries up to `taken`.

    A run without a second one may leave only when it is known to be single. That is known when the entry after its last one
    has reached the stage's input, when its last entry is in the stage, or at once if the stage before knew it already.
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
    """Sets up the stages for their first chunk."""
    for k in range(len(stages) // 16 - 1):
        b = np.uint64(k + 1) * _WORDS
        _pair(stages, b, 1 << k, 0, 0, chunk_ends)
        stages[b + _RUN_ENDS] = min(1 << k, chunk_ends[0])


@step
def chunk_offers(stages, gone):
    """Whether the last stage offers an entry. `gone` is the number of entries that have left it."""
    return stages[np.uint64(len(stages)) - _WORDS + _GIVEN] != gone


@step
def step_stages(stages, keys, gone, shown, chunk_ends, arrival):
    """Steps all stages by a cycle. `shown` says that an entry is offered to the first stage. Returns whether it is taken.

    If nothing moved in a cycle and no entry came or left, nothing moves in the next one. A stage sees what the stage after it
    takes in this cycle, which decides whether its own output is free, and what the stage before it gave in the previous cycle.
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
    """Moves the next entry of the pair into the output register. Returns whether it was on the side of the incoming run."""
    old, new, old_ends, new_ends = stages[b + _OLD], stages[b + _NEW], stages[b + _OLD_ENDS], stages[b + _NEW_ENDS]
    at, mask, apart = _PLACES * run, _PLACES * run - 1, stages[b + _APART]
    key, other = keys[np.uint64(at + (old & mask))], keys[np.uint64(at + (new & mask))]
    second = np.int64((old == old_ends) | ((new < new_ends) & (other < key)))
    keys[np.uint64(2 * at + (given & 2 * mask + 1))] = other if second else key
    old, new = old + 1 - second, new + second
    stages[b + _GIVEN] = given + 1
    if old + new == old_ends + new_ends:
        stages[b + _APART] = apart ^ (old_ends == new_ends)  # after a single run the next pair is on the other side
        _pair(stages, b, run, given + 1, taken, chunk_ends)
    else:
        stages[b + _OLD], stages[b + _NEW] = old, new
        stages[b + _NEED] = new if new < new_ends else old
    return 1 - (apart ^ second)


@step
def _turn(stages, b, run, taken, chunk_ends):
    """Completes the incoming run; the next one goes to the other side."""
    chunk = stages[b + _CHUNK_IN]
    if taken == chunk_ends[np.uint64(chunk)]:
        chunk += 1
        stages[b + _CHUNK_IN] = chunk
    stages[b + _APART] ^= 1
    stages[b + _RUN_ENDS] = min(taken + run, chunk_ends[np.uint64(chunk)])
    if stages[b + _OLD_ENDS] == taken and stages[b + _NEW_ENDS] == taken:
        stages[b + _NEED] = stages[b + _OLD]
