"""Which splat contributes most to a pixel, against the array's own pixels."""

from dataclasses import replace

import numpy as np
import pytest

from golden.msv2_ref import pipeline
from golden.scenes.gaze import Display, foveation_map
from golden.scenes.levels import smfr_levels
from golden.scenes.orbit import orbit_camera
from msv2.viewer import splat
from spec.config import PAPER, V3_RECORDS
from tests.helpers.golden_samples import ball


@pytest.fixture(scope="module", params=[False, True], ids=["plain", "foveated"])
def frame(request) -> pipeline.Frame:
    model = smfr_levels(ball(), 4)
    camera = orbit_camera(model, 0, 8, 96, 64)
    foveation = foveation_map(Display(96, 64), (20.0, 30.0)) if request.param else None
    return pipeline.render(model, camera, config=PAPER, foveation=foveation, background=(0.0, 0.0, 0.0))


def test_shares_times_colours_make_the_pixel(frame):
    """At every pixel of a grid, in tiles that blend and in others."""
    level = frame.registers.header[:, 0].reshape(frame.registers.tiles_y, frame.registers.tiles_x)
    image, left = frame.image, frame.transmittance
    colours = PAPER.formats.colour.to_float(frame.splats.colour)
    for y in range(3, 64, 10):
        for x in range(1, 96, 7):
            rows, share = splat.weights(frame, x, y)
            assert share.sum() + left[y, x] == pytest.approx(1, abs=0.01)
            blend = frame.registers.header[y // 16 * frame.registers.tiles_x + x // 16, 1]
            if not blend:
                made = share @ colours[rows, level[y // 16, x // 16]]
                assert np.abs(made - image[y, x]).max() < 0.01


def test_it_is_the_splat_that_lights_the_pixel_most(frame):
    """Of the pixel's five strongest splats, it is the one that gives most where all others are black, by the array itself."""
    found = splat.find(frame, 48, 32)
    rows, share = splat.weights(frame, 48, 32)
    assert found is not None and rows[found.place] == found.index and found.count == len(rows)
    assert found.contributors == (share > 0).sum()
    light = {}
    for place in np.argsort(share)[-5:]:
        colour = frame.words.colour.copy()
        colour["dc"] = 0
        colour["dc"][rows[place]] = PAPER.formats.sh_dc.quantise(1.0)  # all others are black
        lit = pipeline.render_frame(PAPER, replace(frame.words, colour=colour), frame.registers)
        light[int(rows[place])] = float(lit.image[32, 48, 0])
    assert max(light, key=light.get) == found.index
    assert light[found.index] == pytest.approx(found.weight, abs=0.01)


def test_the_record_is_what_the_array_reads(frame):
    found = splat.find(frame, 48, 32)
    tile = 2 * frame.registers.tiles_x + 3
    entry = frame.array_entries[frame.entries.start[tile] + found.place]
    assert set(found.record) == set(entry.dtype.names)
    for name, value in found.record.items():
        assert (np.asarray(value) == entry[name]).all(), name


def test_its_tiles_are_those_with_it_on_their_lists(frame):
    found = splat.find(frame, 48, 32)
    tiles_x = frame.registers.tiles_x
    for tile in range(len(frame.registers.header)):
        there = found.index in frame.entries.splat[frame.entries.start[tile] : frame.entries.start[tile + 1]]
        assert there == ([tile % tiles_x, tile // tiles_x] in found.tiles.tolist())
    assert [3, 2] in found.tiles.tolist()


def test_what_is_shown_can_be_read(frame):
    found = splat.find(frame, 48, 32)
    text = found.markdown()
    assert f"**Splat {found.index:,}** has {found.weight:.1%} of pixel 48, 32" in text
    assert f"**{len(found.tiles):,} tiles**" in text and "| mean2d |" in text and "| position |" in text
    position = ball().means[found.index]
    assert np.allclose(found.position, position, atol=1e-3)


def test_the_index_is_the_models_own_whatever_the_order_in_memory():
    model = ball()
    camera = orbit_camera(model, 0, 8, 96, 64)
    for config in (PAPER, V3_RECORDS):
        frame = pipeline.render(model, camera, config=config)
        found = splat.find(frame, 48, 32)
        assert np.allclose(found.position, model.means[found.index], atol=1e-3)
        rows, _ = splat.weights(frame, 48, 32)
        assert (found.index == rows[found.place]) == (config is PAPER)
        assert found.tiles.tolist().count([3, 2]) == 1


def test_where_nothing_is_nothing_is_found(frame):
    x, y = np.argwhere(frame.transmittance.T == frame.transmittance.max())[0]
    if frame.transmittance.max() > 0.9999:
        assert splat.find(frame, int(x), int(y)) is None


def test_places_beyond_the_edges_are_moved_to_them(frame):
    at_edge, beyond = splat.find(frame, 95, 63), splat.find(frame, 1000, 1000)
    assert (at_edge and at_edge.markdown()) == (beyond and beyond.markdown())
