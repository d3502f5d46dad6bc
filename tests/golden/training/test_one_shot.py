"""One-shot pruning as LightGaussian does it: what goes, who teaches, what is left, and resume."""

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from golden.diff.gaussians import from_model  # noqa: E402
from golden.diff.render import render  # noqa: E402
from golden.scenes.embedded.scene import cached_embedded_model  # noqa: E402
from golden.scenes.pictures import to_bytes  # noqa: E402
from golden.training.efficiency import Scores  # noqa: E402
from golden.training.evaluate import evaluate  # noqa: E402
from golden.training.one_shot import OneShotOptions, OneShotStage, taught  # noqa: E402
from tests.helpers.training_samples import same, small_scene  # noqa: E402

QUICK = OneShotOptions(iterations=12, poses=3)


@pytest.fixture(scope="module")
def scene():
    return small_scene()


@pytest.fixture(scope="module")
def dense():
    model = from_model(cached_embedded_model(600, sh_degree=1))
    return replace(model, sh_rest=torch.nn.functional.pad(model.sh_rest, (0, 0, 0, 12)))


def run(stage, steps):
    for _ in range(steps):
        stage.step()
    return stage


def test_two_thirds_go_at_once_and_the_harmonics_half_way(scene, dense):
    stage = OneShotStage(scene, dense, QUICK)
    seen = []
    for _ in range(12):
        record = stage.step()
        seen.append((record["points"], stage.gaussians.sh_rest.shape[1]))
    left = 600 - round(0.66 * 600)
    assert seen == [(left, 15)] * 6 + [(left, 8)] * 6 and stage.finished
    assert stage.result().sh_rest.shape == (left, 8, 3)
    scores = Scores("importance", [scene.cameras[view] for view in scene.train]).measure(dense)
    kept = dense.means[torch.argsort(scores, descending=True, stable=True)[:left]]
    first = run(OneShotStage(scene, dense, QUICK), 1).gaussians.means.detach()
    assert torch.cdist(kept.double(), first.double()).min(dim=1).values.max() < 0.01  # one step of Adam away


def test_the_dense_model_teaches_the_views_and_the_poses_between(scene, dense):
    masked = replace(scene, masks=np.zeros((len(scene), 64, 64), bool))
    lesson = taught(masked, dense, 5)
    assert lesson.train[: len(scene.train)] == scene.train and len(lesson.train) > len(scene.train)
    for view in (lesson.train[0], lesson.train[-1]):
        assert np.array_equal(lesson.images[view], to_bytes(render(dense, lesson.cameras[view]).image.numpy()))
        assert lesson.masks[view].all()
    assert not np.array_equal(lesson.images[scene.train[0]], scene.images[scene.train[0]])
    for view in (*scene.test, *scene.validation):
        assert np.array_equal(lesson.images[view], scene.images[view])


def test_training_recovers(scene, dense):
    """Right after the prune the model is far from the photographs, and training brings it back some of the way."""
    stage = OneShotStage(scene, dense, replace(QUICK, iterations=80))
    before = evaluate(run(stage, 1).result(), scene, scene.validation).psnr
    assert evaluate(run(stage, 79).result(), scene, scene.validation).psnr > before + 0.5


@pytest.mark.parametrize("at", [0, 3, 6, 9])
def test_resumed_equals_uninterrupted(scene, dense, at):
    whole, first, second = (OneShotStage(scene, dense, QUICK, seed=2) for _ in range(3))
    run(whole, 12)
    second.load(run(first, at).state())
    assert second.done == at and same(run(second, 12 - at).result(), whole.result())


@pytest.mark.parametrize(("changes", "message"), [
    ({"iterations": 0}, "iterations.*0"), ({"removed": 1.0}, "removed.*1.0"), ({"recovery": 0.0}, "recovery.*0.0"),
    ({"sh_degree": 4}, "sh_degree.*4")])
def test_options_refuse(changes, message):
    with pytest.raises(ValueError, match=message):
        OneShotOptions(**changes)
