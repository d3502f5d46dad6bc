"""The cycle model of joint frames with a warped target: what it counts is what the golden frame has, and what is rendered costs
what is rendered."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from golden.msv2_ref.joint_batches import JointBatches
from golden.msv2_ref.joint_warp import WarpedJointFrame, render_warped_joint, swept
from golden.scenes.stereo import stereo_pair
from perf.joint_trace import joint_trace
from perf.model import MemoryModel
from perf.supertiles import SuperCycles, simulate_supertiles
from perf.warp_trace import FILLED, UNWRITTEN, strip_fills, warped_trace
from spec.config import TINY_EYES, TINY_EYES_WARP, V3_EYES_WARP, AcceleratorConfig
from spec.constants import TILE
from spec.memory import BEAT_BYTES, WORDS
from tests.helpers.golden_samples import map_for, random_model, turned_view

FAST = MemoryModel(latency=20, bytes_per_cycle=None)


def frame_of(
    seed: int = 0, size: tuple[int, int] = (300, 90), sh: int = 1, config: AcceleratorConfig = TINY_EYES_WARP, **options,
) -> WarpedJointFrame:
    rng = np.random.default_rng(seed)
    camera = turned_view(*size)
    model = random_model(rng, 500, levels=4, sh=sh)
    return render_warped_joint(
        model, stereo_pair(camera, source_eye=("left", "right")[seed % 2]), config=config,
        foveation=map_for(camera, (0.2, 0.6), 4), **{"threshold_deg": 20.0, **options})


def cycles(frame: WarpedJointFrame, memory: MemoryModel = FAST, **options) -> SuperCycles:
    return simulate_supertiles(warped_trace(frame), frame.config, memory=memory, **options)


@pytest.fixture(scope="module")
def frame() -> WarpedJointFrame:
    return frame_of()


@pytest.fixture(scope="module")
def found(frame) -> SuperCycles:
    return cycles(frame)


def test_counts_are_those_of_the_golden_frame(frame, found):
    events, batches = frame.joint.counts, JointBatches(frame.sweeps)
    assert frame.holes.any() and frame.known.any() and not frame.rendered.all()
    assert (found.pairs, found.again, found.groups) == (events["pairs"], frame.again, frame.groups)
    assert found.entries == sum(len(eye.entries.splat) for eye in frame.sweeps.eyes)
    assert found.fetch_misses == batches.header_misses
    assert found.stages["fetch"].busy == found.pairs + found.again
    assert found.batches == len(batches.batches.supertile)
    rows = TILE * TILE // frame.config.array_x
    assert found.stages["pixel_write"].busy == rows * (len(frame.rendered) + int(frame.rendered.sum()))
    assert found.stages["warp"].busy == rows * len(frame.rendered)
    assert 0 < found.sweep_cycles < found.phases["render"]


def test_the_warp_unit_writes_what_is_not_known(frame, found):
    r, address = frame.registers.target, 0
    beats = set()
    for y in range(r.height):
        for x in range(r.width):
            address = y * r.width + x
            if not frame.known[y // TILE * r.tiles_x + x // TILE]:
                beats.add((y, address // WORDS))
    assert found.writes["warp"] == BEAT_BYTES * len(beats)


def test_pairs_are_projected_for_the_eyes_that_their_sweep_wants(frame, found):
    trace = warped_trace(frame)
    first = ~trace.second
    supertile = trace.drawn.supertile
    known = {int(s) for s in frame.joint.grids[1].supertile[frame.known]}
    assert [e == 2 for e in trace.eyes[first]] == [int(s) in known for s in supertile[first]]
    assert (trace.eyes[~first] == 1).all()
    joint = simulate_supertiles(trace.joint, TINY_EYES_WARP, memory=FAST, display=True)
    assert found.stages["tile_test"].busy - joint.stages["tile_test"].busy == int(trace.eyes.sum()) - 2 * joint.pairs
    shared = cycles(frame_of(shared_colour=True), shared_colour=True)
    assert shared.stages["tile_test"].busy - found.stages["tile_test"].busy == frame.again


def test_nothing_warped_costs_what_the_joint_frame_does():
    frame = frame_of(threshold_deg=180.0)
    joint = simulate_supertiles(joint_trace(replace(frame.joint, registers=replace(frame.registers, warping=None))), TINY_EYES,
                                memory=FAST, display=True)
    found = cycles(frame)
    assert found.again == found.sweep_cycles == 0 == found.writes["warp"]
    assert {**found.reads} == joint.reads and found.ops == joint.ops
    assert joint.total <= found.total < 1.1 * joint.total  # the warp unit takes rows no faster than its lanes


def test_holes_that_stay_cost_nothing(frame, found):
    still = frame_of(second_sweep=False)
    without = cycles(still)
    assert without.again == 0 and without.total < found.total
    assert without.ops < found.ops and without.writes["warp"] == found.writes["warp"]
    assert found.total - without.total == pytest.approx(found.sweep_cycles, rel=0.05)


@pytest.mark.parametrize("seed", [1, 2])
def test_every_eye_and_memory_ends(seed):
    frame = frame_of(seed, (140, 70), sh=0)
    for memory in (MemoryModel(kind="lpddr3"), MemoryModel()):
        assert cycles(frame, memory).stages["pixel_write"].busy


def test_frames_of_more_super_tiles_than_a_byte_counts():
    found = frame_of(size=(1030, 530), sh=0, config=V3_EYES_WARP)
    assert found.joint.grids[0].supertile.max() > 127
    assert cycles(found).again == found.again > 0


def test_four_streams():
    config = TINY_EYES_WARP.with_(cores_x=8, cores_y=8, streams=4)
    frame = frame_of()
    on_four = swept(replace(render_warped_joint(
        frame.source.words, frame.pair, config=config, foveation=frame.joint.foveations[0], threshold_deg=20.0).joint))
    found = cycles(on_four)
    assert found.again == frame.again and found.entries == cycles(frame).entries


def test_fills_say_where_holes_are_filled_and_which_beats_are_not_written(frame):
    fills = warped_trace(frame).fills
    assert np.array_equal((fills & FILLED) != 0, frame.warped.origin == 3)
    assert (fills & UNWRITTEN).any()
    even, odd = strip_fills(fills, 0), strip_fills(fills, 1)
    assert len(even) + len(odd) == len(fills) and np.array_equal(odd[:TILE], fills[TILE : 2 * TILE])


def test_machines_without_a_warp_unit_are_refused(frame):
    with pytest.raises(ValueError, match="warped eye, not 'tiny_eyes'"):
        simulate_supertiles(warped_trace(frame), TINY_EYES)
