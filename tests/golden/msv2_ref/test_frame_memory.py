"""Frames in memory: views of splats against the array's entries, pixels against the picture."""

from __future__ import annotations

import argparse

import numpy as np
import pytest

from golden.msv2_ref.frame_memory import display_pixels, displayed, frame_pixels, splat_records
from golden.msv2_ref.pipeline import render
from golden.scenes.pictures import to_bytes
from golden.scenes.request import resolve
from spec.config import TINY
from spec.constants import MAX_LEVELS
from spec.memory import frame_pixel


@pytest.fixture(scope="module")
def frame():
    request = resolve(argparse.Namespace(
        scene="embedded", size="53x37", camera="orbit", gaze="20,20", levels=3, background="0.2,0.5,0.9", seed=0,
        levels_from="random"))
    return render(request.model, request.camera, config=TINY, foveation=request.foveation, background=request.background)


def test_views_are_what_the_entries_say(frame):
    entries, e = frame.array_entries, frame.entries
    level, blend = (np.repeat(frame.registers.header[:, field], np.diff(e.start)) for field in (0, 1))
    assert len(np.unique(level)) > 1 and blend.any()
    views = splat_records(frame, MAX_LEVELS)[e.splat, level]
    for name in ("mean2d", "conic", "log2_opacity", "colour", "depth"):
        assert np.array_equal(entries[name], views[name])
    use = np.stack([views["bound"] >= level, (blend == 1) & (views["bound"] > level)], 1)
    assert np.array_equal(entries["use"], use)


def test_the_last_level_has_itself_as_the_next(frame):
    views = splat_records(frame, MAX_LEVELS)
    last = views[:, -1]
    assert np.array_equal(last["log2_opacity"][:, 0], last["log2_opacity"][:, 1])
    assert np.array_equal(last["colour"][:, :3], last["colour"][:, 3:])
    assert np.array_equal(views[:, 0]["colour"][:, 3:], views[:, 1]["colour"][:, :3])


def test_pixels_are_those_of_the_picture(frame):
    pixels, n = frame_pixels(frame), TINY.formats
    assert pixels.shape == (37, 53) and not pixels["reserved"].any()
    assert np.array_equal(n.accumulator.to_float(pixels["colour"]), frame.image)
    assert np.array_equal(n.transmittance.to_float(pixels["transmittance"]), frame.transmittance)
    assert np.array_equal(pixels["depth"][16:32, 32:48], frame.pixels.depth[4 + 2])  # four tiles in a row


def test_display_pixels_are_those_of_the_png(frame):
    pixels = display_pixels(frame)
    assert pixels.shape == (37, 53) and np.array_equal(pixels["colour"], to_bytes(frame.image))
    assert np.array_equal(pixels["coverage"], 255 - to_bytes(frame.transmittance))


def test_display_colours_saturate_and_the_coverage_has_both_ends():
    n, pixels = TINY.formats, np.zeros((6,), frame_pixel(TINY).dtype)
    one, most = 1 << n.accumulator.frac_bits, n.transmittance.raw_max
    pixels["colour"][:, 1] = (0, 32, 33, one - 33, one, n.accumulator.raw_max)  # 255 * 32 is just less than half
    pixels["transmittance"] = (0, 64, 65, most - 64, most - 63, most)
    got = displayed(TINY, pixels)
    assert got["colour"][:, 1].tolist() == [0, 0, 1, 254, 255, 255] and not got["colour"][:, [0, 2]].any()
    assert got["coverage"].tolist() == [255, 255, 254, 1, 0, 0]
