"""Golden model: scenes, oracle, integer renderer, metrics, training.

Importing it gives numba's compiled kernels a cache folder of their own for every state of the sources: numba notices an edit
in a kernel's own file only, not in the functions and constants it takes from others, and would go on running stale code.
"""

import hashlib
import os
import shutil
import sys
from pathlib import Path

_ROOT = Path(__file__).resolve().parent.parent
_KEPT = 6  # states whose compiled kernels are kept


def _cache_folder() -> Path:
    state = hashlib.sha256()
    for folder in (_ROOT / "golden", _ROOT / "spec"):
        for source in sorted(folder.rglob("*.py")):
            state.update(source.read_bytes())
    return _ROOT / "build" / "numba" / state.hexdigest()[:16]


def _use_cache_folder() -> None:
    folder = _cache_folder()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        os.utime(folder)
        for old in sorted(folder.parent.iterdir(), key=lambda path: path.stat().st_mtime)[:-_KEPT]:
            shutil.rmtree(old, ignore_errors=True)
    except OSError:  # a read-only checkout: numba's own choice of a folder is better than none
        return
    os.environ["NUMBA_CACHE_DIR"] = str(folder)
    if "numba" in sys.modules:
        sys.modules["numba"].config.CACHE_DIR = str(folder)


if "NUMBA_CACHE_DIR" not in os.environ:
    _use_cache_folder()
