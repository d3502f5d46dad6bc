"""The rendering array's RTL against the golden renderer, and the comparison against faults put there on purpose.

PAPER_SMALL and the variants of TINY take a build each: they are long.
"""

from dataclasses import replace

import numpy as np
import pytest

from golden.msv2_ref import array
from golden.msv2_ref.array import Pixels
from rtl.units import emit
from rtl.vrc_array import pixel_core
from spec import tables
from spec.config import TINY
from spec.errors import InputError
from tb import sim
from tb.common.player import play
from tb.vrc_array import array_suite
from tb.vrc_array.array_check import golden_pixels, mismatches, problems
from tb.vrc_array.array_device import tiles_from_rows, vrc_playback
from tb.vrc_array.array_stimuli import CORNERS, TileSpec, frame, random_case, random_entries
from tb.vrc_array.traced import pick_tiles


def quick_plan(config):
    return [
        *array_suite.corner_plan(config), *array_suite.random_plan(config, 0),
        *array_suite.stream_plan(config, 0), *array_suite.frame_plan(config, 0)]


@pytest.fixture(scope="module")
def tiny(tmp_path_factory):
    """TINY's outcome, by run."""
    return array_suite.run_plan(TINY, quick_plan(TINY), tmp_path_factory.mktemp("vrc"))


def planned(name):
    return next(p for p in quick_plan(TINY) if p.name == name)


def test_tiny_is_bit_exact(tiny):
    assert tiny.failures == {}
    assert tiny.runs == len(quick_plan(TINY)) - 4 and tiny.items * TINY.cores_x > 80_000  # four runs are cut off


def test_a_presets_numbers_are_bit_exact(tmp_path):
    config = array_suite.VARIANTS["tiny-short"]
    assert array_suite.run_plan(config, array_suite.random_plan(config, 0), tmp_path).failures == {}


@pytest.mark.long
@pytest.mark.parametrize("name", [name for name in array_suite.DISTINCT if name != "tiny"])
def test_other_machines_are_bit_exact(name, tmp_path):
    config = array_suite.VARIANTS[name]
    outcome = array_suite.run_plan(config, array_suite.full_plan(config, 0), tmp_path)
    assert outcome.failures == {}


@pytest.mark.long
def test_default_takes_an_entry_a_cycle(tmp_path):
    config = array_suite.VARIANTS["paper_small"]
    case = next(make for make in CORNERS if make.__name__ == "_long")(config)
    plan = [array_suite.plan_of(config, case)]
    assert array_suite.run_plan(config, plan, tmp_path).recordings[case.name].cycles < len(case.entries) + 150


@pytest.mark.parametrize("field", Pixels._fields)
def test_one_flipped_bit_is_caught(tiny, field):
    plan = planned("random 0")
    golden = golden_pixels(TINY, plan.case)
    assert problems(TINY, plan.case, tiny.recordings["random 0"], golden) == []
    getattr(golden, field)[5, 7, 3] ^= 1
    wrong = problems(TINY, plan.case, tiny.recordings["random 0"], golden)
    assert len(wrong) == 1 and wrong[0].startswith(f"tile 5 pixel (3, 7): {field} is")


@pytest.mark.parametrize("segment", range(16))
def test_one_wrong_table_value_is_caught(tiny, monkeypatch, segment):
    base, slope = tables.exp2_segments(TINY.formats)
    base[segment] += 1
    monkeypatch.setattr(tables, "exp2_segments", lambda formats: (base, slope))
    array._mantissas.cache_clear()
    try:
        plan = planned("every exponent")
        assert problems(TINY, plan.case, tiny.recordings["every exponent"], golden_pixels(TINY, plan.case))
    finally:
        array._mantissas.cache_clear()


@pytest.mark.long
def test_a_fault_in_the_rtl_is_caught(monkeypatch, tmp_path):
    plan, clean = array_suite.corner_plan(TINY), vrc_playback(TINY)
    golden = [golden_pixels(TINY, p.case) for p in plan]
    base, slope = tables.exp2_segments(TINY.formats)
    slope[9] -= 1
    with monkeypatch.context() as patch:
        patch.setattr(pixel_core, "exp2_segments", lambda formats: (base, slope))
        playback = replace(clean, verilog=emit("vrc_array", TINY))
    assert playback.verilog != clean.verilog
    recordings = play(playback, [p.run for p in plan], tmp_path)
    caught = [p.name for p, r, g in zip(plan, recordings, golden, strict=True) if problems(TINY, p.case, r, g)]
    assert "every exponent" in caught


@pytest.mark.parametrize(("run", "changes"), [
    ("alpha at the cut", {"support_sigma": 2.99}),
    ("alpha at the cut", {"support_sigma": None}),
    ("random 0", {"depth": False}),
])
def test_another_machine_is_told_apart(tiny, run, changes):
    plan = planned(run)
    assert problems(TINY, plan.case, tiny.recordings[run], golden_pixels(TINY.with_(**changes), plan.case))


def test_a_wrong_background_is_caught(tiny):
    plan = planned("empty tiles")
    other = replace(plan.case, background=np.bitwise_xor(plan.case.background, [0, 0, 1]))
    wrong = problems(TINY, plan.case, tiny.recordings["empty tiles"], golden_pixels(TINY, other))
    assert len(wrong) == 6 and "more values" in wrong[-1]


def test_missing_doubled_and_misplaced_rows_are_caught(tiny):
    plan, recording = planned("random 0"), tiny.recordings["random 0"]
    golden, rows = golden_pixels(TINY, plan.case), recording.outputs["pixels"]
    doubled, misplaced = rows.copy(), rows.copy()
    doubled[3] = doubled[2]
    misplaced["tile_x"][100] += 1
    for broken, says in ((rows[:-1], "must give"), (doubled, "must come once"), (misplaced, "tile_x")):
        text, = problems(TINY, plan.case, replace(recording, outputs={"pixels": broken}), golden)
        assert says in text
    shuffled = rows.copy().reshape(len(plan.case.headers), -1)[:, ::-1].ravel()
    assert mismatches(tiles_from_rows(TINY, plan.case.headers, shuffled), golden) == []


def test_corners_show_something():
    """A case whose pixels are all background, or all alike, would prove little."""
    dull = {"empty tiles", "dropped pairs"}
    for make in CORNERS:
        case = make(TINY)
        pixels = golden_pixels(TINY, case)
        assert len(np.unique(pixels.colour)) > 1
        if case.name not in dull:
            assert pixels.transmittance.min() < 62000, case.name


def test_picked_tiles_are_those_of_the_frame():
    case = random_case(TINY, "random", 3, tiles=40)
    part = pick_tiles(case, seed=1, tiles=10, entries=200)
    assert len(part.headers) <= 10 and part.headers["count"].sum() == len(part.entries) <= 200
    whole = golden_pixels(TINY, case)
    places = [np.flatnonzero(case.headers == header)[0] for header in part.headers]
    assert mismatches(golden_pixels(TINY, part), Pixels(*(field[places] for field in whole))) == []


def test_one_level_has_no_blend_tiles():
    config = TINY.with_(levels=1)
    entries = random_entries(config, np.random.default_rng(0), 4, 3, 2)
    case = frame(config, "x", [TileSpec(entries, outer=1, blend=1)])
    assert not case.headers["blend"].any() and not case.headers["outer"].any() and not case.entries["use"][:, 1].any()


@pytest.mark.parametrize(("argv", "says"), [
    (["--test", "gpu"], r"'gpu' is not accepted: choose one of all, float, chunk_test, chunk_reader, culling"),
    (["--config", "huge"], r"'huge' is not accepted: choose one of all, tiny, .*default"),
    (["--config", "tiny", "--wave-cycles", "9:3"], r"'9:3' is not accepted"),
    (["--config", "tiny", "--seed", "-1"], r"-1 is not accepted"),
    (["--test", "vrc", "--config", "tiny", "--runs", "nothing like it"], r"no run has that in its name"),
])
def test_bad_requests_name_what_is_accepted(argv, says, monkeypatch):
    monkeypatch.setattr(array_suite, "full_plan", lambda config, seed: quick_plan(config))
    with pytest.raises(InputError, match=says):
        sim.main(argv)
