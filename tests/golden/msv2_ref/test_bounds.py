"""The kernels again with every array access checked: what numba compiles by default writes where it is told."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from spec.paths import ROOT

HERE = Path(__file__).parent
FILES = ["test_array.py", "test_tile_test.py", "test_hard_cases.py", "test_hard_frames.py", "test_pipeline.py"]


@pytest.mark.long
def test_no_access_is_out_of_bounds():
    environment = os.environ | {"NUMBA_BOUNDSCHECK": "1"}  # kernels with checks are kept apart from others
    done = subprocess.run([sys.executable, "-m", "pytest", "-x", "--tb=short", *(HERE / name for name in FILES)],
                          env=environment, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stdout[-3000:]
