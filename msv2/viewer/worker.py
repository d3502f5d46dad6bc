"""Threads that work on the newest job: what was asked before and has not begun is dropped."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from typing import Generic, TypeVar

from spec.errors import InputError

Job = TypeVar("Job")


class NewestFirst(Generic[Job]):
    """A thread that calls a function with the newest job given.

    Args:
        work: called with each job in the thread.
        failed: called with an exception that `work` raised; the thread goes on with the next job.
        name: the thread's name.
    """

    def __init__(self, work: Callable[[Job], None], failed: Callable[[Exception], None], name: str) -> None:
        self._work, self._failed = work, failed
        self._changed = threading.Condition()
        self._job: list[Job] = []
        self._busy = self._closed = False
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def put(self, job: Job) -> None:
        """Gives a job, in place of one that has not begun."""
        with self._changed:
            self._job = [job]
            self._changed.notify_all()

    def newer(self, seconds: float = 0.0) -> bool:
        """Whether a newer job has come, or the thread is to end; waits up to `seconds` for it. For use by `work`."""
        with self._changed:
            return self._changed.wait_for(lambda: bool(self._job) or self._closed, seconds)

    def idle(self, seconds: float) -> bool:
        """Whether all jobs are done within `seconds`."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._job and not self._busy, seconds)

    def close(self, seconds: float = 5.0) -> None:
        """Ends the thread after the job that it works on; waits for it up to `seconds`."""
        with self._changed:
            self._closed, self._job = True, []
            self._changed.notify_all()
        self._thread.join(seconds)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._busy = False
                self._changed.notify_all()
                self._changed.wait_for(lambda: bool(self._job) or self._closed)
                if self._closed:
                    return
                job, self._busy = self._job.pop(), True
            try:
                self._work(job)
            except InputError as error:
                self._failed(error)
            except Exception as error:  # a viewer that has failed once must still show the next camera
                traceback.print_exc()
                self._failed(error)
