"""Keeps what native libraries print on standard output out of it: they have no quiet mode for a caller."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def printing_to(path: Path) -> Iterator[None]:
    """Within the block, what is written to standard output is appended to a file."""
    sys.stdout.flush()
    console = os.dup(1)
    with path.open("ab") as file:
        os.dup2(file.fileno(), 1)
        try:
            yield
        finally:
            os.dup2(console, 1)
            os.close(console)
