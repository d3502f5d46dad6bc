"""Joint frames with a warped target against `spec.joint_warp`: both sweeps in plain Python, and all pixels, with ==."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from golden.msv2_ref import warp as warp_unit
from golden.msv2_ref.array import render_visits
from golden.msv2_ref.buckets import next_bounds
from golden.msv2_ref.eyes import render_stereo
from golden.msv2_ref.frame_memory import display_pixels, frame_pixels
from golden.msv2_ref.joint import SOURCE, TARGET, render_joint, render_joint_frame
from golden.msv2_ref.joint_batches import JointBatches
from golden.msv2_ref.joint_warp import WarpedJointFrame, render_warped_joint, render_warped_joint_frame
from golden.scenes.gaze import Display
from golden.scenes.stereo import stereo_pair, warpable_tiles
from spec.config import TINY, TINY_EYES, TINY_EYES_WARP
from spec.constants import TILE
from spec.errors import InputError
from tests.helpers.golden_samples import map_for, random_model, turned_view

SMALL = TINY_EYES_WARP.with_(batch_places=16)
"""Batches of 9 to 16 places."""

SIZES = ((300, 90), (140, 70), (64, 48))


def random_warped(seed: int, config=SMALL, **options) -> WarpedJointFrame:
    """A frame whose right and lower super-tiles are cut; the seed says how many tiles are known, and how many have holes."""
    rng = np.random.default_rng(seed)
    camera = turned_view(*SIZES[seed % 3])
    model = random_model(rng, (1500, 60, 900)[seed % 3], levels=4, sh=seed % 2, wild=seed == 2)
    pair = stereo_pair(camera, units_per_metre=(1.0, 20.0, 6.0)[seed % 3], source_eye=("left", "right")[seed % 2])
    options = {"threshold_deg": (20.0, 30.0, 15.0, 0.0)[seed % 4], **options}
    return render_warped_joint(model, pair, config=config, foveation=map_for(camera, (0.2, 0.6), 4),
                               background=(0.1, 0.5, 0.9), **options)


@pytest.fixture(scope="module", params=range(4))
def frame(request) -> WarpedJointFrame:
    return random_warped(request.param)


def unwarped(frame: WarpedJointFrame):
    """The joint frame with the same registers, of which nothing is warped."""
    return render_joint_frame(frame.config, frame.source.words, replace(frame.registers, warping=None))


def test_the_seeds_have_tiles_of_every_kind(frame):
    assert frame.holes.any()
    assert (~frame.rendered).any() or len(frame.known) < 20


def test_rendered_tiles_are_those_of_the_joint_frame(frame):
    plain = unwarped(frame)
    for mine, other in zip(frame.source.pixels, plain.source.pixels, strict=True):
        assert np.array_equal(mine, other)
    for mine, other in zip(frame.target.pixels, plain.target.pixels, strict=True):
        assert np.array_equal(mine[frame.rendered], other[frame.rendered])
        assert not mine[~frame.rendered].any()


def test_lists_are_those_of_the_joint_frame(frame):
    plain = unwarped(frame)
    for mine, other in zip(frame.joint.pairs[:-1], plain.pairs[:-1], strict=True):
        assert np.array_equal(mine, other)
    assert frame.joint.counts == plain.counts


def test_warped_pixels_are_those_of_a_machine_with_lists_by_tile():
    """One level and the same words, so that the source's frame is the same on both machines."""
    rng = np.random.default_rng(7)
    camera = turned_view(140, 70)
    model = random_model(rng, 500, levels=1, sh=0)
    pair, background = stereo_pair(camera, units_per_metre=2.0), (0.2, 0.3, 0.4)
    frame = render_warped_joint(model, pair, config=SMALL, threshold_deg=0, second_sweep=False, background=background)
    machine = TINY.with_(stereo=True, order="spatial", chunks=True, records="compact")
    other = render_stereo(frame.source.words, pair, config=machine, threshold_deg=0, background=background)
    for mine, wanted in zip(frame.source.pixels, other.source.pixels, strict=True):
        assert np.array_equal(mine, wanted)
    assert np.array_equal(frame.registers.warping.warp, other.registers.warp)
    assert frame.registers.warping.disparity_scale == other.registers.disparity_scale
    assert np.array_equal(frame.warped.pixels, other.warped.pixels)
    assert np.array_equal(frame.warped.invalid, other.warped.invalid)
    assert np.array_equal(frame.target_pixels, other.warped.pixels)
    assert frame.warped.events == other.warped.events


def source_order(frame: WarpedJointFrame) -> list[int]:
    """The source's tiles in the order in which they are finished."""
    return [tile for row in frame.joint.grids[SOURCE].tile.tolist() for tile in row if tile >= 0]


def test_the_order_of_super_tiles_warps_what_rows_do(frame):
    """Tiles come super-tile by super-tile, into one strip for even and another one for odd rows of tiles. A strip is complete
    with its last tile, and only then does the next one of its kind begin."""
    r, warping = frame.registers.source, frame.registers.warping
    moved = warp_unit.warp_pixels(frame.config, frame_pixels(frame.source), warping.disparity_scale, warping.source_right)
    strips: list[dict] = [{}, {}]
    begun, counts, finished = [None, None], [0, 0], {}
    for tile in source_order(frame):
        y, x = divmod(tile, r.tiles_x)
        lane = y % 2
        if not counts[lane]:
            assert begun[lane] is None or y == begun[lane] + 2
            begun[lane], strips[lane] = y, {}
        assert y == begun[lane]
        for row in range(TILE * y, min(TILE * y + TILE, r.height)):
            for column in range(TILE * x, min(TILE * x + TILE, r.width)):
                pixel = moved[row, column]
                old = strips[lane].get((row, int(pixel["x"])))
                if pixel["keep"] and (old is None or pixel["key"] > old["key"]):
                    strips[lane][row, int(pixel["x"])] = pixel
        counts[lane] = (counts[lane] + 1) % r.tiles_x
        if not counts[lane]:
            finished[y] = strips[lane]
    assert sorted(finished) == list(range(r.tiles_y))
    wanted = {(row, x) for row, x in zip(*np.nonzero(frame.warped.strips["valid"]), strict=True)}
    found = {place: pixel for strip in finished.values() for place, pixel in strip.items()}
    assert set(found) == wanted
    for (row, x), pixel in found.items():
        place = frame.warped.strips[row, x]
        assert place["key"] == pixel["key"] and (place["colour"] == pixel["colour"]).all()


def test_the_target_is_put_together_from_tiles_and_warped_pixels(frame):
    r = frame.registers.target
    rendered = display_pixels(frame.target)
    for tile in range(len(r.header)):
        y, x = divmod(tile, r.tiles_x)
        here = (slice(TILE * y, TILE * y + TILE), slice(TILE * x, TILE * x + TILE))
        assert np.array_equal(frame.target_pixels[here], (rendered if frame.rendered[tile] else frame.warped.pixels)[here])
    assert np.array_equal(frame.holes, frame.warped.invalid & (frame.registers.warping.warp == 1))


def wanted_tiles(frame: WarpedJointFrame) -> list[tuple[set[int], set[int]]]:
    """For each sweep the tiles of source and target that it renders."""
    tiles = set(range(len(frame.known)))
    first = (tiles, set(np.flatnonzero(frame.known).tolist()))
    return [first, (set(), set(np.flatnonzero(frame.holes).tolist()))]


def test_sweeps_are_those_of_the_text(frame):
    joint, sweeps = frame.joint, frame.sweeps
    owners = [dict(zip(range(len(grid.supertile)), grid.supertile.tolist(), strict=True)) for grid in joint.grids]
    entries = [[set(eye.entries.splat[eye.entries.start[t] : eye.entries.start[t + 1]].tolist())
                for t in range(len(frame.known))] for eye in joint.eyes]
    got, at = sweeps.pairs, 0
    for sweep, wanted in enumerate(wanted_tiles(frame)):
        for number in range(joint.grids[0].columns * joint.grids[0].rows):
            own = [[t for t in wanted[eye] if owners[eye][t] == number] for eye in (SOURCE, TARGET)]
            pairs = range(joint.pairs.start[number], joint.pairs.start[number + 1])
            listed = [] if sweep and not own[TARGET] else list(pairs)
            place = sweep * (len(joint.pairs.start) - 1) + number
            assert (got.start[place], got.start[place + 1]) == (at, at + len(listed))
            for pair in listed:
                splat = int(joint.pairs.splat[pair])
                assert (got.splat[at], got.index[at], got.depth_key[at]) == (
                    splat, joint.pairs.index[pair], joint.pairs.depth_key[pair])
                for eye in (SOURCE, TARGET):
                    mine = [t for t in own[eye] if splat in entries[eye][t]]
                    level = joint.eyes[eye].registers.header[:, 0]
                    assert got.mask[at, eye] == sum(1 << int(joint.grids[eye].place[t]) for t in mine)
                    assert got.levels[at, eye] == sum(1 << lv for lv in {int(level[t]) for t in mine})
                at += 1
    assert at == len(got.splat) and frame.again == at - len(joint.pairs.splat)


def test_visits_render_the_tiles_of_each_sweep_once(frame):
    batches = JointBatches(frame.sweeps)
    visits = batches.stream_visits()
    supertiles = len(frame.joint.pairs.start) - 1
    last = [(int(s) >= supertiles, int(eye), int(tile)) for s, eye, tile, final in zip(
        batches.batches.supertile[visits.batch], visits.eye, visits.tile, visits.final, strict=True) if final]
    wanted = {(bool(sweep), eye, tile) for sweep, eyes in enumerate(wanted_tiles(frame))
              for eye, tiles in enumerate(eyes) for tile in tiles}
    assert len(last) == len(wanted) and set(last) == wanted
    for eye, drawn in enumerate(frame.sweeps.eyes):
        records, entries = batches.records_of(eye)
        got = render_visits(frame.config, records, entries, drawn.registers.background)
        tiles = [t for t, e in zip(visits.tile.tolist(), visits.eye.tolist(), strict=True) if e == eye]
        assert len(records) == len(tiles)
        finals = visits.tile[(visits.eye == eye) & visits.final]
        for name, values in got._asdict().items():
            assert np.array_equal(values, getattr(drawn.pixels, name)[finals]), name


def test_without_a_second_sweep_holes_stay():
    frame = random_warped(3, second_sweep=False)
    assert not frame.holes.any() and frame.again == 0
    assert len(frame.sweeps.pairs.start) == len(frame.joint.pairs.start)
    left = (frame.warped.origin == warp_unit.HOLE) & (frame.origin == 5)
    assert left.any() and frame.shares["holes"] == pytest.approx(left.mean())
    assert not frame.target_pixels["colour"][left].any() and not frame.target_pixels["coverage"][left].any()


def test_without_holes_there_is_no_second_sweep():
    frame = random_warped(0, threshold_deg=180.0)
    assert frame.known.all() and len(frame.sweeps.pairs.start) == len(frame.joint.pairs.start)
    plain = unwarped(frame)
    assert np.array_equal(frame.target_pixels, display_pixels(plain.target))
    for name in ("start", "splat", "mask", "levels"):
        assert np.array_equal(getattr(frame.sweeps.pairs, name), getattr(plain.pairs, name))


def test_colours_bounds_shift_and_merging_change_what_they_say():
    frame = random_warped(3)
    shared = random_warped(3, shared_colour=True)
    assert np.array_equal(frame.source_pixels, shared.source_pixels)
    assert not np.array_equal(frame.target_pixels, shared.target_pixels)
    moved = random_warped(3, shift=frame.registers.shift + 3)
    assert np.array_equal(frame.target_pixels, moved.target_pixels)
    assert not np.array_equal(frame.joint.pairs.start, moved.joint.pairs.start)
    lists = np.bincount(frame.joint.pairs.supertile, minlength=len(frame.joint.pairs.start) - 1) > 0
    alone = random_warped(3, beta=0)
    hole = np.unique(frame.joint.grids[TARGET].supertile[frame.holes])
    assert frame.groups - frame.source.groups[-1] - 1 == alone.groups - alone.source.groups[-1] - 1 == lists[hole].sum()


def test_bounds_make_more_lists_for_both_sweeps():
    frame = random_warped(3)
    pairs = frame.joint.pairs
    bounds = next_bounds(frame.config, pairs.start, pairs.depth_key)
    again = render_warped_joint_frame(frame.config, frame.source.words, frame.registers, bounds=bounds)
    assert np.array_equal(frame.target_pixels, again.target_pixels)
    assert again.lists_again.sum() >= frame.lists_again.sum()


def test_the_table_of_known_tiles_is_that_of_the_threshold(frame):
    camera = frame.pair.source
    wanted = warpable_tiles(Display(camera.width, camera.height), frame.joint.gaze[TARGET], frame.threshold_deg)
    assert np.array_equal(frame.known, ~wanted.reshape(-1))


def test_machines_without_a_warp_unit_are_refused(frame):
    model, pair = frame.source.words, frame.pair
    with pytest.raises(InputError, match="v3_eyes_warp"):
        render_warped_joint(model, pair, config=TINY_EYES)
    with pytest.raises(InputError, match="lists by tile"):
        render_warped_joint(model, pair, config=TINY.with_(stereo=True))
    with pytest.raises(ValueError, match="warped target"):
        render_warped_joint_frame(frame.config, model, replace(frame.registers, warping=None))
    with pytest.raises(InputError, match="threshold"):
        render_warped_joint(model, pair, config=SMALL, threshold_deg=181)


def test_a_joint_frame_of_the_same_machine_is_that_of_one_without_a_warp_unit(frame):
    model, pair = frame.source.words, frame.pair
    mine, other = (render_joint(model, pair, config=config.with_(batch_places=16)) for config in (TINY_EYES_WARP, TINY_EYES))
    for a, b in zip(mine.images, other.images, strict=True):
        assert np.array_equal(a, b)
