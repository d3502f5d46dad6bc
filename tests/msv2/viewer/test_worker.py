"""Threads in which the newest job goes first."""

import threading
import time

from msv2.viewer.worker import NewestFirst
from spec.errors import InputError


def test_the_newest_job_wins():
    gate, done = threading.Event(), []

    def work(job: int) -> None:
        if job == 0:
            gate.wait(10)
        done.append(job)

    worker = NewestFirst(work, lambda error: None, "test")
    worker.put(0)
    while not worker.idle(0) and not done and worker._job:
        time.sleep(0.01)
    for job in range(1, 6):
        worker.put(job)
    gate.set()
    assert worker.idle(10) and done == [0, 5]
    worker.close()


def test_a_job_sees_that_a_newer_one_has_come():
    seen, begun = [], threading.Event()

    def work(job: str) -> None:
        begun.set()
        seen.append((job, worker.newer(0.5 if job == "old" else 0.0)))

    worker = NewestFirst(work, lambda error: None, "test")
    worker.put("old")
    assert begun.wait(10)
    worker.put("new")
    assert worker.idle(10) and seen == [("old", True), ("new", False)]
    worker.close()


def test_the_thread_survives_errors(capsys):
    failed, done = [], []

    def work(job: Exception | str) -> None:
        if isinstance(job, Exception):
            raise job
        done.append(job)

    worker = NewestFirst(work, failed.append, "test")
    for job in (InputError("not accepted"), RuntimeError("broken"), "next"):
        worker.put(job)
        assert worker.idle(10)
    assert [str(error) for error in failed] == ["not accepted", "broken"] and done == ["next"]
    said = capsys.readouterr().err
    assert "RuntimeError: broken" in said and "not accepted" not in said  # only what is no fault of the user
    worker.close()


def test_it_ends():
    worker = NewestFirst(lambda job: None, lambda error: None, "test")
    worker.put(1)
    worker.close()
    assert not worker._thread.is_alive()
    worker.put(2)  # is not worked on, and nothing fails
