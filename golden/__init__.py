"""Golden model: scenes, oracle, integer renderer, metrics, training.

Importing it gives numba's compiled kernels a cache folder of their own for every state of the sources: numba notices an edit
in a kernel's own file only, not in the functions and constants it takes from others, and would go on running stale code.
It also makes that folder safe for processes that run side by side.
"""

import fcntl
import hashlib
import os
import shutil
from collections.abc import Iterable
from pathlib import Path

from numba.core import caching, config

from spec.paths import ROOT

_KEPT = 6  # states whose compiled kernels are kept


def kernel_folder(name: str, sources: Iterable[Path]) -> Path | None:
    """build/`name`/STATE of some sources, there now, with the states used last beside it; None in a read-only checkout."""
    state = hashlib.sha256()
    for source in sources:
        state.update(source.read_bytes())
    folder = ROOT / "build" / name / state.hexdigest()[:16]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        for old in sorted(folder.parent.iterdir(), key=lambda path: path.stat().st_mtime)[:-_KEPT]:
            shutil.rmtree(old, ignore_errors=True)
    except OSError:
        return None
    return folder


def _sources() -> list[Path]:
    return [source for part in ("golden", "spec") for source in sorted((ROOT / part).rglob("*.py"))]


def _use_kernel_folder() -> None:
    folder = kernel_folder("numba", _sources())
    if folder:  # numba's own choice of a folder is better than none
        os.environ["NUMBA_CACHE_DIR"] = config.CACHE_DIR = str(folder)


def _save_alone() -> None:
    """One process at a time adds to the cache. numba names a kernel's files by the numbers that its index leaves free: two
    processes that compile it for different types would take the same number, and later run one's code on the other's data."""
    save = caching.IndexDataCacheFile.save

    def save_alone(self: caching.IndexDataCacheFile, key: tuple, data: object) -> None:
        with open(Path(self._cache_path) / "lock", "w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            save(self, key, data)

    caching.IndexDataCacheFile.save = save_alone


if "NUMBA_CACHE_DIR" not in os.environ:
    _use_kernel_folder()
_save_alone()
