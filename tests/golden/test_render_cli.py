"""golden/render.py as a user meets it: files written, statistics, bad input."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from golden.render import main
from golden.scenes.save import save_model
from spec.errors import InputError
from spec.paths import ROOT
from tests.helpers.golden_samples import ball


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    """A small model of a ball of splats, as PLY."""
    path = tmp_path_factory.mktemp("scene") / "ball.ply"
    save_model(ball(), path)
    return path


def render(*argv: object) -> None:
    main([str(a) for a in argv])


def test_files_and_statistics(scene, tmp_path):
    render(scene, "--size", "70x45", "--compare", "oracle", "--dump", "entries", "--out", tmp_path)
    stats = json.loads((tmp_path / "stats.json").read_text())
    for name in ("frame.png", "levels.png"):
        assert Image.open(tmp_path / name).size == (70, 45)
    assert stats["splats"] == 400
    assert stats["visible"] + sum(stats["culled"].values()) == 400
    assert stats["psnr_vs_oracle_db"] > 60
    assert 0 < stats["coverage"] < 1
    assert set(stats["seconds"]) >= {"quantise", "culling", "sort", "tiles", "colour", "array", "total", "compile"}
    dump = np.load(tmp_path / "entries.npz")
    assert dump["headers"]["count"].sum() == len(dump["entries"]) == stats["entries"]
    assert stats["entries_per_tile"]["max"] == dump["headers"]["count"].max()


def test_foveation_of_a_plain_model_is_seeded(scene, tmp_path):
    pictures = []
    for seed in (0, 0, 1):
        render(scene, "--size", "96x96", "--gaze", "10,10", "--levels", 4, "--levels-from", "random", "--seed", seed, "--out",
               tmp_path)
        stats = json.loads((tmp_path / "stats.json").read_text())
        pictures.append((tmp_path / "frame.png").read_bytes())
    assert pictures[0] == pictures[1] != pictures[2]
    assert stats["entries_filtered"] > 0 and stats["blend_tiles"] > 0


def test_background_shows_where_nothing_is(scene, tmp_path):
    render(scene, "--size", "64x64", "--background", "1,0.25,0", "--out", tmp_path)
    corner = np.asarray(Image.open(tmp_path / "frame.png"))[0, 0]
    assert corner.tolist() == [255, 64, 0]


@pytest.mark.parametrize(("argv", "named"), [
    (["--size", "0x16"], "'0x16'"), (["--size", "16"], "'16'"), (["--size", "axb"], "'axb'"),
    (["--size", "9000x16"], "'9000x16'"), (["--size", "2000x16"], "2000x16"),
    (["--gaze", "700,5", "--size", "64x64"], "700.0,5.0"), (["--gaze", "1"], "'1'"), (["--gaze", "nan,1"], "'nan,1'"),
    (["--levels", "5"], "5"), (["--levels-from", "photographs"], "'photographs'"), (["--levels", "0"], "0"),
    (["--background", "2,0,0"], "'2,0,0'"),
    (["--camera", "99"], "99"), (["--camera", "missing.json"], "missing.json"), (["--dump", "nothing"], "'nothing'"),
    (["--seed", "-1"], "-1"), (["--config", "huge"], "'huge'"), (["--compare", "gsplat"], "'gsplat'"),
])
def test_bad_requests_name_the_value_and_write_nothing(scene, tmp_path, argv, named):
    with pytest.raises(InputError, match=None) as error:
        render(scene, *argv, "--out", tmp_path / "out")
    assert named in str(error.value)
    assert not (tmp_path / "out").exists()


def test_bad_input_leaves_old_output_and_exits_with_2(tmp_path):
    old = tmp_path / "frame.png"
    old.write_bytes(b"kept")
    command = [sys.executable, ROOT / "golden" / "render.py", tmp_path / "absent.ply", "--out", tmp_path]
    run = subprocess.run(command, capture_output=True, text=True)
    assert run.returncode == 2
    assert "absent.ply" in run.stderr and "Traceback" not in run.stderr
    assert old.read_bytes() == b"kept"


def test_output_folder_that_is_a_file(scene, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="file"):
        render(scene, "--size", "32x32", "--out", tmp_path / "file")
