"""Streamed SOG: one level of detail of several, from generated folders."""

import json

import numpy as np
import pytest

from golden.render import main as render
from golden.scenes.load import load_model, load_scene
from golden.scenes.request import parse_request, resolve
from spec.errors import InputError
from tests.helpers.sog_samples import sog, write_folder

pytest.importorskip("imagecodecs")

FILES = {"0_0": 30, "0_1": 20, "1_0": 9, "2_0": 4}


def leaf(**levels):
    lods = {level[1:]: dict(zip(("file", "offset", "count"), values, strict=True)) for level, values in levels.items()}
    return {"bound": {"min": [-1, -1, -1], "max": [1, 1, 1]}, "lods": lods}


def index():
    """Three leaves in two branches. The first lacks the coarsest level, the last the two finer ones; files are out of order."""
    first, second = leaf(_0=(1, 0, 30), _1=(2, 0, 5)), leaf(_0=(0, 0, 15), _1=(2, 5, 4), _2=(3, 0, 3))
    return {"lodLevels": 3, "environment": None, "filenames": [f"{name}/meta.json" for name in ("0_1", "0_0", "1_0", "2_0")],
            "tree": {"bound": {}, "children": [{"bound": {}, "children": [first, second]}, leaf(_2=(3, 3, 1))]}}


@pytest.fixture
def scene(tmp_path):
    folder, wanted = tmp_path / "big", {}
    for name, count in FILES.items():
        parts, wanted[name] = sog(2, n=count)
        write_folder(folder / name, parts)
    (folder / "lod-meta.json").write_text(json.dumps(index()))
    return folder, wanted


def rows(wanted, *ranges):
    return np.concatenate([wanted[name]["means"][begin:end] for name, begin, end in ranges])


RANGES = {
    0: (("0_0", 0, 30), ("0_1", 0, 15), ("2_0", 3, 4)),
    1: (("1_0", 0, 5), ("1_0", 5, 9), ("2_0", 3, 4)),
    2: (("1_0", 0, 5), ("2_0", 0, 3), ("2_0", 3, 4)),
}
"""What each level is: of a leaf that lacks it, the nearest level."""


@pytest.mark.parametrize(("lod", "replaced"), [(0, 1), (1, 1), (2, 1)])
def test_a_level_is_its_ranges_in_the_order_of_the_leaves(scene, lod, replaced):
    folder, wanted = scene
    loaded = load_scene(folder, lod)
    np.testing.assert_allclose(loaded.model.means, rows(wanted, *RANGES[lod]), rtol=1e-5, atol=1e-6)
    assert loaded.model.name == "big"
    assert (loaded.detail.level, loaded.detail.levels, loaded.detail.splats) == (lod, 3, len(loaded.model))
    assert (loaded.detail.leaves, loaded.detail.replaced, loaded.detail.environment) == (3, replaced, 0)


def test_without_a_level_the_finest_is_read_and_not_the_sum(scene):
    folder, wanted = scene
    for path in (folder, folder / "lod-meta.json"):
        model = load_model(path)
        assert len(model) == 46 < sum(FILES.values())
        np.testing.assert_allclose(model.means, rows(wanted, *RANGES[0]), rtol=1e-5, atol=1e-6)


def test_of_two_levels_equally_near_the_finer_is_taken(scene):
    folder, wanted = scene
    content = index()
    content["tree"]["children"][1] = leaf(_0=(0, 15, 5), _2=(3, 3, 1))
    (folder / "lod-meta.json").write_text(json.dumps(content))
    model = load_scene(folder, 1).model
    np.testing.assert_allclose(model.means[-5:], rows(wanted, ("0_1", 15, 20)), rtol=1e-5, atol=1e-6)


def test_an_environment_belongs_to_every_level_and_harmonics_may_differ(scene):
    folder, wanted = scene
    parts, around = sog(2, n=7, bands=2)
    write_folder(folder / "env", parts)
    (folder / "lod-meta.json").write_text(json.dumps(index() | {"environment": "env/meta.json"}))
    for lod in RANGES:
        loaded = load_scene(folder, lod)
        means = np.concatenate([rows(wanted, *RANGES[lod]), around["means"]])
        np.testing.assert_allclose(loaded.model.means, means, rtol=1e-5, atol=1e-6)
        assert loaded.detail.environment == 7 and "7 splats of the environment" in loaded.detail.note
        assert loaded.model.sh_rest.shape[1] == 8 and not loaded.model.sh_rest[:-7, 3:].any()


def test_a_part_alone_is_a_scene_as_before(scene):
    assert len(load_model(scene[0] / "1_0")) == 9


def test_a_request_says_which_level_it_draws(scene, capsys):
    request = resolve(parse_request(str(scene[0]), "--size", "32x32", "--lod", "1"))
    assert request.record["lod"] == {"level": 1, "levels": 3, "splats": 10, "leaves": 3, "replaced": 1, "environment": 0}
    said = capsys.readouterr().err
    assert "level of detail 1 of 3 (--lod 0..2 chooses; 0 is the finest): 10 splats, 1 of 3 leaves lack it" in said


def test_render_takes_a_level(scene, tmp_path, capsys):
    counts = []
    for lod in ("0", "2"):
        render([str(scene[0]), "--size", "32x32", "--lod", lod, "--out", str(tmp_path / lod)])
        stats = json.loads((tmp_path / lod / "stats.json").read_text())
        counts.append(stats["splats"])
        assert stats["lod"]["level"] == int(lod)
    assert counts == [46, 9]
    assert "level of detail 2 of 3" in capsys.readouterr().err


def test_a_level_of_a_model_that_has_none_is_refused(scene):
    for path in (scene[0] / "1_0", "embedded"):
        with pytest.raises(InputError, match=r"level of detail 1 is not accepted: .* is no streamed SOG"):
            load_scene(path, 1)


@pytest.mark.parametrize("lod", [-1, 3])
def test_a_level_out_of_range_is_refused(scene, lod):
    with pytest.raises(InputError, match=rf"level of detail {lod} is not accepted: 0\.\.2 are"):
        load_scene(scene[0], lod)


def changed(path, value):
    """A spoiler that sets the value at a path of keys."""
    def spoil(content):
        node = content
        for key in path[:-1]:
            node = node[key]
        node[path[-1]] = value
    return spoil


BRANCH = ("tree", "children", 0, "children", 0)


@pytest.mark.parametrize(("spoil", "says"), [
    (changed(("lodLevels",), 0), "lodLevels is 0"), (changed(("lodLevels",), "3"), "lodLevels is '3'"),
    (changed(("lodLevels",), True), "lodLevels is True"), (changed(("filenames",), "0_0"), "filenames is '0_0'"),
    (changed(("filenames",), [1]), r"filenames is \[1\]"),
    (changed(("filenames", 1), "9_9/meta.json"), "names '9_9/meta.json'"),
    (changed(("filenames", 1), "x" * 6000), "names 'xxx"), (changed(("filenames", 1), "a\0b"), "names 'a.*does not exist"),
    (changed(("environment",), 3), "environment is 3"), (changed(("environment",), "away/meta.json"), "away/meta.json"),
    (changed(("tree",), None), "tree is None"), (changed(("tree",), {}), r"tree has the keys \[\]"),
    (changed(("tree",), {"children": []}), "no leaf of the tree"),
    (changed((*BRANCH, "lods"), []), r"tree.children\[0\].children\[0\] has the keys"),
    (changed((*BRANCH, "lods", "x"), {}), "has a level 'x'"), (changed((*BRANCH, "lods", "3"), {}), "has a level '3'"),
    (changed((*BRANCH, "lods", "0"), None), "level 0 is None"),
    (changed((*BRANCH, "lods", "0", "file"), 4), r"file 4 is not accepted: 0\.\.3 are"),
    (changed((*BRANCH, "lods", "0", "file"), -1), "file is -1"),
    (changed((*BRANCH, "lods", "0", "offset"), 1.5), "offset is 1.5"),
    (changed((*BRANCH, "lods", "0", "count"), 31), r"rows 0\.\.30 are not accepted: 0_0/meta.json has 30"),
    (changed((*BRANCH, "lods", "0"), {"file": 1, "count": 3}), "offset is None"),
])
def test_malformed(scene, spoil, says):
    content = index()
    spoil(content)
    (scene[0] / "lod-meta.json").write_text(json.dumps(content))
    with pytest.raises(InputError, match=says) as caught:
        load_model(scene[0])
    assert "lod-meta.json" in str(caught.value)


@pytest.mark.parametrize("text", ["", "[1]", "{", "null"])
def test_no_json(scene, text):
    (scene[0] / "lod-meta.json").write_text(text)
    with pytest.raises(InputError, match=r"lod-meta\.json"):
        load_model(scene[0])
