"""The chunk sorter, a cycle a step (rtl/sort_tmu/chunk_sorter.py, merge_stage.py).

All stages give the same entries in the same chunks, each in another order. So an entry's place is a number that counts on from
chunk to chunk, and a stage is a few of them: how many entries it has taken and given, and which of each run of a pair leaves
next. Which of the two it is hangs on the entries themselves: each is known by its place behind the last stage.
"""

from __future__ import annotations

import numpy as np

from perf.kernel import kernel, step

(_GIVEN, _TAKEN, _SIDE, _RUN_ENDS, _CHUNK_IN, _LEVELS, _LEVEL_1, _OLD, _NEW, _OLD_ENDS, _NEW_ENDS, _OLDER, _WAITS, _CHUNK_OUT,
 _RUN, _AT) = range(16)
"""Words of a stage: entries given and taken; side and end of the run that comes, its chunk; entries on each side; of the pair
that leaves the next place of both runs and their ends, the first one's side, whether it waits to know that it has no second,
its chunk; entries of a run; where the entries that come begin in `keys`."""
_WORDS = 16
_PLACES = 8
"""Times a run: places that may lie between an entry that waits and the newest."""


def chunk_stages(capacity: int) -> tuple[np.ndarray, np.ndarray]:
    """An empty sorter of chunks up to `capacity`: its stages' words, behind those of the list reader, and room for entries."""
    count = capacity.bit_length() - 1
    stages = np.zeros(_WORDS * (count + 1), np.int64)
    for k in range(count):
        stages[_WORDS * (k + 1) + _RUN], stages[_WORDS * (k + 1) + _AT] = 1 << k, _PLACES << k
    return stages, np.zeros(2 * _PLACES * capacity, np.int32)


@step
def _pair(stages, b, place, chunk_ends):
    """The next two runs of a chunk, or its last one: the first begins at `place`."""
    run, chunk = stages[b + _RUN], stages[b + _CHUNK_OUT]
    first = chunk_ends[chunk - 1] if chunk else 0
    if place == chunk_ends[chunk]:
        first = place
        chunk += 1
        stages[b + _CHUNK_OUT] = chunk
    ends = chunk_ends[chunk]
    middle = min(place + run, ends)
    stages[b + _OLD], stages[b + _OLD_ENDS], stages[b + _NEW] = place, middle, middle
    stages[b + _NEW_ENDS] = min(middle + run, ends)
    stages[b + _WAITS] = middle == ends and ends - first > max(1, run >> 1)


@kernel
def begin_stages(stages, chunk_ends):
    """Stages before their first chunk."""
    for b in range(_WORDS, len(stages), _WORDS):
        _pair(stages, b, 0, chunk_ends)
        stages[b + _RUN_ENDS] = min(stages[b + _RUN], chunk_ends[0])


@step
def chunk_offers(stages, gone):
    """An entry stands behind the last stage; `gone`: so many have left."""
    return stages[len(stages) - _WORDS + _GIVEN] != gone


@step
def step_stages(stages, keys, gone, shown, chunk_ends, arrival):
    """A cycle of all stages; `shown`: an entry stands before them; whether it is taken."""
    first = _WORDS
    stages[_GIVEN] = stages[first + _TAKEN] + shown
    if stages[_GIVEN] == gone:
        return True
    keys[_PLACES + (stages[first + _TAKEN] & _PLACES - 1)] = arrival[stages[first + _TAKEN]]
    following, ready = gone, True
    for b in range(len(stages) - _WORDS, 0, -_WORDS):
        before, taken, given, run = stages[b - _WORDS + _GIVEN], stages[b + _TAKEN], stages[b + _GIVEN], stages[b + _RUN]
        side = stages[b + _SIDE]
        ready = stages[b + _LEVELS + side] <= run
        if given == following:
            _leave(stages, keys, b, before, taken, given, run, chunk_ends)
        if ready and before != taken:
            taken += 1
            stages[b + _TAKEN] = taken
            stages[b + _LEVELS + side] += 1
            if taken == stages[b + _RUN_ENDS]:
                chunk = stages[b + _CHUNK_IN]
                if taken == chunk_ends[chunk]:
                    chunk += 1
                    stages[b + _CHUNK_IN] = chunk
                stages[b + _SIDE] = 1 - side
                stages[b + _RUN_ENDS] = min(taken + run, chunk_ends[chunk])
        following = taken
    return ready


@step
def _leave(stages, keys, b, before, taken, given, run, chunk_ends):
    """The next entry of a pair into the stage's output register, if it may leave."""
    old, new, old_ends, new_ends = stages[b + _OLD], stages[b + _NEW], stages[b + _OLD_ENDS], stages[b + _NEW_ENDS]
    if stages[b + _WAITS]:
        if before <= old_ends and taken < old_ends:
            return
        stages[b + _WAITS] = 0
    elif before <= (new if new < new_ends else old):
        return
    at, mask = stages[b + _AT], _PLACES * run - 1
    key, second = keys[at + (old & mask)], old == old_ends
    other = keys[at + (new & mask)]
    second = second or (new < new_ends and other < key)
    if second:
        key = other
        new += 1
        stages[b + _NEW] = new
    else:
        old += 1
        stages[b + _OLD] = old
    stages[b + _LEVELS + (stages[b + _OLDER] ^ second)] -= 1
    keys[2 * at + (given & 2 * mask + 1)] = key
    given += 1
    stages[b + _GIVEN] = given
    if old == old_ends and new == new_ends:
        stages[b + _OLDER] ^= new_ends == old_ends
        _pair(stages, b, given, chunk_ends)
