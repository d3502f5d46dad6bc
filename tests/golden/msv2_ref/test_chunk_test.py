"""The chunk test never skips a chunk with a splat that has an intersection, and skips what it is there to skip."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from golden.host.quantise import GaussianWords, quantise_model
from golden.host.registers import FrameRegisters, frame_registers
from golden.msv2_ref import chunk_test, projection, tile_test
from golden.msv2_ref.chunk_test import judged_chunks, level_bounds, read_chunks, read_points
from golden.msv2_ref.events import expected_events
from golden.msv2_ref.pipeline import render_frame
from golden.scenes.camera import Camera
from golden.scenes.gaze import Display, FoveationMap, foveation_map, no_foveation
from golden.scenes.model import GaussianModel
from msv2.cases.makers import splats, view
from spec.chunks import CHUNK, SCALE_TOP_BITS, chunk_header, sigma_significands
from spec.config import V3_RECORDS, AcceleratorConfig
from spec.constants import TILE

SLOW = [HealthCheck.too_slow, HealthCheck.data_too_large]
QUICK = settings(max_examples=40, derandomize=True, deadline=None, database=None, suppress_health_check=SLOW)
LONG = settings(QUICK, max_examples=1500)

WIDE = V3_RECORDS.with_(records="wide")
MACHINES = {
    "compact": V3_RECORDS, "wide": WIDE, "no support": WIDE.with_(support_sigma=None),
    "narrow support": V3_RECORDS.with_(support_sigma=0.5)}


def turned(rng: np.random.Generator) -> np.ndarray:
    """(3, 3) a random rotation."""
    q, r = np.linalg.qr(rng.normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q * np.sign(np.linalg.det(q))


def cloud(rng: np.random.Generator, kind: str, n: int, levels: int) -> GaussianModel:
    """Gaussians of one kind; most lie around the origin within a few units, where the cameras are."""
    means = rng.normal(size=(n, 3)) * 3.0
    log_scales = rng.normal(-2.5, 1.0, (n, 3))
    if kind == "far":
        means = rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-3, 12, (n, 1))
    elif kind == "extreme":
        means = np.sign(rng.normal(size=(n, 3))) * 2.0 ** rng.uniform(-100, 110, (n, 3))
        log_scales = rng.uniform(-30, 90, (n, 3))
    elif kind == "giants":
        log_scales[rng.random(n) < 0.1] += rng.uniform(2, 14)
    elif kind == "dots":
        means, log_scales = means[:1] + rng.normal(size=(n, 3)) * 10.0 ** rng.uniform(-9, -2), np.full((n, 3), -15.0)
    elif kind == "one place":
        means, log_scales = np.repeat(means[:1], n, axis=0), log_scales - 3
    elif kind == "grid":
        means = np.round(means)
    elif kind == "offset":
        means = means + 10.0 ** rng.uniform(0, 9) * rng.normal(size=3)
    opacity = 2 ** rng.uniform(-9.5, 7, (n, levels))
    return GaussianModel(
        means=means, log_scales=log_scales, quats=rng.normal(size=(n, 4)), opacity=opacity,
        sh_dc=np.zeros((n, levels, 3)), sh_rest=np.zeros((n, 0, 3)),
        quality_bound=rng.integers(1, levels + 1, n).astype(np.uint8))


KINDS = ("plain", "far", "extreme", "giants", "dots", "one place", "grid", "offset")


def camera_for(rng: np.random.Generator, model: GaussianModel) -> Camera:
    """A camera of any field of view, with its principal point anywhere, inside the model, near it or far from it."""
    width, height = (round(2 ** rng.uniform(0, 10.9)) for _ in range(2))
    width = min(width, 1920)
    height = min(height, 1920 if rng.random() < 0.1 else 300)
    rotation = turned(rng)
    focal = max(width, height) * 2 ** rng.uniform(-4, 5 if rng.random() < 0.8 else 12)
    target = model.means[rng.integers(len(model))] if len(model) else np.zeros(3)
    place = target - rotation.T @ (np.array([rng.normal() * 0.4, rng.normal() * 0.3, 1.0]) * 10 ** rng.uniform(-1.5, 2))
    if rng.random() < 0.15:
        place = rng.normal(size=3) * 10 ** rng.uniform(-2, 9)
    off = 0.5 if rng.random() < 0.6 else rng.uniform(-1.5, 2.5)
    return Camera(
        rotation, -rotation @ place, focal, focal * 2 ** rng.uniform(-0.5, 0.5), width * off,
        height * rng.uniform(0.2, 0.8), width, height, near=float(10 ** rng.uniform(-4, 1) if rng.random() < 0.4 else 0.2))


def levels_for(rng: np.random.Generator, camera: Camera, levels: int) -> FoveationMap:
    """A gaze anywhere on the frame, its borders included."""
    display = Display(camera.width, camera.height, fov_deg=float(rng.uniform(40, 150)))
    gaze = [rng.choice([0.0, 1.0, 0.5, rng.random()]) * size for size in (camera.width, camera.height)]
    return foveation_map(display, tuple(gaze), levels) if levels > 1 else no_foveation(display)


def survivors(
    config: AcceleratorConfig, words: GaussianWords, registers: FrameRegisters, rendered: np.ndarray | None, obb: bool,
) -> np.ndarray:
    """Rows of the Gaussians with an intersection."""
    projected = projection.project(config, words, registers, rendered)
    rows = np.flatnonzero(projected.reason == projection.VISIBLE).astype(np.int32)
    opacity = tile_test.tested_opacity(config, words.geometry["log2_opacity"], words.decoded.opacity)
    found = tile_test.tile_intersections(config, projected, opacity, words.geometry["bound"], registers, rows, obb=obb,
                                         rendered=rendered)
    return np.unique(found.splat)


def loses_nothing(seed: int, kind: str, machine: str, count: int, levels: int) -> int:
    """Compares the survivors with and without the chunk test; returns the number of chunks that were skipped."""
    rng = np.random.default_rng(seed)
    config, model = MACHINES[machine], cloud(rng, kind, count, levels)
    words = quantise_model(config, model)
    camera = camera_for(rng, model)
    registers = frame_registers(config, camera, words, levels_for(rng, camera, levels), np.zeros(3))
    tiles = len(registers.header)
    rendered = [None, rng.random(tiles) < 0.1, np.arange(tiles) == rng.integers(tiles)][rng.integers(3)]
    obb = bool(rng.random() < 0.3)
    wanted = survivors(config, replace(words, chunks=None), registers, rendered, obb)
    assert np.array_equal(survivors(config, words, registers, rendered, obb), wanted)
    return int((~read_chunks(config, words.chunks, count, registers, rendered)).sum())


ANY_FRAME = (st.integers(0, 2**32 - 1), st.sampled_from(KINDS), st.sampled_from(list(MACHINES)), st.integers(1, 400),
             st.integers(1, 4))


@given(*ANY_FRAME)
@QUICK
def test_no_survivor_is_lost(seed, kind, machine, count, levels):
    loses_nothing(seed, kind, machine, count, levels)


@pytest.mark.long
@given(*ANY_FRAME)
@LONG
def test_no_survivor_is_lost_in_many_frames(seed, kind, machine, count, levels):
    loses_nothing(seed, kind, machine, count, levels)


@pytest.mark.parametrize("kind", KINDS)
def test_chunks_of_every_kind_are_skipped(kind):
    assert sum(loses_nothing(seed, kind, "compact", 300, 4) for seed in range(12)) > 0



@pytest.mark.parametrize("fault", ["pad", "sigma_significands", "near"])
def test_wrong_chunk_tests_lose_survivors(fault, monkeypatch):
    wrong = {
        "pad": ("pad", lambda config: -30),
        "sigma_significands": ("sigma_significands", lambda config: (1 << config.formats.chunk.sig_bits - 3,) * 16),
        "near": ("_cut", lambda x, to: to.round(x) * 1.2)}
    monkeypatch.setattr(chunk_test, *wrong[fault])
    with pytest.raises(AssertionError):
        for seed in range(60):
            loses_nothing(seed, KINDS[seed % len(KINDS)], "wide", 300, 4)


def flat_levels(rng: np.random.Generator, tiles_x: int, tiles_y: int) -> tuple[np.ndarray, np.ndarray]:
    return rng.integers(0, 4, tiles_x * tiles_y), rng.random(tiles_x * tiles_y) < 0.3


def test_octagons_hold_every_tile_of_their_bound():
    rng = np.random.default_rng(4)
    for tiles_x, tiles_y in ((1, 1), (7, 3), (40, 23)):
        level, rendered = flat_levels(rng, tiles_x, tiles_y)
        bounds = level_bounds(level, tiles_x, rendered)
        for bound in range(4):
            places = [(t % tiles_x, t // tiles_x) for t in range(len(level)) if level[t] <= bound and rendered[t]]
            assert bounds.present[bound] == bool(places)
            if places:
                sides = [(x, y, x + y, x - y) for x, y in places]
                assert bounds.least[bound].tolist() == [min(side) for side in zip(*sides, strict=True)]
                assert bounds.most[bound].tolist() == [max(side) for side in zip(*sides, strict=True)]


def words_at(*means, **options) -> GaussianWords:
    return quantise_model(WIDE, splats(*means, **options))


def judged(words: GaussianWords, camera: Camera, foveation: FoveationMap | None = None):
    registers = frame_registers(
        WIDE, camera, words, foveation or no_foveation(Display(camera.width, camera.height)), np.zeros(3))
    return judged_chunks(WIDE, words.chunks, len(words.geometry), registers)


def test_each_reason_is_found_alone():
    camera = view()
    behind, outside = judged(words_at((0, 0, -3)), camera), judged(words_at((90, 0, 3)), camera)
    faint, seen = judged(words_at((0, 0, 3), opacity=1e-4), camera), judged(words_at((0, 0, 3)), camera)
    for found, name in ((behind, "behind"), (outside, "outside"), (faint, "faint")):
        assert {n for n in ("behind", "faint", "outside", "filtered", "empty", "astray") if getattr(found, n).all()} == {name}
        assert not found.read.any()
    assert seen.read.all()


def test_a_chunk_of_level_one_is_filtered_where_only_other_levels_are():
    camera = view(320, 48)
    gaze = foveation_map(Display(320, 48), (10.0, 24.0), 4)
    words = words_at((12, 0, 5), scale=0.01, levels=4)
    assert judged(words, camera, gaze).read.all()
    low = replace(words, chunks=words.chunks.copy())
    low.chunks["bound"] = 0
    found = judged(low, camera, gaze)
    assert found.filtered.all() and not found.outside.any()


def test_an_empty_chunk_is_skipped_and_an_empty_model_has_none():
    words = words_at((0, 0, 3))
    empty = words.chunks.copy()
    empty["count"] = 0
    assert judged(replace(words, chunks=empty), view()).empty.all()
    none = judged(quantise_model(WIDE, splats(opacity=0.0)), view())
    assert none.read.shape == (0,)


@pytest.mark.parametrize(("first", "count", "astray"), [
    (0, CHUNK, False), (1, CHUNK - 1, False), (1, CHUNK, True), (0, CHUNK + 1, True), (CHUNK, 1, True), (2**24 - 1, 127, True)])
def test_a_chunk_that_reaches_beyond_the_model_is_skipped(first, count, astray):
    words = quantise_model(WIDE, splats(*((0, 0, 3),) * CHUNK))
    lying = words.chunks[:1].copy()
    lying["first"], lying["count"] = first, count
    found = judged(replace(words, chunks=lying), view())
    assert found.astray.tolist() == [astray] and found.read.tolist() == [not astray]


def test_points_of_skipped_chunks_count_nowhere():
    words = quantise_model(WIDE, splats(*((0, 0, 3),) * CHUNK, *((0, 0, -50),) * CHUNK))
    camera = view()
    registers = frame_registers(WIDE, camera, words, no_foveation(Display(camera.width, camera.height)), np.zeros(3))
    frame = render_frame(WIDE, words, registers)
    assert frame.read.sum() == CHUNK and frame.chunks_skipped == len(words.chunks) - 1 and frame.chunks_read == 1
    assert (frame.projected.reason == projection.NEAR).sum() == 0
    assert expected_events(frame) | {"points": CHUNK, "culled_near": 0, "chunks_read": 1} == expected_events(frame)


def test_points_are_those_of_the_chunks_that_are_read():
    chunks = np.zeros(4, chunk_header(WIDE).dtype)
    chunks["first"], chunks["count"] = [0, 3, 3, 9], [3, 0, 6, 1]
    read = np.array([False, True, True, False])
    assert read_points(chunks, read, 10).tolist() == [3 <= i < 9 for i in range(10)]


def test_the_largest_scale_top_covers_every_scale():
    n, significands = WIDE.formats, sigma_significands(WIDE)
    top = (1 << SCALE_TOP_BITS) - 1
    largest = np.ldexp(significands[top % 16] / 2.0 ** (n.chunk.sig_bits - 1), top // 16 - n.scale.bias)
    assert largest >= n.scale.max and n.chunk.round(largest) == largest
    steps = np.array(significands) / 2.0 ** (n.chunk.sig_bits - 1)
    assert (steps >= 2.0 ** (np.arange(16) / 16)).all()


@pytest.mark.parametrize(("pixels", "reaches"), [(16000, 1), (40000, 0)])
def test_the_chunk_of_a_giant_beside_the_frame_is_read(pixels, reaches):
    """Its mean lies so far to the right, and it is so wide that it reaches the frame from the end of the guard band. Beyond it,
    the splat is culled; the test does not know of the guard band, and need not."""
    camera = view(64, 48, fx=1000.0)
    words = words_at((pixels / 1000, 0, 1.0), scale=(6.0, 6.0, 6.0))
    registers = frame_registers(WIDE, camera, words, no_foveation(Display(64, 48)), np.zeros(3))
    assert len(survivors(WIDE, replace(words, chunks=None), registers, None, False)) == reaches
    found = judged(words, camera)
    assert found.read.all() and (found.first[0, 0], found.last[0, 0]) == (0, 64 // TILE - 1)
