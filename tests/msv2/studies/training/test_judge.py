"""The independent judge of trained models: where it looks from, which pictures it gets, and what its page says."""

import math
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from golden.diff.gaussians import from_model  # noqa: E402
from golden.diff.render import render  # noqa: E402
from golden.scenes.embedded.scene import cached_embedded_model  # noqa: E402
from golden.scenes.gaze import Display  # noqa: E402
from golden.training.foveated import FoveatedModel  # noqa: E402
from golden.training.scene import load_training_scene  # noqa: E402
from msv2.studies.training import judge, judge_study  # noqa: E402
from spec.constants import ALPHA_MAX_L1, REGION_START_DEG  # noqa: E402
from spec.errors import InputError  # noqa: E402


def test_the_frames_centre_is_seen_at_the_eccentricity_asked_for():
    """By the display's own angles: the frame lies in the middle of the paper's display, and the gaze on the same row."""
    camera = load_training_scene("embedded", (64, 48), views=24).cameras[0]
    for start in REGION_START_DEG:
        x, y = judge.gaze_beside(camera, start)
        display = Display(1237, 48)
        at = 1237 / 2 + (x - camera.width / 2)
        assert y == 24 and display.eccentricity((at, 24))[24, 618] == pytest.approx(start, abs=0.1)
    assert judge.part_of_display(1237) == pytest.approx(90) and judge.part_of_display(64) < 90 * 64 / 1237 * 1.3


def test_each_picture_is_judged_against_its_photograph(monkeypatch):
    """A stand-in for the metric notes what it gets: sizes, angles and gazes, and scores by the mean difference."""
    asked = []

    class Metric:
        def __init__(self, size, fov_deg=90.0):
            self.size, self.fov = size, fov_deg

        def __call__(self, image, reference, gaze):
            asked.append((self.size, self.fov, gaze))
            assert 0 <= image.min() and image.max() <= 1
            return 10 - float((image - reference).abs().mean())

    monkeypatch.setattr(judge, "FovVideoVdp", Metric)
    scene = load_training_scene("embedded", (64, 48), views=24)
    scene = replace(scene, test=scene.test[:2])
    base = from_model(cached_embedded_model(900))
    model = FoveatedModel.nested(base, np.random.default_rng(0).integers(1, 5, len(base)))
    found = judge.measure(base, model, scene)
    assert found["views"] == 2 and len(asked) == 2 * (4 + 8)
    assert found["frames"]["dense"] == found["frames"]["l1"] == found["levels"][0]["jod"] == found["levels"][0]["l1_jod"]
    expected = np.mean([10 - float((render(base, scene.cameras[view], alpha_max=ALPHA_MAX_L1).image.clamp(0, 1)
                                    - scene.photograph(view)).abs().mean()) for view in scene.test])
    assert found["frames"]["dense"] == pytest.approx(expected)
    assert found["frames"]["foveated"] < found["frames"]["l1"] and found["levels"][3]["jod"] < found["levels"][3]["l1_jod"]
    assert {fov for _, fov, _ in asked} == {90.0, judge.part_of_display(64)}
    assert {gaze for _, _, gaze in asked[:4]} == {(32.0, 24.0)} and asked[-1][2][0] < 32 - 300 * math.tan(math.radians(33))
    row = {"scene": "x", "size": "64x48", "variant": "H", "baseline": None, "seed": 0} | found
    text = judge_study.page([row])
    assert f"{found['frames']['smfr']:.2f}" in text and f"{found['levels'][3]['jod']:.2f} (" in text


def test_a_run_without_a_checkpoint_is_refused(tmp_path):
    (tmp_path / "report.json").write_text('{"options": {}}')
    with pytest.raises(InputError, match="last checkpoint"):
        judge.row_of(tmp_path)
