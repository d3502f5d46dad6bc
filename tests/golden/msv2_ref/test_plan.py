"""Effects in the golden renderer: what a frame calls for, and that what is forced beside it changes no bit."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from golden.host import compact
from golden.host.memory_image import gaussian_bytes
from golden.host.quantise import quantise_model
from golden.msv2_ref import array_kernel
from golden.msv2_ref.plan import with_sh_degree, work_for
from golden.render import main
from golden.scenes.gaze import Display, foveation_map, no_foveation
from golden.scenes.levels import spread_levels
from golden.scenes.orbit import orbit_camera
from golden.scenes.probe import probe, used_sh_degree
from golden.scenes.request import Request
from spec.config import PAPER_SMALL, V3_RECORDS
from spec.constants import MAX_LEVELS
from spec.errors import InputError
from spec.memory import colour_beats
from tests.helpers.golden_samples import random_model

SIZE, DISPLAY = (96, 64), Display(96, 64)
BUT_STEREO = "sh,levels,blend,enhancement,depth,cleaning,contention"


@pytest.fixture(scope="module")
def flat():
    """A model of degree 0 without levels."""
    return random_model(np.random.default_rng(5), 400).with_sh_degree(0)


def work(model, foveation, effects="auto", *, config=PAPER_SMALL, **asked):
    args = SimpleNamespace(**{"effects": effects, "stereo": False, "depth": False} | asked)
    return work_for(args, Request(model, orbit_camera(model, 0, 4, *SIZE), foveation, (0.1, 0.2, 0.3), {}), config)


def same_image(a, b):
    assert a.transmittance.min() < 0.2  # there is something to see
    assert np.array_equal(a.image, b.image) and np.array_equal(a.transmittance, b.transmittance)


def test_a_plain_scene_calls_for_nothing(flat):
    plan = probe(flat, no_foveation(DISPLAY))
    assert plan.called == plan.active == frozenset() and plan.sh_degree == 0
    assert plan.reasons["levels"] == "no gaze" and plan.reasons["stereo"] == "one eye"


def test_what_calls_for_an_effect(flat):
    rest = np.zeros((len(flat), 15, 3))
    rest[7, 4, 1] = 1e-3
    second = replace(flat, sh_rest=rest, dropped={"not_finite": 3})
    plan = probe(second, no_foveation(DISPLAY), depth=True)
    assert plan.called == {"sh", "depth", "cleaning"} and plan.sh_degree == used_sh_degree(second) == 2
    assert plan.reasons["sh"] == "harmonics of degree 2 of 3" and plan.reasons["cleaning"] == "3 points dropped"
    foveated = probe(spread_levels(flat), foveation_map(DISPLAY, (0, 0)), stereo=True)
    assert {"levels", "blend", "enhancement", "depth", "stereo", "fill", "rerender"} == foveated.called
    assert probe(flat, no_foveation(DISPLAY), contention=True).called == {"contention"}


def test_a_gaze_in_whose_fovea_the_frame_lies_calls_for_no_levels(flat):
    narrow = Display(96, 64, 10)
    assert not probe(spread_levels(flat), foveation_map(narrow, (48, 32))).called & {"levels", "blend"}


@pytest.mark.parametrize("effects", ["all", BUT_STEREO, "sh", "levels", "levels,blend", "depth"])
def test_forced_effects_change_no_bit(flat, effects):
    auto, forced = work(flat, no_foveation(DISPLAY)), work(flat, no_foveation(DISPLAY), effects)
    a, b = auto.render(), forced.render()
    same_image(a, b)
    assert forced.second_eye_forced == (effects == "all")
    if forced.second_eye_forced:
        eyes = forced.add_eye(b)
        assert eyes.source is b and eyes.target_pixels["coverage"].any()
    assert (b.config.level_banks == 2) == ("blend" in effects or effects == "all")
    assert bool(b.pixels.depth.any()) == b.config.depth and not a.pixels.depth.any()


@pytest.mark.parametrize("effects", ["all", BUT_STEREO, "sh", "levels", "levels,blend"])
@pytest.mark.parametrize("levels", [1, 4])
@pytest.mark.parametrize("config", [V3_RECORDS, V3_RECORDS.with_(records="wide")], ids=["compact", "wide"])
def test_forced_effects_change_no_bit_of_models_in_chunks(flat, effects, levels, config):
    """Fine records stay fine and coarse ones coarse; headers and packed records tell the same as the words."""
    model = spread_levels(flat) if levels > 1 else flat
    auto, forced = (work(model, no_foveation(DISPLAY), e, config=config) for e in ("auto", effects))
    same_image(auto.render(), forced.render())
    words = forced.words
    assert np.array_equal(np.repeat(words.chunks["bound"], words.chunks["count"]), words.geometry["bound"])
    if config.compact:
        geometry, colour = compact.decode(config, words.chunks, words.compact, words.sh_degree)
        assert np.array_equal(geometry, words.geometry) and np.array_equal(colour, words.colour)
        assert (words.compact.harmonics is not None) == (words.sh_degree > 0)
        strongest = np.maximum.reduceat(words.compact.geometry["opacity"], words.chunks["first"])
        assert np.array_equal(words.chunks["opacity"], strongest)
    contents = gaussian_bytes(forced.config, words)
    assert len(contents["colour"]) == colour_beats(forced.config, words.sh_degree) * len(words.geometry)


@pytest.mark.parametrize("degree", [0, 1, 2])
def test_compact_records_of_a_lower_degree(degree):
    """Those of a model whose highest harmonics are dropped after packing are those of words that never had them."""
    model = random_model(np.random.default_rng(6), 200, levels=4, sh=3)
    words = with_sh_degree(quantise_model(V3_RECORDS, model), degree)
    geometry, colour = compact.decode(V3_RECORDS, words.chunks, words.compact, degree)
    assert np.array_equal(colour, words.colour) and np.array_equal(geometry, words.geometry)
    back = with_sh_degree(words, 3)
    assert back.compact.harmonics is not None and not back.colour["rest"][:, colour["rest"].shape[1] if degree else 0 :].any()
    assert np.array_equal(compact.decode(V3_RECORDS, back.chunks, back.compact, 3)[1], back.colour)


@pytest.mark.parametrize("effects", ["auto", "sh"])
def test_harmonics_beyond_the_machines_degree_are_left_out(effects, capsys):
    model = random_model(np.random.default_rng(5), 400, sh=3)
    low = work(model, no_foveation(DISPLAY), effects, config=PAPER_SMALL.with_(sh_degree=1))
    assert "harmonics up to degree 1" in capsys.readouterr().out
    assert low.config.sh_degree == low.words.sh_degree == 1
    whole, cut = work(model, no_foveation(DISPLAY)), work(model.with_sh_degree(1), no_foveation(DISPLAY))
    assert "harmonics up to" not in capsys.readouterr().out
    same_image(low.render(), cut.render())
    assert not np.array_equal(low.render().image, whole.render().image)


@pytest.mark.parametrize("gaze", [(5, 60), (96, 0)])
@pytest.mark.parametrize("enhanced", [False, True])
def test_foveated_frames_of_harmonics(gaze, enhanced):
    model = random_model(np.random.default_rng(6), 300, sh=3)
    model = spread_levels(model) if enhanced else model
    foveation = foveation_map(DISPLAY, gaze, model.levels)
    same_image(work(model, foveation).render(), work(model, foveation, "all").render())


@pytest.mark.parametrize("records", ["wide", "compact"])
def test_prepared_words_have_as_many_levels_as_the_machine_uses(flat, records):
    config = PAPER_SMALL if records == "wide" else V3_RECORDS
    for effects, levels in (("auto", 1), ("levels", config.levels)):
        words = work(flat, no_foveation(DISPLAY), effects, config=config).words
        assert words.levels == levels and words.geometry["bound"].max() <= MAX_LEVELS - 1


def test_blending_is_forced_where_levels_are_called_for_alone(flat):
    foveation = foveation_map(DISPLAY, (0, 0))
    sharp = replace(foveation, blend=np.zeros_like(foveation.blend), plane=np.zeros_like(foveation.plane))
    auto, forced = work(spread_levels(flat), sharp), work(spread_levels(flat), sharp, "all")
    assert auto.config.level_banks == 1 and auto.config.levels == 4 and forced.foveation.blend.any()
    same_image(auto.render(), forced.render())


def test_a_depth_that_is_asked_for_is_the_same_under_all(flat):
    a = work(flat, no_foveation(DISPLAY), depth=True).render()
    b = work(flat, no_foveation(DISPLAY), "all", depth=True).render()
    assert np.isfinite(a.depth).any() and np.array_equal(a.depth, b.depth, equal_nan=True)


def test_neutral_records(flat):
    words = quantise_model(PAPER_SMALL, random_model(np.random.default_rng(1), 50, sh=3))
    lower, back = with_sh_degree(words, 1), with_sh_degree(with_sh_degree(words, 1), 3)
    assert lower.sh_degree == 1 and np.array_equal(lower.colour["rest"], words.colour["rest"][:, :9])
    assert np.array_equal(back.colour["rest"][:, :9], lower.colour["rest"]) and not back.colour["rest"][:, 9:].any()
    assert np.array_equal(lower.colour["dc"], words.colour["dc"]) and with_sh_degree(words, words.sh_degree) is words


def test_what_a_scene_does_not_call_for_does_not_run(flat, monkeypatch):
    def forbidden(*_args):
        raise AssertionError("depth sums of a frame that nobody asked a depth of")

    plain, deep = work(flat, no_foveation(DISPLAY)), work(flat, no_foveation(DISPLAY), "depth")
    monkeypatch.setattr(array_kernel, "render_tiles", forbidden)
    plain.render()
    with pytest.raises(AssertionError, match="nobody"):
        deep.render()


def test_the_command_line_records_the_plan_and_refuses(tmp_path, capsys):
    main(["--size", "48x32", "--out", str(tmp_path / "auto")])
    main(["--size", "48x32", "--effects", "all", "--depth", "--out", str(tmp_path / "all")])
    assert (tmp_path / "auto" / "frame.png").read_bytes() == (tmp_path / "all" / "frame.png").read_bytes()
    assert (tmp_path / "all" / "depth.png").exists() and not (tmp_path / "auto" / "depth.png").exists()
    record = json.loads((tmp_path / "auto" / "stats.json").read_text())["effects"]
    assert record["wanted"] == "auto" and record["effects"]["sh"]["state"] == "called for"
    assert "sh          called for  harmonics of degree 3" in capsys.readouterr().out
    with pytest.raises(InputError, match=r"'none' are not accepted: this frame calls for more \(sh: harmonics of degree 3"):
        main(["--size", "48x32", "--effects", "none", "--out", str(tmp_path / "none")])
    assert not (tmp_path / "none").exists()
