"""Machines put together by hand: what `spec.relations` lets pass can be built, and the golden renderer renders it."""

from __future__ import annotations

import numpy as np
import pytest

from golden.msv2_ref import pipeline
from rtl.emit import to_rtlil
from rtl.units import UNITS
from spec.overrides import resolve_config
from tests.helpers.golden_samples import map_for, random_model, view

BUILT = ("near_test", "colour_unit", "setup", "pixel_core", "splat_fetch")
"""Units whose arithmetic and records depend on most formats."""


@pytest.mark.parametrize("sets", [
    ["formats.transmittance=UQ0.13", "formats.exp2_segments=2", "formats.sh_basis=SQ0.10", "formats.mean2d=SQ13.8"],
    ["formats.conic=float14e5b31", "formats.factor=SQ1.13", "formats.exponent=SQ11.13", "formats.slope=SQ7.13",
     "formats.curvature=SQ3.13", "formats.cut=SQ3.8", "formats.log2_opacity=SQ4.8"],
    ["formats.colour=UQ2.8", "formats.accumulator=UQ2.14", "formats.alpha=UQ1.16", "formats.transmittance=UQ0.14",
     "formats.position=float16e6b31", "formats.scale=ufloat10e5b20"],
], ids=["short", "conic", "ranges"])
def test_what_the_relations_accept_can_be_built_and_rendered(sets):
    config = resolve_config("tiny", sets)
    for name in BUILT:
        assert to_rtlil(UNITS[name].make(config), name).count("module ") >= 1
    model, camera = random_model(np.random.default_rng(3), 200, 4, 3), view(48, 32)
    usual = pipeline.render(model, camera, config=resolve_config("tiny"), foveation=map_for(camera, (0.4, 0.4), 4))
    frame = pipeline.render(model, camera, config=config, foveation=map_for(camera, (0.4, 0.4), 4))
    assert np.abs(frame.image - usual.image).mean() < 0.02 < usual.image.mean()
