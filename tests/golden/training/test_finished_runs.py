"""What the training tables start from: scenes as they are asked for, and finished runs that fit."""

import json
from argparse import Namespace
from dataclasses import replace

import pytest

torch = pytest.importorskip("torch")

from golden.training.checkpoint import Checkpoint, Checkpoints  # noqa: E402
from golden.training.finished_runs import find_run  # noqa: E402
from golden.training.recipe import RESULTS, Recipe, plan  # noqa: E402
from msv2.studies.training import tables  # noqa: E402
from spec.errors import InputError  # noqa: E402
from tests.helpers.training_samples import small_dense, small_scene  # noqa: E402

RECIPE = Recipe("H", None, True, 60, 1500, 0)


@pytest.fixture(scope="module")
def scene():
    return small_scene()


@pytest.fixture(scope="module")
def dense():
    return small_dense(600)


def replace_namespace(args, **changes):
    return Namespace(**vars(args) | changes)


def finished(folder, name, **changes):
    """A finished run's folder."""
    run = folder / name
    (run / "checkpoints").mkdir(parents=True)
    options = {"scene": "embedded", "variant": "H", "baseline": None, "opacity-enhancement": True, "size": "64x64",
               "iterations": 60, "max-points": 1500, "seed": 0, "from": None, "device": "cpu",
               "gate": "psnr", "pooling": "blocks", "pooling-width": 1237} | changes
    (run / "report.json").write_text(json.dumps({"options": options}))
    (run / "model.ply").write_bytes(name.encode())
    (run / "log.jsonl").write_text('{"stage": "dense"}\n')
    return run, options


def test_finished_runs_are_found_by_their_options(tmp_path):
    finished(tmp_path, "a")
    finished(tmp_path, "m", variant="M")
    finished(tmp_path, "smfr", baseline="smfr", seed=1)
    finished(tmp_path, "v1", **{"opacity-enhancement": False, "seed": 2})
    for seed, (option, value) in enumerate((("gate", "both"), ("pooling", "box"), ("pooling-width", 400)), 3):
        finished(tmp_path, option, **{option: value, "seed": seed})
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "report.json").write_text("{")
    wanted = {"scene": "embedded", "variant": "H", "size": None}
    assert find_run(tmp_path, wanted).folder.name == "a"
    assert find_run(tmp_path, wanted | {"variant": "M"}).folder.name == "m"
    for other in ({"scene": "elsewhere"}, {"iterations": 61}, *({"seed": seed} for seed in range(1, 6))):
        assert find_run(tmp_path, wanted | other) is None
    assert find_run(tmp_path / "nowhere", wanted) is None


def test_a_finished_run_is_reused_and_another_recipe_is_not(tmp_path, dense, scene):
    run, options = finished(tmp_path, "a")
    totals = tuple((stage.name, stage.total) for stage in plan(RECIPE, scene, "cpu"))
    results = {"dense": dense, "prune": dense}
    last = Checkpoint(options, totals, results, len(totals), None, 60, {"dense": {"iterations": 30, "seconds": 2.0}}, 1)
    Checkpoints(run / "checkpoints", RESULTS).save(last)
    asked = Namespace(scenes=[], variant=None, size=None, iterations=None, max_points=None, seed=None, full=False)
    prepared = tables.prepare(tables.wanted_scenes(asked)[0], tmp_path, "cpu")
    assert prepared.recipe == RECIPE and set(prepared.ready) == set(results) and prepared.scene.size == (64, 64)
    assert prepared.options["reused"] and prepared.records == [{"stage": "dense"}] and prepared.spent["dense"]["seconds"] == 2.0
    other = tables.prepare(tables.wanted_scenes(replace_namespace(asked, iterations=80, size="48x48"))[0], tmp_path, "cpu")
    assert other.ready == {} and other.options["reused"] is None and other.recipe.iterations == 80
    Checkpoints(run / "checkpoints").clear()
    Checkpoints(run / "checkpoints", RESULTS).save(replace(last, plan=totals[:-1], stage=len(totals) - 1))
    assert tables.prepare(tables.wanted_scenes(asked)[0], tmp_path, "cpu").ready == {}


def test_scenes_have_sizes_of_their_own():
    asked = {"variant": "M", "size": "64x48", "iterations": None, "max_points": None, "seed": 3, "full": False}
    args = Namespace(scenes=["embedded", "a@b/fern@504x378"], **asked)
    embedded, fern = tables.wanted_scenes(args)
    assert embedded.keys == {
        "scene": "embedded", "variant": "M", "size": "64x48", "iterations": None, "max-points": None, "seed": 3}
    assert fern.path == "a@b/fern" and fern.keys["size"] == "504x378" and fern.keys["scene"].endswith("/a@b/fern")
    full = tables.wanted_scenes(replace_namespace(args, full=True, size=None, iterations=500))
    assert [scene.options["max_points"] for scene in full] == [100_000, 285_000] and full[1].options["iterations"] == 500
    with pytest.raises(InputError, match="'fern' is not accepted with --full"):
        tables.wanted_scenes(replace_namespace(args, full=True, size=None, scenes=["fern"]))
    with pytest.raises(InputError, match="12xx"):
        tables.wanted_scenes(replace_namespace(args, scenes=["fern@12xx"]))
