"""Every stage of training leaves alone what masks hide: splats that only hidden pixels show do not move."""

from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from golden.diff.gaussians import from_model  # noqa: E402
from golden.scenes.embedded.scene import cached_embedded_model  # noqa: E402
from golden.training.baselines import SeparateOptions, SeparateStage  # noqa: E402
from golden.training.dense import DenseOptions, DenseStage  # noqa: E402
from golden.training.finetune import FineTuneStage  # noqa: E402
from golden.training.foveated import FoveatedModel  # noqa: E402
from golden.training.levels import LevelOptions, LevelStage  # noqa: E402
from golden.training.retrain import Retraining  # noqa: E402
from golden.training.scene import load_training_scene  # noqa: E402

SIZE = 48


@pytest.fixture(scope="module")
def scene():
    return load_training_scene("embedded", (SIZE, SIZE))


def stages(scene):
    """Each stage by name, ready for its first iteration."""
    model = from_model(cached_embedded_model(500, sh_degree=1))
    return {
        "dense": DenseStage(scene, DenseOptions(iterations=20, max_points=500, coarse_until=0.5), 0),
        "prune": Retraining(scene, model, 0, "prune"),  # what pruning does between two prunes
        "finetune": FineTuneStage(scene, model, iterations=20),
        "level2": LevelStage(scene, FoveatedModel(model), 1, LevelOptions(iterations=20)),
        "separate2": SeparateStage(scene, model, 1, len(model), SeparateOptions(iterations=20)),
    }


def moved(stage) -> float:
    """The share of the splats whose colour changes in one iteration."""
    if isinstance(stage, LevelStage):
        stage.step()  # its first step also prunes, and the next one must not
        stage._next_gate = stage.total
    before = stage.gaussians.sh_dc.detach().clone()
    stage.step(0, 0.0) if isinstance(stage, Retraining) else stage.step()
    return float((before != stage.gaussians.sh_dc.detach()).any(dim=1).float().mean())


@pytest.mark.parametrize("name", ["dense", "prune", "finetune", "level2", "separate2"])
def test_hidden_pixels_move_no_splat(scene, name):
    masks = np.zeros((len(scene), SIZE, SIZE), bool)
    masks[:, :8, :8] = True
    whole, hidden = moved(stages(scene)[name]), moved(stages(replace(scene, masks=masks))[name])
    assert 0 < hidden < 0.3 * whole
