"""Work folders that no two processes share: stimuli and results of one run would be read by the other."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def private_folder(folder: Path) -> Iterator[Path]:
    """Yields `folder`, or `folder-2`, `folder-3` and so on while other processes work in the ones before.

    A folder that was made here and that nothing was written into is removed at the end.
    """
    number = 1
    while True:
        place = folder if number == 1 else folder.with_name(f"{folder.name}-{number}")
        new = not place.exists()
        place.mkdir(parents=True, exist_ok=True)
        try:
            lock = open(place / "lock", "w")
        except FileNotFoundError:  # another process has just removed the folder
            continue
        with lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                number += 1
                continue
            if not os.fstat(lock.fileno()).st_nlink:  # another process has just removed the lock
                continue
            try:
                yield place
            finally:
                if new and [path.name for path in place.iterdir()] == ["lock"]:
                    (place / "lock").unlink()
                    place.rmdir()
            return
