"""Joint frames of the integer renderer against `spec.joint`: pairs in plain Python, and both eyes' pixels, with ==."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest

from golden.host.joint_registers import joint_registers, median_shift
from golden.host.quantise import quantise_model
from golden.metrics.image import psnr_vs
from golden.msv2_ref import joint, projection
from golden.msv2_ref.array import render_visits
from golden.msv2_ref.buckets import next_bounds
from golden.msv2_ref.chunk_test import read_chunks
from golden.msv2_ref.joint import JointFrame, render_joint, render_joint_frame
from golden.msv2_ref.joint_batches import JointBatches
from golden.msv2_ref.pipeline import Frame, render, render_frame
from golden.oracle.render import render as render_oracle
from golden.scenes.embedded.splats import cached_embedded_model
from golden.scenes.embedded.views import embedded_cameras
from golden.scenes.gaze import Display, no_foveation
from golden.scenes.levels import smfr_levels
from golden.scenes.stereo import stereo_pair
from spec.config import TINY, TINY_V3
from spec.constants import SUPER_X, SUPER_Y
from spec.errors import InputError
from spec.joint import grid_origins, joint_columns
from tests.helpers.golden_samples import map_for, random_model, turned_view, view

SMALL = TINY_V3.with_(batch_places=16)
"""Batches of 9 to 16 places."""

SIZES = ((300, 90), (140, 70), (64, 48))


def random_joint(seed: int, config=SMALL, **options) -> JointFrame:
    """A joint frame whose right and lower super-tiles are cut, with blend tiles and, by seed, few or many splats, a wide or a
    narrow baseline, and the left or the right eye as the source."""
    rng = np.random.default_rng(seed)
    camera = turned_view(*SIZES[seed % 3])
    model = random_model(rng, (1500, 60, 900)[seed % 3], levels=4, sh=seed % 2, wild=seed == 2)
    pair = stereo_pair(camera, units_per_metre=(1.0, 20.0, 6.0)[seed % 3], source_eye=("left", "right")[seed % 2])
    return render_joint(model, pair, config=config, foveation=map_for(camera, (0.2, 0.6), 4), background=(0.1, 0.5, 0.9),
                        **options)


@pytest.fixture(scope="module", params=range(4))
def frame(request) -> JointFrame:
    return random_joint(request.param)


def assert_same_pixels(got: Frame, wanted: Frame) -> None:
    for mine, other in zip(got.pixels, wanted.pixels, strict=True):
        assert np.array_equal(mine, other)


def alone(frame: JointFrame, eye: int) -> Frame:
    """The frame of one eye with the registers of an eye of a joint frame."""
    return render_frame(frame.config, frame.source.words, frame.registers.eyes[eye])


def lists_of(frame: JointFrame) -> dict[int, list[tuple[int, int, int, tuple[int, int]]]]:
    """By super-tile, its pairs in rendering order: (source's key, index word, row of the Gaussian, masks of both eyes)."""
    shift = frame.registers.shift
    origins = max(shift, 0), max(-shift, 0)
    r = frame.source.registers
    columns = max(-(-(r.tiles_x + origin) // SUPER_X) for origin in origins)
    masks = defaultdict(lambda: [0, 0])
    for eye, (drawn, origin) in enumerate(zip(frame.eyes, origins, strict=True)):
        e = drawn.entries
        for tile in range(len(r.header)):
            y, x = divmod(tile, r.tiles_x)
            number = y // SUPER_Y * columns + (x + origin) // SUPER_X
            bit = 1 << y % SUPER_Y * SUPER_X + (x + origin) % SUPER_X
            for splat in e.splat[e.start[tile] : e.start[tile + 1]].tolist():
                masks[number, splat][eye] |= bit
    words = {int(header["first"]) + place: chunk * 64 + place
             for chunk, header in enumerate(frame.source.words.chunks) for place in range(header["count"])}
    lists = {s: [] for s in range(columns * -(-r.tiles_y // SUPER_Y))}
    for (number, splat), mask in masks.items():
        lists[number].append((int(frame.source.projected.depth_key[splat]), words[splat], splat, tuple(mask)))
    return {number: sorted(pairs) for number, pairs in lists.items()}


def test_pairs_are_those_of_the_text(frame):
    wanted, pairs = lists_of(frame), frame.pairs
    masks = map(tuple, pairs.mask.tolist())
    got = zip(pairs.depth_key.tolist(), pairs.index.tolist(), pairs.splat.tolist(), masks, strict=True)
    assert list(got) == [pair for number in sorted(wanted) for pair in wanted[number]]
    assert np.diff(pairs.start).tolist() == [len(wanted[number]) for number in sorted(wanted)]
    for eye, (drawn, grid) in enumerate(zip(frame.eyes, frame.grids, strict=True)):
        assert np.array_equal(pairs.splat[pairs.intersection[eye]], drawn.entries.splat)
        level = drawn.registers.header[:, 0]
        for number, mask, levels in zip(pairs.supertile, pairs.mask[:, eye], pairs.levels[:, eye], strict=True):
            tiles = [grid.tile[number, place] for place in range(16) if mask >> place & 1]
            assert levels == sum(1 << lv for lv in {int(level[tile]) for tile in tiles})


def test_the_source_is_the_frame_of_one_eye(frame):
    wanted = alone(frame, joint.SOURCE)
    assert_same_pixels(frame.source, wanted)
    assert np.array_equal(frame.source.entries.splat, wanted.entries.splat)
    assert np.array_equal(frame.source.entries.start, wanted.entries.start)


def unlike_tiles(frame: JointFrame) -> np.ndarray:
    """(tiles,) bool: whether the list of a tile of the target is another one than in a frame of one eye; where it is the same,
    the pixels must be."""
    wanted, got = alone(frame, joint.TARGET), frame.target
    unlike = np.array([
        not np.array_equal(mine, other) for mine, other in zip(
            np.split(got.entries.splat, got.entries.start[1:-1]), np.split(wanted.entries.splat, wanted.entries.start[1:-1]),
            strict=True)])
    for mine, other in zip(got.pixels, wanted.pixels, strict=True):
        assert np.array_equal(mine[~unlike], other[~unlike])
    assert np.array_equal(np.diff(got.entries.start), np.diff(wanted.entries.start))
    return unlike


def test_the_target_is_the_frame_of_one_eye_where_the_order_is(frame):
    assert not unlike_tiles(frame).all()


def layered(seed: int, z: float, count: int = 400) -> JointFrame:
    """Splats at nearly one depth, seen by a turned camera, whose keys differ between the eyes by rounding."""
    rng = np.random.default_rng(seed)
    camera = turned_view(140, 70)
    model = random_model(rng, count, levels=1, sh=0)
    means = camera.position + (camera.rotation.T @ np.stack([
        rng.uniform(-0.8, 0.8, count) * z, rng.uniform(-0.4, 0.4, count) * z, z * (1 + rng.normal(0, 3e-6, count))])).T
    model = replace(model, means=means, log_scales=np.full((count, 3), np.log(0.05 * z)))
    return render_joint(model, stereo_pair(camera, units_per_metre=2.0), config=SMALL)


def test_both_eyes_have_the_order_of_the_sources_keys():
    frame = layered(1, 2.0)
    own = projection.project(frame.config, frame.source.words, frame.registers.target)
    both = (own.reason == projection.VISIBLE) & (frame.target.projected.reason == projection.VISIBLE)
    assert (own.depth_key != frame.target.projected.depth_key)[both].any()
    unlike = unlike_tiles(frame)
    assert unlike.any()
    key = frame.source.projected.depth_key.astype(np.int64)
    for mine in np.split(frame.target.entries.splat, frame.target.entries.start[1:-1]):
        order = np.stack([key[mine], mine])
        assert (np.lexsort(order[::-1]) == np.arange(len(mine))).all()


def test_the_near_plane_of_the_source_culls_in_both_eyes():
    """Splats at the near plane: rounding puts some of them in front of it in one eye, and behind it in the other."""
    frame = layered(2, 0.2, 2000)
    own = projection.project(frame.config, frame.source.words, frame.registers.target).reason
    source, target = (eye.projected.reason for eye in frame.eyes)
    lost = (source == projection.NEAR) & (own == projection.VISIBLE)
    kept = (own == projection.NEAR) & (source == projection.VISIBLE)
    assert lost.any() and kept.any()
    assert (target[lost] == projection.NEAR).all() and not np.isin(np.flatnonzero(lost), frame.target.entries.splat).any()
    assert (target[kept] == projection.NEAR).all() and np.isin(frame.source.entries.splat, np.flatnonzero(kept)).any()
    assert not np.isin(np.flatnonzero(kept), frame.target.entries.splat).any()
    assert frame.counts["culled_near"] == int((source == projection.NEAR).sum())


def test_points_outside_the_sources_frame_are_binned_for_the_target():
    frame = random_joint(2)
    source = frame.source.projected.reason
    only = np.setdiff1d(frame.target.entries.splat, frame.source.entries.splat)
    assert (source[only] == projection.OUTSIDE).any()
    assert np.isin(only, frame.pairs.splat).all()
    alone_mask = (frame.pairs.mask != 0)
    assert (alone_mask[:, 1] & ~alone_mask[:, 0]).any() and (alone_mask[:, 0] & ~alone_mask[:, 1]).any()
    assert alone_mask.any(axis=1).all()


def test_chunks_are_read_where_either_eye_sees_them():
    """A wide row of small splats, of which each eye sees a part."""
    seen, camera = set(), turned_view(64, 48)
    for eye in ("left", "right"):
        rng = np.random.default_rng(4)
        place = np.stack([rng.uniform(-9, 9, 900), rng.uniform(-1, 1, 900), rng.uniform(4, 5, 900)], 1)
        model = replace(random_model(rng, 900, levels=1, sh=0), means=camera.position + place @ camera.rotation,
                        log_scales=np.full((900, 3), -4.0))
        frame = render_joint(model, stereo_pair(camera, ipd_metres=3.0, source_eye=eye), config=SMALL)
        chunks, count = frame.source.words.chunks, len(frame.source.words.geometry)
        mine, other = (read_chunks(frame.config, chunks, count, r) for r in frame.registers.eyes)
        seen |= {name for name, only in (("source", mine & ~other), ("target", other & ~mine)) if only.any()}
        assert frame.source.chunks_read == (mine | other).sum()
        for drawn in frame.eyes:
            assert np.array_equal(drawn.projected.reason[chunks["first"]] != projection.UNREAD, mine | other)
        assert_same_pixels(frame.source, alone(frame, joint.SOURCE))
        assert not unlike_tiles(frame).all()
    assert seen == {"source", "target"}


@pytest.mark.parametrize("seed", range(3))
def test_the_shift_changes_no_pixel(seed):
    wanted, columns = random_joint(seed, shift=0), {}
    for shift in range(-8, 9):
        got = random_joint(seed, shift=shift)
        for mine, other in zip(got.eyes, wanted.eyes, strict=True):
            assert_same_pixels(mine, other)
        assert {name: n for name, n in got.counts.items() if name != "pairs"} == {
            name: n for name, n in wanted.counts.items() if name != "pairs"}
        columns[shift] = got.grids[0].columns
        assert got.grids[0].columns == got.grids[1].columns == joint_columns(got.source.registers.tiles_x, shift)
    assert columns[0] == -(-wanted.source.registers.tiles_x // 8) and columns[8] == columns[-8] == columns[0] + 1


@pytest.mark.parametrize(("tiles", "eye", "wanted"), [
    (1.4, "left", -1), (1.4, "right", 1), (1.6, "left", -2), (0.4, "right", 0), (3.0, "right", 3), (30.0, "left", -8)])
def test_the_median_shift_is_the_disparity_of_the_points_in_tiles(tiles, eye, wanted):
    """Points along the camera's axis, half of them nearer than 5."""
    camera = view(300, 90)
    model, z = random_model(np.random.default_rng(3), 401, levels=1, sh=0), np.linspace(3, 7, 401)
    ahead = replace(model, means=camera.position + z[:, None] * camera.rotation[2])
    pair = stereo_pair(camera, ipd_metres=tiles * 16 * 5.0 / camera.fx, source_eye=eye)
    assert median_shift(quantise_model(SMALL, ahead), pair) == wanted
    behind = replace(model, means=camera.position - z[:, None] * camera.rotation[2])
    assert median_shift(quantise_model(SMALL, behind), pair) == 0


def test_a_wrong_shift_costs_pairs():
    best, pairs = random_joint(1).registers.shift, {}
    assert abs(best) >= 1
    for shift in (best, 0, -best):
        pairs[shift] = random_joint(1, shift=shift).counts["pairs"]
    assert pairs[best] < pairs[-best]


def test_places_and_visits_are_those_of_the_text(frame):
    b, lists, most = JointBatches(frame), lists_of(frame), frame.config.batch_places
    places, visits, entries, visited, batch = [], [], [], set(), 0
    for number in sorted(lists):
        part, free, pairs = [], most, lists[number]
        for n, pair in enumerate(pairs or [None]):
            if pair is not None:
                *_, splat, masks = pair
                mine = []
                for eye, (drawn, grid) in enumerate(zip(frame.eyes, frame.grids, strict=True)):
                    tiles = [int(grid.tile[number, place]) for place in range(16) if masks[eye] >> place & 1]
                    mine += [(splat, eye, level) for level in sorted({int(drawn.registers.header[t, 0]) for t in tiles})]
                places += [(*place, k + 1 == len(mine), batch) for k, place in enumerate(mine)]
                free -= len(mine)
                part.append(pair)
            final = n + 1 >= len(pairs)
            if not (final or free < 8):
                continue
            for eye, grid in enumerate(frame.grids):
                for place in range(16):
                    tile, here = int(grid.tile[number, place]), [p[2] for p in part if p[3][eye] >> place & 1]
                    if tile >= 0 and (here or final):
                        visits.append((batch, eye, tile, place, (eye, tile) not in visited, final))
                        entries.append(here)
                        visited.add((eye, tile))
            part, free, batch = [], most, batch + 1
    p, v = b.places, b.stream_visits()
    assert list(zip(frame.pairs.splat[p.pair].tolist(), p.eye.tolist(), p.level.tolist(), p.last.tolist(), p.batch.tolist(),
                    strict=True)) == places
    assert list(zip(*(part.tolist() for part in v[:6]), strict=True)) == visits
    got = [frame.eyes[eye].entries.splat[rows].tolist()
           for eye, rows in zip(v.eye, np.split(v.order, v.start[1:-1]), strict=True)]
    assert got == entries
    assert (np.bincount(p.batch) <= most).all() and p.slot.max() < most
    assert b.events["batches"] == batch and b.statistics["places"] == len(places) and b.statistics["visits"] == len(visits)


def test_visits_give_the_pixels_of_both_eyes(frame):
    b = JointBatches(frame)
    for eye, drawn in enumerate(frame.eyes):
        visits, entries = b.records_of(eye)
        pixels = render_visits(frame.config, visits, entries, drawn.registers.background)
        final = visits[visits["final"] == 1]
        tile = final["tile_y"].astype(int) * drawn.registers.tiles_x + final["tile_x"]
        assert sorted(tile.tolist()) == list(range(len(drawn.registers.header)))
        for name, got in pixels._asdict().items():
            assert np.array_equal(got, getattr(drawn.pixels, name)[tile]), name


def test_records_of_places_have_the_tiles_of_their_eye(frame):
    b = JointBatches(frame)
    p, rows = b.places, b.place_records
    masks = {(number, splat): tiles for number, pairs in lists_of(frame).items() for *_, splat, tiles in pairs}
    number = np.repeat(np.arange(len(frame.pairs.start) - 1), np.diff(frame.pairs.start))
    wanted = [masks[int(number[pair]), int(frame.pairs.splat[pair])][eye] for pair, eye in zip(p.pair, p.eye, strict=True)]
    assert rows["mask"].tolist() == wanted and min(wanted) > 0
    assert rows["level"].tolist() == p.level.tolist() and rows["last"].tolist() == p.last.tolist()
    assert "eye" not in rows.dtype.names or rows["eye"].tolist() == p.eye.tolist()


def test_a_stream_has_the_visits_of_both_eyes(frame):
    b = JointBatches(frame)
    visits, entries = b.stream_records()
    each = [b.records_of(eye) for eye in range(2)]
    assert len(visits) == sum(len(one[0]) for one in each) > 0 and len(entries) == sum(len(one[1]) for one in each)


@pytest.mark.parametrize("seed", [0, 2])
def test_streams_and_bounds_change_no_pixel(seed):
    wanted = random_joint(seed)
    four = random_joint(seed, SMALL.with_(streams=4))
    bounds = next_bounds(SMALL, wanted.pairs.start, wanted.pairs.depth_key, 20)
    bucketed = random_joint(seed, bounds=bounds)
    assert len(bounds.key) > 2 and len(bucketed.source.groups) == bounds.lists > len(wanted.source.groups)
    for got in (four, bucketed):
        for mine, other in zip(got.eyes, wanted.eyes, strict=True):
            assert_same_pixels(mine, other)
    visits = [JointBatches(four).stream_visits(q) for q in range(4)]
    assert [np.count_nonzero(v.final) for v in visits] == [2 * len(wanted.source.registers.header)] * 4
    assert all(len(v.order) < sum(len(eye.entries.splat) for eye in four.eyes) for v in visits)


def test_shared_colours():
    own, shared = random_joint(1), random_joint(1, shared_colour=True)
    assert_same_pixels(shared.source, own.source)
    assert np.array_equal(shared.pairs.mask, own.pairs.mask)
    rows = np.unique(np.intersect1d(own.source.entries.splat, own.target.entries.splat))
    assert np.array_equal(shared.target.splats.colour[rows], own.source.splats.colour[rows])
    assert not np.array_equal(shared.target.pixels.colour, own.target.pixels.colour)
    plain, same = random_joint(0), random_joint(0, shared_colour=True)
    assert_same_pixels(plain.target, same.target)  # without harmonics, colours have no direction


def test_counts(frame):
    source, target = (eye.projected.reason for eye in frame.eyes)
    counts = frame.counts
    outside = [s not in (1, 2, 4) and s != 0 and t != 0 for s, t in zip(source.tolist(), target.tolist(), strict=True)]
    assert counts["culled_outside"] == sum(outside)
    assert counts["points"] == int((source != projection.UNREAD).sum()) == int((target != projection.UNREAD).sum())
    assert counts["entries"] == sum(bin(m).count("1") for m in frame.pairs.mask.reshape(-1).tolist())
    assert counts["survivors"] == len(set(frame.pairs.splat.tolist()))
    assert counts["chunks_read"] + counts["chunks_skipped"] == len(frame.source.words.chunks)


def test_what_is_refused():
    camera = view(64, 48)
    pair, model = stereo_pair(camera), random_model(np.random.default_rng(0), 50, levels=1, sh=0)
    with pytest.raises(InputError, match="config 'tiny' has lists by tile"):
        render_joint(model, pair, config=TINY)
    with pytest.raises(ValueError, match=r"shift must be in -8\.\.8, not 9"):
        render_joint(model, pair, config=SMALL, shift=9)
    wide = stereo_pair(view(512, 512))
    few = SMALL.with_(list_heads=64)
    render(model, wide.source, config=few)
    with pytest.raises(InputError, match="have 80 super-tiles, and config 'tiny_v3' has 64 lists"):
        render_joint(model, wide, config=few, shift=-1)
    for width, height, lists in ((257, 128, 12), (256, 129, 10)):
        with pytest.raises(InputError, match=f"have {lists} super-tiles"):
            render_joint(model, stereo_pair(view(width, height)), config=SMALL.with_(list_heads=lists - 1), shift=0)
        render_joint(model, stereo_pair(view(width, height)), config=SMALL.with_(list_heads=lists), shift=0)
    with pytest.raises(InputError, match="frame size 600x48 is not accepted"):
        render_joint(model, stereo_pair(view(600, 48)), config=SMALL)
    with pytest.raises(InputError, match="gaze 99,0 of the right"):
        render_joint(model, pair, config=SMALL, gaze_target=(99, 0))
    with pytest.raises(InputError, match="4 levels are not accepted"):
        render_joint(model, pair, config=SMALL.with_(levels=2), foveation=map_for(camera, (0.5, 0.5), 4))
    with pytest.raises(ValueError, match="not -9"):
        grid_origins(-9)


def test_the_targets_gaze_follows_the_gazed_depth():
    model = smfr_levels(cached_embedded_model())
    camera = embedded_cameras(192, 108)[0]
    pair = stereo_pair(camera)
    foveation = map_for(camera, (0.5, 0.5), 4)
    frame = render_joint(model, pair, config=TINY_V3, foveation=foveation)
    depth = render(model, camera, config=TINY_V3, foveation=foveation).depth[54, 96]
    assert frame.gaze == ((96.0, 54.0), (96.0 - float(pair.disparity(depth)), 54.0)) and not frame.warnings
    assert np.array_equal(frame.registers.target.header[:, 0], frame.foveations[1].tile_level.reshape(-1))
    given = render_joint(model, pair, config=TINY_V3, foveation=foveation, gaze_target=(10.0, 20.0))
    assert given.gaze[1] == (10.0, 20.0)
    flat = render_joint(model, pair, config=TINY_V3.with_(depth=False), foveation=foveation)
    assert flat.gaze[1] == (96.0, 54.0)


def test_the_embedded_scene_against_the_oracle():
    model = cached_embedded_model()
    camera = embedded_cameras(192, 108)[0]
    pair = stereo_pair(camera)
    frame = render_joint(model, pair, config=TINY_V3)
    assert_same_pixels(frame.source, render(model, camera, config=TINY_V3))
    oracle = render_oracle(model, pair.target, foveation=no_foveation(Display(192, 108)), background=(0.0, 0.0, 0.0),
                           support_sigma=TINY_V3.support_sigma, weights="plane")
    assert psnr_vs(frame.target.image, oracle.image) > 58
    assert 1.0 <= len(frame.pairs.splat) / len(alone(frame, joint.SOURCE).pairs.splat) < 1.4


def test_registers_are_the_hosts():
    camera = view(64, 48)
    pair, words = stereo_pair(camera), quantise_model(SMALL, random_model(np.random.default_rng(0), 50, levels=1, sh=0))
    flat = no_foveation(Display(64, 48))
    registers = joint_registers(SMALL, words, pair, (flat, flat), (0, 0, 0), shift=2)
    same = replace(registers.target, position=registers.source.position)
    assert registers.eyes == (registers.source, registers.target) and registers.shift == 2
    for name, value in vars(same).items():
        assert np.array_equal(value, getattr(registers.source, name)), name
    assert render_joint_frame(SMALL, words, registers).grids[0].supertile[0] == 0


def test_frames_in_which_nothing_is_seen():
    """All splats behind both eyes; and one level, without depths."""
    camera = view(64, 48)
    model = random_model(np.random.default_rng(0), 50, levels=1, sh=0)
    behind = replace(model, means=model.means + 100 * (camera.position - model.means.mean(axis=0)))
    frame = render_joint(behind, stereo_pair(camera), config=SMALL.with_(depth=False, levels=1), background=(0.5, 0.0, 0.0))
    batches = JointBatches(frame)
    assert frame.counts["pairs"] == frame.counts["survivors"] == frame.counts["entries"] == 0
    assert batches.events["batches"] == len(frame.pairs.start) - 1 and batches.statistics["visits"] == 2 * 12
    for eye in frame.eyes:
        assert (eye.pixels.colour == eye.pixels.colour[0, 0, 0]).all() and eye.pixels.colour[0, 0, 0, 0] > 0
