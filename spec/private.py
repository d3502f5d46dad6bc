"""Folders that no two processes share at a time, and locks: no run may read the stimuli or the results of another."""

from __future__ import annotations

import fcntl
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO

from spec.errors import InputError

LOCK = ".lock"
"""The file in a folder that a run holds locked as long as it works there."""


@contextmanager
def locked(path: Path, notice: str = "") -> Iterator[None]:
    """Holds the lock of a file, which is made if need be; waits while another process, or another thread, holds it.

    Args:
        path: the file, in a folder that exists.
        notice: what is printed on standard error before a wait.
    """
    with open(path, "w") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if notice:
                print(notice, file=sys.stderr, flush=True)
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


@contextmanager
def private_folder(folder: Path) -> Iterator[Path]:
    """Yields `folder`, or `folder-2`, `folder-3` and so on while other runs work in the ones before.

    A folder that was made here and that nothing was written into is removed at the end.

    Raises:
        InputError: a file of that name exists, or the place is not writable.
    """
    number = 1
    while True:
        place = folder if number == 1 else folder.with_name(f"{folder.name}-{number}")
        new, lock = not place.exists(), _claimed(place)
        if lock is not None:
            break
        number += 1
    with _held(lock, place, new):
        yield place


@contextmanager
def output_folder(given: Path | str | None, default: Path) -> Iterator[Path]:
    """The folder for a run's outputs, which no other run of these commands writes to as long as the block runs.

    A folder that was made here and that nothing was written into is removed at the end.

    Args:
        given: the folder that the user named; None for the default.
        default: the folder where the user named none. While another run works in it, `default-2` and so on stand for it.

    Raises:
        InputError: another run is working in the given folder, or the folder cannot be written to.
    """
    if given is None:
        with private_folder(default) as place:
            yield place
        return
    new, lock = not Path(given).exists(), _claimed(Path(given))
    if lock is None:
        raise InputError(f"output folder {given} is not accepted while another run writes to it: name another one, or wait")
    with _held(lock, Path(given), new):
        yield Path(given)


@contextmanager
def _held(lock: IO[str], place: Path, new: bool) -> Iterator[None]:
    """Holds a claimed folder. At the end its lock goes, and the folder with it if it is new and empty."""
    with lock:
        try:
            yield
        finally:
            (place / LOCK).unlink(missing_ok=True)
            if new:
                with suppress(OSError):  # it is not empty, or another run has just begun there
                    place.rmdir()


def _claimed(place: Path) -> IO[str] | None:
    """The locked file of a folder, which is made if need be; None while another run holds it."""
    while True:
        try:
            place.mkdir(parents=True, exist_ok=True)
            lock = open(place / LOCK, "w")
        except OSError as error:
            if isinstance(error, FileNotFoundError | FileExistsError) and not place.exists():
                continue  # another run has just removed the folder
            raise InputError(f"output folder {place} is not accepted ({error.strerror}): a writable place is") from error
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            lock.close()
            return None
        if os.fstat(lock.fileno()).st_nlink:
            return lock
        lock.close()  # another run has just ended and removed it
