"""msv2/cases/inversions.py: what is counted as an inversion, what it costs, and the command."""

import json
from dataclasses import replace

import numpy as np
import pytest

from golden.msv2_ref import pipeline, projection
from golden.oracle.project import project
from msv2.cases.inversions import analyse, float64_z, machine_z, main, neighbours, reordered
from spec.config import PAPER, TINY
from spec.constants import SUPPORT_SIGMA
from spec.errors import InputError
from spec.formats import UQ
from tests.helpers.golden_samples import map_for, random_model, splats, view


@pytest.fixture(scope="module")
def scene():
    model, camera = random_model(np.random.default_rng(3), 400, levels=4), view(90, 70)
    return model, camera, pipeline.render(model, camera, config=PAPER, foveation=map_for(camera, (0.2, 0.3), 4))


def test_the_machines_z_is_what_the_keys_are_made_of(scene):
    _, _, frame = scene
    n, visible = PAPER.formats.view, frame.projected.reason == projection.VISIBLE
    bits = n.quantise(machine_z(frame)[visible]).astype(np.int64) - int(n.quantise(frame.registers.near))
    assert (np.minimum(bits, PAPER.formats.depth_key.raw_max) == frame.projected.depth_key[visible]).all()


def test_float64_z_is_the_oracles(scene):
    model, camera, _ = scene
    projected, _ = project(model, camera, SUPPORT_SIGMA)
    assert len(projected) > 100 and (float64_z(model, camera)[projected.index] == projected.depth).all()


def test_neighbours_share_a_tile():
    assert neighbours(np.array([0, 0, 3, 3, 4, 6, 6])).tolist() == [0, 1, 4]
    assert neighbours(np.array([0, 0])).tolist() == [] and neighbours(np.array([0])).tolist() == []


def test_the_machines_order_is_that_of_its_z(scene):
    model, camera, frame = scene
    numbers = analyse(frame, float64_z(model, camera))
    counts = np.diff(frame.entries.start)
    assert numbers["machine_inversions"] == numbers["saturated_inversions"] == 0 < numbers["entries"]
    assert numbers["neighbours"] == numbers["entries"] - (counts > 0).sum() and numbers["pixels"] == 90 * 70


def test_a_swapped_pair_is_found_and_costs_what_it_costs():
    model = splats((0, 0, 2), (0, 0, 3), (0, 0, 4), colour=[(1, 0, 0), (0, 1, 0), (0, 0, 1)], opacity=0.7, scale=0.2)
    camera = view(16, 16)
    frame = pipeline.render(model, camera, config=TINY)
    right = analyse(frame, float64_z(model, camera))
    assert (right["float64_inversions"], right["max_abs_error"], right["changed_pixels"]) == (0, 0.0, 0)

    entries = frame.entries._replace(splat=np.array([1, 0, 2], np.int32))
    z = float64_z(model, camera)
    swapped = replace(reordered(frame, np.array([2.0, 1.0, 3.0])), entries=entries)
    numbers = analyse(swapped, z)
    assert numbers["machine_inversions"] == numbers["float64_inversions"] == 1
    assert numbers["largest_gap"] == pytest.approx(1 / 3) and numbers["changed_pixels"] > 20
    assert numbers["max_abs_error"] == np.abs(swapped.image - frame.image).max() > 0.3
    x, y = numbers["worst_pixel"]
    assert np.abs(swapped.image - frame.image)[y, x].max() == numbers["max_abs_error"]


def test_saturated_keys_are_told_apart():
    formats = replace(TINY.formats, depth_key=UQ(4, 0))
    model = splats((0, 0, 4), (0, 0, 3), (0, 0, 2), opacity=0.7, scale=0.2)
    frame = pipeline.render(model, view(16, 16), config=TINY.with_(formats=formats))
    numbers = analyse(frame, float64_z(model, view(16, 16)))
    assert numbers["machine_inversions"] == 0 and numbers["saturated_inversions"] == numbers["float64_inversions"] == 2
    assert numbers["equal_keys"] == 2


def test_the_command_writes_its_numbers(tmp_path, capsys):
    assert main(["embedded", "--size", "64x48", "--gaze", "10,10", "--levels", "4", "--out", str(tmp_path)]) == 0
    numbers = json.loads((tmp_path / "order.json").read_text())
    assert numbers["machine_inversions"] == 0 and numbers["entries"] > 1000 and numbers["config"] == "paper"
    assert numbers["max_abs_error"] < 0.05 and "0 inversions by the machine's z" in capsys.readouterr().out
    with pytest.raises(InputError, match="'huge'"):
        main(["embedded", "--config", "huge"])
