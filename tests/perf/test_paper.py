"""PAPER is the reproduction of the source: its frames keep their pixels, beats and cycles, whatever else machines learn.

The model is the trained one that lies in the package, because the procedural one is not the same on every CPU: the last bits
of its scales, rotations and opacities depend on the vector instructions that numpy finds.
"""

from __future__ import annotations

import hashlib

import numpy as np
import pytest

from golden.msv2_ref import pipeline
from golden.scenes.request import parse_request, resolve
from perf.model import MemoryModel, simulate
from perf.trace import trace_of
from spec.config import PAPER

VIEWS = {
    "plain": "embedded_trained --size 96x64",
    "foveated": "embedded_trained --size 128x72 --gaze 90,30 --background 0.2,0.4,0.6"}

PIXELS = {"plain": "79be3d591f35c603", "foveated": "1682441654036896"}
"""The first digits of the SHA-256 of a frame's raw pixels."""

CYCLES = {
    "plain": (131, 53_257, 17_536, 1_139_200, 618_208), "foveated": (147, 49_561, 19_603, 1_056_192, 657_312)}
"""Cycles of the table, of the geometry phase and of the rendering phase, and the bytes read and written."""


@pytest.fixture(scope="module", params=VIEWS)
def view(request: pytest.FixtureRequest) -> tuple[str, pipeline.Frame]:
    resolved = resolve(parse_request(*VIEWS[request.param].split()))
    return request.param, pipeline.render(
        resolved.model, resolved.camera, config=PAPER, foveation=resolved.foveation, background=resolved.background)


def test_pixels_stay(view):
    name, frame = view
    digest = hashlib.sha256()
    for values in frame.pixels:
        digest.update(np.ascontiguousarray(values, "<i8").tobytes())
    assert digest.hexdigest()[:16] == PIXELS[name]


def test_cycles_stay(view):
    """On the memory of the RTL's bench, whose cycles the model has within 2 %."""
    name, frame = view
    found = simulate(trace_of(frame), PAPER, memory=MemoryModel("ideal"), display=False)
    phases = tuple(found.phases[phase] for phase in ("table", "geometry", "render"))
    assert (*phases, sum(found.reads.values()), sum(found.writes.values())) == CYCLES[name]
