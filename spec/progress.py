"""What a long silent phase says on a terminal: what is being done, for how long already, and how long it took last time.

Nothing is written where standard error is no terminal, nor by the worker processes of a pool, whose lines would overwrite each
other. How long a phase took is kept in any case, in `durations.json` of the cache folder (`spec.paths.cache_folder`).
"""

from __future__ import annotations

import json
import multiprocessing
import os
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from types import TracebackType
from typing import ClassVar

from spec.paths import cache_folder
from spec.private import locked

KEPT = 400
"""Number of phases whose durations are kept: those that ended last."""

_ERASE = "\r\x1b[K"


def on_terminal() -> bool:
    """Whether this process may write progress lines: standard error is a terminal, and the process is not a pool's worker."""
    return sys.stderr is not None and sys.stderr.isatty() and multiprocessing.parent_process() is None


def pool_on_terminal() -> bool:
    """Whether this process is a pool's worker at a terminal, which may write whole lines only."""
    return sys.stderr is not None and sys.stderr.isatty() and multiprocessing.parent_process() is not None


class LiveLine:
    """A line of the terminal that is written anew every second within a `with` block, and is erased at its end.

    A process shows one line at a time. Where blocks are nested, or run in several threads, it is that of the block which began
    last; when this one ends, the one before it is shown again.

    Args:
        text: gives the line's text for the seconds since the block began.
    """

    _running: ClassVar[list[LiveLine]] = []
    _lock = threading.Lock()

    def __init__(self, text: Callable[[float], str]) -> None:
        self._text, self._end = text, threading.Event()
        self._thread: threading.Thread | None = None

    def __enter__(self) -> LiveLine:
        if on_terminal():
            self._begin = time.monotonic()
            with LiveLine._lock:
                LiveLine._running.append(self)
                self._show()
            self._thread = threading.Thread(target=self._run, daemon=True)
            self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._thread is not None:
            self._end.set()
            self._thread.join()
            with LiveLine._lock:
                LiveLine._running.remove(self)
                if LiveLine._running:
                    LiveLine._running[-1]._show()
                else:
                    sys.stderr.write(_ERASE)
                    sys.stderr.flush()

    def _run(self) -> None:
        while not self._end.wait(1):
            with LiveLine._lock:
                if LiveLine._running[-1] is self:
                    self._show()

    def _show(self) -> None:
        width = (os.get_terminal_size(sys.stderr.fileno()).columns or 80) - 1  # some terminals do not tell
        sys.stderr.write(_ERASE + self._text(time.monotonic() - self._begin)[:width])
        sys.stderr.flush()


@contextmanager
def phase(what: str) -> Iterator[None]:
    """Shows `what`, such as "building the simulator top-4x4", on the terminal as long as the block runs.

    A block that ends without an exception is timed for the next run. If it took more than two seconds, a line with its time
    stays on the terminal.
    """
    before, begin = last_seconds(what), time.monotonic()
    hint = "" if before is None else f" ({as_time(before)} last time)"
    with LiveLine(lambda seconds: f"{what}: {as_time(seconds)}{hint}"):
        yield
    seconds = time.monotonic() - begin
    keep_seconds(what, seconds)
    if seconds > 2 and on_terminal():
        print(f"{_ERASE}{what}: {as_time(seconds)}", file=sys.stderr, flush=True)


def as_time(seconds: float) -> str:
    """Seconds as a user reads them: 7 s, 1:05 min."""
    whole = round(seconds)
    return f"{whole} s" if whole < 60 else f"{whole // 60}:{whole % 60:02} min"


def last_seconds(what: str) -> float | None:
    """How long the phase took when it last ended, in seconds; None if that is not known."""
    return _read(_file()).get(what)


def keep_seconds(what: str, seconds: float) -> None:
    """Keeps how long a phase took. Several processes may do so at once. If nothing can be written, nothing is kept."""
    path = _file()
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        with locked(path.with_suffix(".lock")):
            known = _read(path)
            known.pop(what, None)  # so that it becomes the last
            known[what] = round(seconds, 2)
            descriptor, scratch = tempfile.mkstemp(dir=path.parent, prefix=path.name)
            with open(descriptor, "w") as file:
                json.dump(dict(list(known.items())[-KEPT:]), file, indent=1)
            os.replace(scratch, path)


def _file() -> Path:
    return cache_folder("durations.json")


def _read(path: Path) -> dict[str, float]:
    try:
        content = json.loads(path.read_text())
    except (OSError, ValueError):
        return {}
    return {key: value for key, value in content.items() if isinstance(value, int | float)} if isinstance(content, dict) else {}
