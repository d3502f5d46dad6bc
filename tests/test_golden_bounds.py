"""The kernels again with every array access checked: what numba compiles by default writes where it is told."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

HERE = Path(__file__).parent
FILES = ["test_golden_array.py", "test_golden_tiling.py", "test_golden_hard_cases.py", "test_golden_hard_frames.py",
         "test_golden_pipeline.py"]


@pytest.mark.long
def test_no_access_is_out_of_bounds(tmp_path):
    environment = os.environ | {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-m", "pytest", "-x", "--tb=short", *(HERE / name for name in FILES)],
                          env=environment, capture_output=True, text=True, cwd=HERE.parent)
    assert done.returncode == 0, done.stdout[-3000:]
