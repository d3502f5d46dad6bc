"""Pruning: what goes first, gates, resume, fine-tuning and baselines, on the embedded scene at 64x64."""

import math
from dataclasses import asdict, replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from golden.diff.gaussians import Gaussians  # noqa: E402
from golden.diff.render import render  # noqa: E402
from golden.metrics.hvsq import Hvsq  # noqa: E402
from golden.metrics.ssim import Ssim  # noqa: E402
from golden.training import pruning  # noqa: E402
from golden.training.efficiency import Scores  # noqa: E402
from golden.training.evaluate import Gate, evaluate  # noqa: E402
from golden.training.finetune import FineTuneStage  # noqa: E402
from golden.training.losses import photometric  # noqa: E402
from golden.training.prune_baselines import baseline_stage  # noqa: E402
from golden.training.pruning import PruneOptions, PruneStage  # noqa: E402
from golden.training.retrain import Retraining  # noqa: E402
from tests.helpers.training_samples import guarded, same, small_dense, small_scene  # noqa: E402

QUICK = PruneOptions(iterations=12, interval=3, recovery=3, fraction=0.1)


@pytest.fixture(scope="module")
def scene():
    return guarded(small_scene())


@pytest.fixture(scope="module")
def dense() -> Gaussians:
    return small_dense()


def losses(scene, model):
    """(2,) means of the photometric loss and of WS over the training views, from renders made here."""
    rows = []
    for view in scene.train:
        rendering, photograph = render(model, scene.cameras[view]), scene.photograph(view)
        tiles = (rendering.tiles - 4).clamp(min=0)
        decay = (model.log_scales[rendering.index].amax(dim=1).exp() * tiles).sum() / len(model)
        rows.append([float(photometric(rendering.image, Ssim(photograph), photograph)), float(decay)])
    return np.mean(rows, axis=0)


def run(stage, steps=None):
    """The stage after all, or some, of its steps."""
    for _ in range(stage.total - stage.done if steps is None else steps):
        stage.step()
    return stage


def test_a_prune_removes_a_tenth_and_what_is_transparent(scene, dense):
    """5 parts of 2 % after the points below 0.005 went; at the first check, as the dense model passes its own gate."""
    model = dense.detached()
    model.opacity[:100] = -9.0
    stage = run(PruneStage(scene, model, "L", QUICK), 1)
    left = len(dense) - 100
    assert len(stage.gaussians) == left - 5 * round(0.02 * left)
    assert stage.history[0].passed and stage.history[0].points == len(dense)


def test_the_first_gamma_is_a_share_of_the_loss(scene, dense):
    """gamma WS of the dense model is 10 to 20 % of its loss on training views, in whatever units the scene is."""
    few = replace(scene, train=scene.train[:8])
    loss, decay = losses(few, dense)
    stage = run(PruneStage(few, dense, "L", QUICK), 1)
    assert stage.gamma * decay / (2 * loss) == pytest.approx(0.15, rel=1e-4)  # the squared error weighs as much again
    larger = replace(dense.detached(), means=10 * dense.means, log_scales=dense.log_scales + math.log(10))
    cameras = tuple(replace(camera, translation=10 * camera.translation, near=10 * camera.near) for camera in few.cameras)
    other = run(PruneStage(replace(few, cameras=cameras), larger, "L", QUICK), 1)
    assert other.gamma == pytest.approx(stage.gamma / 10, rel=1e-3)


def test_points_are_scored_from_training_views_alone(scene, dense, monkeypatch):
    """Levels are, too (their test reads no validation photograph at all when scoring)."""
    read = []
    monkeypatch.setattr(pruning, "Scores", lambda criterion, cameras, **more: read.extend(cameras) or Scores(
        criterion, cameras, **more))
    PruneStage(scene, dense, "L", QUICK)
    train = [scene.cameras[view] for view in scene.train]
    assert len(read) == len(train) and all(np.array_equal(a.rotation, b.rotation) for a, b in zip(read, train, strict=True))


def test_a_gate_of_both_reads_ssim(scene, dense):
    stage = PruneStage(scene, dense, "L", replace(QUICK, gate="both"))
    records = [stage.step() for _ in range(3)]
    assert 0 < records[-1]["ssim"] < 1 and stage.gate == Gate.of(evaluate(dense, scene, scene.validation), 0.03, "both")
    assert "ssim" not in [run(PruneStage(scene, dense, "L", QUICK), 2).step()][0]


@pytest.mark.parametrize("variant", ["H", "L"])
def test_loop_respects_the_gate_on_validation_views(scene, dense, variant):
    """The result passes a gate computed anew, and is the passing model with the fewest entries."""
    stage = run(PruneStage(scene, dense, variant, replace(QUICK, iterations=60)))
    loss = {"H": 0.01, "L": 0.03}[variant]
    gate = Gate.of(evaluate(dense, scene, scene.validation), loss)
    quality = evaluate(stage.result(), scene, scene.validation)
    assert gate == stage.gate and gate.passes(quality)
    passed = [row for row in stage.history if row.passed]
    assert len(passed) > 2 and quality.entries == min(row.entries for row in passed) < 0.9 * stage.history[0].entries
    for row in stage.history:
        assert row.passed == (row.slack >= 0) and (not row.passed or row.psnr >= gate.psnr) and row.ssim is None
    assert [row.iteration for row in stage.history] == list(range(0, 61, 3))


def test_failure_at_the_end_restores_the_best_passing_model(scene, dense):
    """With nine tenths pruned at once and no time to recover, the dense model is what passes."""
    stage = run(PruneStage(scene, dense, "H", PruneOptions(iterations=3, interval=1, recovery=1, fraction=0.9)))
    assert not any(row.passed for row in stage.history[1:])
    assert len(stage.gaussians) < 0.2 * len(dense)
    assert same(stage.result(), dense)


def test_failures_lower_gamma_prune_nothing_and_wait(scene, dense):
    """After a failure gamma falls to no less than its first value, the points stay, and the next look comes after `recovery`
    iterations."""
    stage = PruneStage(scene, dense, "H", PruneOptions(iterations=10, interval=2, recovery=5, fraction=0.9, gamma_first=1e-4))
    records = [stage.step() for _ in range(10)]
    assert [row.iteration for row in stage.history] == [0, 2, 7, 10]
    assert [row["gamma"] for row in records] == [1e-4] * 10
    assert len({row["points"] for row in records}) == 1
    assert ["psnr" in row for row in records] == [i in (2, 7, 10) for i in range(1, 11)]


def test_a_prune_that_does_not_heal_is_undone_and_halved(scene, dense):
    """After `patience` failures the points that passed are back, less half of what was dropped; and so on."""
    options = PruneOptions(iterations=14, interval=1, recovery=2, patience=2, fraction=0.8, gamma_first=1.0)
    stage = run(PruneStage(scene, dense, "H", options), 1)
    full = stage.history[0].points
    assert len(stage.gaussians) == pytest.approx(0.2 * full, rel=0.3)
    points = [stage.step()["points"] for _ in range(13)]
    rises = [i for i in range(1, 13) if points[i] > points[i - 1]]
    assert rises and points[rises[0]] == pytest.approx(0.6 * full, rel=0.1)
    assert stage.history[-1].iteration == 14 and evaluate(stage.result(), scene, scene.validation).psnr >= stage.gate.psnr


@pytest.mark.parametrize(("failures", "left", "growth"), [
    (0, 6, 2), (1, 6, 1), (3, 6, 1 / 2), (1, 60, 2), (2, 60, 4 / 3), (3, 60, 1), (5, 60, 2 / 3), (11, 120, 1 / 2),
    (3, 3, 1 / 4)])
def test_a_prune_follows_how_long_the_last_recovery_took(scene, dense, failures, left, growth):
    """As far as FEW = 4 checks say, by up to twice and half; and by less where the next recovery, which may take three times as
    many checks, would not end. After a recovery at once the share doubles, up to `fraction`."""
    stage = run(PruneStage(scene, dense, "H", PruneOptions(iterations=1500, interval=10, fraction=0.2)), 1)
    stage.done, stage._failures, stage._fraction = 1500 - 10 * left, failures, 0.04
    stage._go_on()
    assert stage._fraction == pytest.approx(0.04 * growth)
    stage._failures, stage._fraction = 0, 0.15
    stage._go_on()
    assert stage._fraction == 0.2


@pytest.mark.parametrize(("slack", "done", "hopeless"), [
    ([-9, -5, -4, -3], 40, False),  # it gains 1 at each check, so that three of the five before `patience` would do
    ([-9, -5, -4, -3], 100, True),  # two are left
    ([-9, -3, -3, -3], 40, True), ([-9, -5, -4], 110, False), ([-9, -8, -7, -6, -5, -4, -3, -2, -1], 20, True)])
def test_a_prune_is_undone_where_the_rest_does_not_reach_the_gate(scene, dense, slack, done, hopeless):
    """By the gain of the later half of the failures; not before the fourth, and always at `patience`, here 9."""
    stage = run(PruneStage(scene, dense, "H", PruneOptions(iterations=120, interval=10, patience=9)), 1)
    stage.history += [replace(stage.history[0], slack=value) for value in slack]
    stage.done, stage._failures = done, len(slack)
    assert stage._hopeless() == hopeless


def test_the_gate_sees_the_running_average(scene, dense):
    """With rates so high that the parameters jump about, the model looked at is between where they have been."""
    training = Retraining(scene, dense, 0, "average", {"sh_dc": 0.5})
    gains = []
    for iteration in range(60):
        training.step(iteration, 0.0)
        if iteration >= 20 and iteration % 4 == 0:
            steady, jumping = (evaluate(each, scene, scene.validation) for each in (training.average, training.gaussians))
            gains.append(steady.psnr - jumping.psnr)
    assert np.mean(gains) > 0.2
    training.settle()
    assert same(training.gaussians, training.average)


def test_ablations(scene, dense):
    """Without scale decay gamma stays 0; without a criterion all points stay and scale decay alone works."""
    plain = run(PruneStage(scene, dense, "L", replace(QUICK, scale_decay=False)))
    assert {row.gamma for row in plain.history} == {0.0}
    kept = run(PruneStage(scene, dense, "L", replace(QUICK, criterion=None)))
    assert len(kept.gaussians) == len(dense) and max(row.gamma for row in kept.history) > 0


def test_opacity_clamp(scene, dense):
    stage = run(PruneStage(scene, dense, "L", replace(QUICK, opacity_clamp=0.1)), 1)
    assert float(torch.sigmoid(stage.gaussians.opacity.detach()).max()) < 0.12  # one step of Adam after the clamp


def test_scale_decay_shrinks_what_many_tiles_use(scene):
    """Of a few Gaussians that cover many tiles each, gamma leaves fewer entries than the photographs alone do."""
    entries = []
    for gamma in (0.0, 100.0):
        training = Retraining(scene, small_dense(60), 0, "decay", {"log_scales": 0.05})
        for iteration in range(20):
            training.step(iteration, gamma)
        entries.append(evaluate(training.gaussians, scene, scene.validation).entries)
    assert entries[1] < 0.9 * entries[0]


@pytest.mark.parametrize("at", [2, 7])
def test_resumed_equals_uninterrupted(scene, dense, at):
    """From a state in the middle of an interval on, everything is the same, bit for bit."""
    whole, first, second = (PruneStage(scene, dense, "M", QUICK, seed=3) for _ in range(3))
    run(whole)
    second.load(run(first, at).state())
    assert second.done == at and same(first.gaussians, second.gaussians)
    run(second)
    assert same(whole.gaussians, second.gaussians) and same(whole.result(), second.result())
    assert [asdict(row) for row in whole.history] == [asdict(row) for row in second.history]
    assert whole.gamma == second.gamma


def test_seed_decides(scene, dense):
    first, again, other = (run(PruneStage(scene, dense, "M", QUICK, seed=seed), 5) for seed in (0, 0, 1))
    assert same(first.gaussians, again.gaussians) and not same(first.gaussians, other.gaussians)


@pytest.mark.parametrize(("changes", "message"), [
    ({"iterations": 0}, "iterations.*0"), ({"scored": 0}, "scored.*0"), ({"margin": -0.1}, "margin.*-0.1"),
    ({"fraction": 1.0}, "fraction.*1.0"), ({"gate": "ssim"}, "gate.*'ssim'"), ({"criterion": "size"}, "criterion.*'size'"),
])
def test_options_refuse(changes, message):
    with pytest.raises(ValueError, match=message):
        PruneOptions(**changes)


def test_stages_refuse(scene, dense):
    with pytest.raises(ValueError, match="'X'"):
        PruneStage(scene, dense, "X")
    with pytest.raises(ValueError, match="'removal'"):
        baseline_stage("removal", scene, dense)
    with pytest.raises(ValueError, match="0 and 100"):
        FineTuneStage(scene, dense, iterations=0)


def test_the_papers_criterion_keeps_scale_decay(scene, dense):
    stage = run(baseline_stage("ce", scene, dense, "L", replace(QUICK, iterations=6)))
    assert stage.options.criterion == "ce" and max(row.gamma for row in stage.history) > 0


@pytest.mark.parametrize("criterion", ["count", "importance", "speedy", "pup", "random"])
def test_baselines_go_through_the_same_loop(scene, dense, criterion):
    stage = run(baseline_stage(criterion, scene, dense, "L", replace(QUICK, iterations=6)))
    assert stage.gate == Gate.of(evaluate(dense, scene, scene.validation), 0.03)
    assert {row.gamma for row in stage.history} == {0.0} and stage.history[1].points < len(dense)


def test_fine_tuning_lowers_hvsq_and_keeps_the_gate(scene, dense):
    """HVSQ of the validation views at pooling 1 comes down; the gate still passes; a resumed run is the same."""
    gate = Gate.of(evaluate(dense, scene, scene.validation), 0.01)
    stage = run(FineTuneStage(scene, dense, gate, iterations=24, interval=8))
    assert stage.after.hvsq[0] < stage.before.hvsq[0] and gate.passes(stage.after)
    assert evaluate(stage.result(), scene, scene.validation, hvsq=[lambda photograph: Hvsq(photograph, 1.0)]) == stage.after
    first, second = (FineTuneStage(scene, dense, gate, iterations=24, interval=8) for _ in range(2))
    second.load(run(first, 10).state())
    assert same(run(second).result(), stage.result()) and second.after == stage.after


def test_fine_tuning_that_does_not_help_is_undone(scene, dense):
    """With rates that wreck the model, or a gate that nothing passes, what came in goes out."""
    wrecked = run(FineTuneStage(scene, dense, iterations=4, interval=2, rates={"means": 1.0, "log_scales": 1.0}))
    assert same(wrecked.result(), dense) and wrecked.after == wrecked.before
    gated = run(FineTuneStage(scene, dense, Gate(99.0), iterations=4, interval=2))
    assert same(gated.result(), dense)
