"""Failures after which training cannot continue: diverged numbers or a full disk. They are not bad input; checkpoints
remain."""

from __future__ import annotations

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

FULL = (errno.ENOSPC, errno.EDQUOT)
"""Error numbers of a write for which there is no free space: on the disk, or in the user's quota."""


class TrainingError(RuntimeError):
    """Training stopped by itself. The message says where, why, and what was kept; the command line exits with status 1."""


@contextmanager
def room_needed(path: Path, kept: str) -> Iterator[None]:
    """Turns a full disk while `path` is written into a TrainingError that says what is `kept`; other errors pass through.

    Raises:
        TrainingError: there is no free space; the reason may be anywhere in the exception's causes.
    """
    try:
        yield
    except Exception as error:
        cause: BaseException | None = error
        while cause is not None and getattr(cause, "errno", None) not in FULL:
            cause = cause.__cause__
        if cause is None:
            raise
        raise TrainingError(f"{path}: cannot be written, the disk is full ({cause.strerror}); {kept}") from error
