"""The machine's plan of frames: what it covers, and that every kind of wrong result is told."""

from dataclasses import replace

import numpy as np
import pytest

from golden.host.memory_image import DisplayPixels, FramePixels
from golden.msv2_ref import projection
from golden.msv2_ref.batches import FrameBatches
from golden.msv2_ref.events import expected_events
from spec.chunks import CHUNK
from spec.codes import ErrorCode
from spec.config import TINY
from spec.host_settings import first_illegal
from tb.frame.bound import array_ops, least_cycles
from tb.top.check_stereo import stereo_events
from tb.top.player import FrameResult, setting_writes
from tb.top.suite import DISTINCT, VARIANTS, broken_plan, good_plan, problems


@pytest.fixture(scope="module")
def plans():
    return good_plan(TINY, 0), broken_plan(TINY, 0)


def test_plans_cover_what_the_machine_can_meet(plans):
    good, broken = plans
    names = [item.name for item in (*good, *broken)]
    assert len(set(names)) == len(names) and set(DISTINCT) <= set(VARIANTS)
    frames = [item.frame for item in good]
    chunk = TINY.sort_chunk
    assert any(np.bincount(f.groups, np.diff(f.entries.start)).max() > TINY.merge_ways * chunk / 2 for f in frames)
    assert {f.words.sh_degree for f in frames} == {0, 1, 2, 3} and {len(f.words.geometry) for f in frames} >= {0, 1}
    assert all({i.run.image.settings["display"] for i in good if i.frame is f} == {0, 1} for f in frames)
    assert any((f.registers.header[:, 1] == 1).any() for f in frames) and any(f.entries.filtered for f in frames)
    reasons = set(np.concatenate([f.projected.reason for f in frames]).tolist())
    assert {projection.VISIBLE, projection.NEAR, projection.OUTSIDE} <= reasons
    assert {item.error for item in broken} == set(ErrorCode) - {ErrorCode.COUNT_SATURATED, ErrorCode.WATCHDOG}
    assert all(item.error is ErrorCode.NONE and item.run.cut is None for item in broken[1::2])


def test_bad_settings_are_those_that_spec_refuses(plans):
    for item in plans[1]:
        patterns = setting_writes(TINY, item.run.image, item.run.changes)
        expected = item.registers["bad_setting"] if item.error is ErrorCode.BAD_SETTING else None
        assert first_illegal(TINY, patterns) == expected


def test_plans_of_chunks_cover_what_the_machine_can_meet():
    for name in ("tiny_records", "tiny_chunks"):
        config = VARIANTS[name]
        frames = [item.frame for item in good_plan(config, 0)[: len(good_plan(config, 0)) // 2]]
        read, skipped = ([getattr(f, f"chunks_{what}") for f in frames] for what in ("read", "skipped"))
        assert {(r > 0, s > 0) for r, s in zip(read, skipped, strict=True)} == {(r, s) for r in (0, 1) for s in (0, 1)}
        counts = np.concatenate([f.words.chunks["count"] for f in frames])
        assert counts.max() == CHUNK and counts.min() == 1
        failing = {item.name for item in broken_plan(config, 0) if "chunks fails" in item.name}
        assert len(failing) == 2  # the frame, and the one after it


def right_result(item):
    frame = item.frame
    pixels = FramePixels(*(frame.untiled(getattr(frame.pixels, name)).astype(np.int64) for name in FramePixels._fields))
    registers = {**expected_events(frame), "read_beats": 5, "write_beats": 6}
    return FrameResult(pixels, ErrorCode.NONE, True, registers, 100, 5, 6, 11, 0.1, 0.1, ())


def test_every_kind_of_wrong_result_is_told(plans):
    item = plans[0][4]
    right = right_result(item)
    assert problems(item, right) == []
    colour = right.pixels.colour.copy()
    colour[3, 18, 2] ^= 1
    for wrong, says in (
        (replace(right, pixels=right.pixels._replace(colour=colour)), "tile 1 pixel (18, 3): colour is"),
        (replace(right, errors=("a rule",)), "a rule"), (replace(right, reads=4), "counter read_beats must be 4, not 5"),
        (replace(right, done=False), "ended with NONE, done False, instead of NONE"),
        (replace(right, error=ErrorCode.WATCHDOG, done=False), "ended with WATCHDOG"),
        (replace(right, registers={**right.registers, "groups": 0}), "counter groups must be"),
    ):
        assert any(says in problem for problem in problems(item, wrong)), says
    failing = next(item for item in plans[1] if item.registers)
    registers = {name: value ^ 1 for name, value in failing.registers.items()}
    told = problems(failing, replace(right, error=failing.error, done=False, registers=registers))
    assert len(told) == len(registers) and "register error_clients must be" in told[0]


def test_plans_of_super_tiles_cover_what_the_machine_can_meet():
    config = VARIANTS["tiny_v3"]
    good, broken = good_plan(config, 0), broken_plan(config, 0)
    frames = [item.frame for item in good[: len(good) // 2]]
    batches = [FrameBatches(frame) for frame in frames]
    assert {0, 1} <= {len(b.pairs.splat) for b in batches} and any((np.diff(b.pairs.start) == 0).any() for b in batches)
    assert any((~b.visits.final).any() for b in batches) and any((b.place_counts > 1).any() for b in batches)
    assert any(len(b.grid.tile) > 1 and not b.grid.inside.all() for b in batches)
    assert any(frame.registers.header[:, 1].any() for frame in frames)
    assert {item.error for item in broken} == set(ErrorCode) - {ErrorCode.COUNT_SATURATED, ErrorCode.WATCHDOG}
    failing = {item.name.split(", ")[1] for item in broken if "fails" in item.name and "after" not in item.name}
    assert failing == {f"{name} fails" for name in ("geometry", "tiles", "colour", "chunks", "supertiles", "entries", "frame",
                                                    "spill")}
    least = [least_cycles(item.frame) for item in broken if item.run.abort]
    assert all(item.run.abort < cycles for item, cycles in zip((i for i in broken if i.run.abort), least, strict=True))


def test_impossible_numbers_of_visits_are_told():
    item = next(item for item in good_plan(VARIANTS["tiny_v3"], 0) if "clusters" in item.name)
    visits = FrameBatches(item.frame).visits
    most = {"visits": len(visits.final), "ops": array_ops(item.frame), "skipped": len(item.frame.entries.splat)}
    right = right_result(item)
    right = replace(right, registers=right.registers | most)
    assert problems(item, right) == []
    for name, value in most.items():
        wrong = replace(right, registers=right.registers | {name: value + 1})
        assert [problem for problem in problems(item, wrong) if f"counter {name} must be in" in problem]
    few = replace(right, registers=right.registers | {"visits": int(visits.final.sum()) - 1})
    assert len(problems(item, few)) == 1


STEREO = VARIANTS["tiny_stereo"]


@pytest.fixture(scope="module")
def stereo_plans():
    return good_plan(STEREO, 0), broken_plan(STEREO, 0)


def test_plans_of_two_eyes_cover_what_the_machine_can_meet(stereo_plans):
    good, broken = stereo_plans
    names = [item.name for item in (*good, *broken)]
    assert len(set(names)) == len(names)
    frames = [item.stereo for item in good if item.stereo]
    warped, rendered = [f.registers.warp == 1 for f in frames], [f.rendered for f in frames]
    assert {f.registers.source_right for f in frames} == {True, False}
    assert any(w.all() and not r.any() for w, r in zip(warped, rendered, strict=True))
    assert any(not w.any() for w in warped) and any(w.any() and not w.all() and (w & r).any() and (w & ~r).any()
                                                    for w, r in zip(warped, rendered, strict=True))
    kinds = np.concatenate([f.warped.origin.reshape(-1) for f in frames])
    assert set(kinds.tolist()) == {0, 1, 2, 3} and any(not f.events["warped"] for f in frames)
    assert any((f.registers.target.header[:, 1] == 1).any() and f.target.entries.filtered for f in frames)
    chunk = STEREO.sort_chunk
    for eye in ("source", "target"):
        groups = [np.bincount(f.groups, np.diff(f.entries.start)).max() for f in (getattr(f, eye) for f in frames)]
        assert max(groups) > chunk
    single = [item for item in good if not item.stereo]
    assert {item.run.image.settings["display"] for item in single} == {0, 1} and not any(item.run.reset for item in single)
    assert {item.error for item in broken} == set(ErrorCode) - {ErrorCode.COUNT_SATURATED, ErrorCode.WATCHDOG}
    assert all(item.error is ErrorCode.NONE and item.run.cut is None for item in broken[1::2])
    assert {(bool(item.run.abort), bool(item.run.cut)) for item in broken if item.run.late} == {(True, False), (False, True)}
    for item in broken:
        patterns = setting_writes(STEREO, item.run.image, item.run.changes)
        expected = item.registers["bad_setting"] if item.error is ErrorCode.BAD_SETTING else None
        assert first_illegal(STEREO, patterns) == expected


def test_every_kind_of_wrong_result_of_two_eyes_is_told(stereo_plans):
    item = stereo_plans[0][0]
    frame = item.stereo
    eyes = [DisplayPixels(*(pixels[name].astype(np.int64) for name in DisplayPixels._fields))
            for pixels in (frame.source_pixels, frame.target_pixels)]
    registers = {**stereo_events(frame), "read_beats": 5, "write_beats": 6}
    right = FrameResult(eyes[0], ErrorCode.NONE, True, registers, 100, 5, 6, 11, 0.1, 0.1, (), eyes[1])
    assert problems(item, right) == []
    colour = eyes[1].colour.copy()
    colour[3, 18, 2] ^= 1
    target = eyes[1]._replace(colour=colour)
    assert problems(item, replace(right, target=target))[0].startswith("right eye, tile 1 pixel (18, 3): colour is")
    assert any("left eye, tile" in text for text in problems(item, replace(right, pixels=eyes[1])))
    for name in stereo_events(frame):
        wrong = replace(right, registers={**registers, name: registers[name] + 1})
        assert problems(item, wrong) == [f"counter {name} must be {registers[name]}, not {registers[name] + 1}"]
