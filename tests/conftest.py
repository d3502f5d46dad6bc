"""Fixtures that several areas share, and what makes processes of tests run side by side well."""

import gc
import os
from pathlib import Path

import pytest

DEFAULT_DATA = Path(__file__).parents[2] / "shared" / "data"

if "PYTEST_XDIST_WORKER" in os.environ:  # a process a core: more threads would wait for each other
    os.environ.setdefault("OMP_NUM_THREADS", "1")


def pytest_collection_finish() -> None:
    """All modules are in memory, and stay: collections of garbage need not look through them (an eighth of units' tests)."""
    gc.freeze()


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real scenes; the test is skipped where it is absent."""
    folder = Path(os.environ.get("MSV2_DATA", DEFAULT_DATA))
    if not folder.is_dir():
        pytest.skip(f"no real scenes at {folder}: set MSV2_DATA to their folder")
    return folder
