"""Fixtures that several areas share."""

import os
from pathlib import Path

import pytest

DEFAULT_DATA = Path(__file__).parents[2] / "shared" / "data"


@pytest.fixture(scope="session")
def data_dir() -> Path:
    """The folder of real scenes; the test is skipped where it is absent."""
    folder = Path(os.environ.get("MSV2_DATA", DEFAULT_DATA))
    if not folder.is_dir():
        pytest.skip(f"no real scenes at {folder}: set MSV2_DATA to their folder")
    return folder
