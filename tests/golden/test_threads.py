"""Slices of work: every item once, on as many threads as asked for, and errors reach the caller."""

import os
import threading

import pytest

from golden.threads import SLICES, for_slices


@pytest.mark.parametrize("workers", [1, 2, 5])
def test_every_item_is_in_one_slice(workers):
    seen, names = [], set()

    def kernel(part, begin, end, offset):
        names.add(threading.current_thread().name)
        seen.append((part, begin, end, offset))

    for _ in range(2):  # threads are used again
        seen.clear()
        for_slices(kernel, 100, 7, workers=workers)
        assert [part for part, *_ in sorted(seen)] == list(range(SLICES))
        assert [i for _, begin, end, _ in sorted(seen) for i in range(begin, end)] == list(range(100))
        assert {offset for *_, offset in seen} == {7}
    assert len(names) <= workers and (workers > 1 or names == {threading.current_thread().name})


@pytest.mark.parametrize("workers", [1, 3])
def test_an_error_in_a_slice_is_raised(workers):
    def kernel(part, begin, end):
        if part == 5:
            raise ValueError("in slice 5")

    with pytest.raises(ValueError, match="in slice 5"):
        for_slices(kernel, 100, workers=workers)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are not forked here")
def test_a_forked_process_has_threads_of_its_own():
    """Threads do not survive a fork; work that waited for them would never end."""
    for_slices(lambda part, begin, end: None, 16, workers=2)
    child = os.fork()
    if not child:
        done = []
        for_slices(lambda part, begin, end: done.append(part), 16, workers=2)
        os._exit(0 if sorted(done) == list(range(SLICES)) else 1)
    assert os.waitpid(child, 0)[1] == 0
