"""What pruning ranks by, and scale decay."""

import math
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from golden.diff.removal import removal  # noqa: E402
from golden.diff.render import render  # noqa: E402
from golden.diff.sensitivity import sensitivity  # noqa: E402
from golden.training.efficiency import (  # noqa: E402
    TIE_BREAK,
    UPPER,
    Scores,
    efficiency,
    importance,
    pup,
    widened,
    without_lowest,
)
from golden.training.scale_decay import balance, next_gamma, weighted_scale  # noqa: E402
from golden.training.views import PerView, generator, view_at, views_within  # noqa: E402
from tests.helpers.training_samples import forward_camera, pixels_covered, round_gaussians  # noqa: E402

LONE, WIDE, HIDDEN, SHARED, BEHIND = range(5)
BALLS = [
    (8.0, 8.0, 2.0, 1.5, 0.9),      # alone, inside the first tile
    (40.0, 40.0, 3.0, 4.0, 0.95),   # alone, over four tiles: its centre is 8 px off the edges at 48, its reach 12 px
    (40.0, 40.0, 5.0, 1.0, 0.6),    # behind the one before, seen by its light alone: T alpha 0.03 at most
    (12.0, 56.0, 2.0, 1.0, 0.5),    # alone, across the edge of two tiles
    (32.0, 32.0, -4.0, 3.0, 0.9),   # behind the camera
]


def test_efficiency_of_known_dominators():
    """CE is pixels dominated over tiles used: full for what lies alone in a tile, next to nothing for what is hidden."""
    rendering = render(round_gaussians(BALLS), forward_camera(), usage=True)
    score = efficiency(rendering, len(BALLS))
    lone = pixels_covered(1.5, 8, 8, 0.9)
    assert score[LONE] == pytest.approx(lone, rel=1e-3)
    assert score[WIDE] == pytest.approx(pixels_covered(4.0, 40, 40, 0.95) / 9, rel=1e-3)  # 28..52 meets tiles 1..3 each way
    assert 0 < score[HIDDEN] < 256 * TIE_BREAK
    assert score[SHARED] == pytest.approx(pixels_covered(1.0, 12, 56, 0.5), rel=1e-3)
    assert score[BEHIND] == 0


def test_scores_are_the_largest_of_any_view():
    """A view that is closer dominates more pixels; a point that it does not see keeps the other view's score."""
    gaussians = round_gaussians(BALLS)
    cameras = [forward_camera(), forward_camera(cx=-32.0)]  # the second is turned to the right: most of the points leave it
    single = torch.stack([efficiency(render(gaussians, camera, usage=True), len(BALLS)) for camera in cameras])
    assert not torch.equal(single[0], single[1])
    assert torch.equal(Scores("ce", cameras).measure(gaussians), single.max(dim=0).values)


def test_widened_view_holds_the_view_in_its_middle():
    """The frame grows by its share on each side, the picture within it stays; a ball beyond the edge is scored."""
    camera, gaussians = forward_camera(), round_gaussians([*BALLS, (70.0, 30.0, 2.0, 1.5, 0.9)])
    wide = widened(camera, 0.25)
    assert (wide.width, wide.height) == (96, 96)
    inner = render(gaussians, wide).image[16:80, 16:80]
    assert torch.allclose(inner, render(gaussians, camera).image, atol=1e-5)
    assert Scores("ce", [camera]).measure(gaussians)[-1] == 0
    assert Scores("ce", [wide]).measure(gaussians)[-1] > 10


@pytest.mark.parametrize("criterion", ["ce", "importance"])
def test_scores_measured_in_parts_are_those_measured_at_once(criterion):
    """While the model stands still, parts of views measured anew change nothing; a prune takes the rows along."""
    gaussians = round_gaussians(BALLS)
    cameras = [forward_camera(cx=32.0 - 3 * step) for step in range(5)]
    whole, parts = Scores(criterion, cameras), Scores(criterion, cameras, share=3)
    expected = whole.measure(gaussians)
    assert all(torch.equal(parts.measure(gaussians), expected) for _ in range(4))
    keep = torch.tensor([True, True, False, True, True])
    parts.select(keep)
    again = Scores(criterion, cameras, share=3)
    again.load(parts.state())
    fewer = gaussians.select(keep)
    for _ in range(4):
        assert torch.equal(parts.measure(fewer), again.measure(fewer))
    assert torch.equal(parts.measure(fewer), Scores(criterion, cameras).measure(fewer))


def test_importance_formula():
    """Contribution times volume^0.1: a tenth of e^10 is e."""
    score = importance(torch.tensor([2.0, 2.0, 0.0]), torch.tensor([[0.0, 0, 0], [10.0, 3, -3], [5.0, 5, 5]]))
    assert score.tolist() == pytest.approx([2.0, 2.0 * math.e, 0.0])


def test_importance_sums_contributions_of_all_views():
    """Two equal views weigh twice as much as one."""
    gaussians = round_gaussians(BALLS)
    once = Scores("importance", [forward_camera()]).measure(gaussians)
    twice = Scores("importance", [forward_camera()] * 2).measure(gaussians)
    assert torch.equal(twice, 2 * once)
    assert once[BEHIND] == 0 and (once[:BEHIND] > 0).all()


def test_count_ranks_by_opacity_and_random_by_seed():
    gaussians = round_gaussians(BALLS)
    by_opacity = torch.argsort(Scores("count", [forward_camera()]).measure(gaussians), stable=True)
    assert by_opacity.tolist() == [SHARED, HIDDEN, LONE, BEHIND, WIDE]
    draws = [Scores("random", [forward_camera()], seed=seed).measure(gaussians) for seed in (0, 0, 1)]
    assert torch.equal(draws[0], draws[1]) and not torch.equal(draws[0], draws[2])


def views_of(camera) -> list:
    """Five cameras, each a little to the side of the one before and turned."""
    return [replace(camera, cx=camera.cx - 3 * step, translation=np.array([0.002 * step, 0.001 * step, 0.0]))
            for step in range(5)]


def test_speedy_is_the_log_of_the_sums_over_views():
    """Sums of each view, made here, over the Gaussians that it projects; what no view sees is -inf and goes first."""
    gaussians, cameras = round_gaussians(BALLS), views_of(forward_camera())
    total = np.zeros(len(BALLS))
    for camera in cameras:
        found = sensitivity(gaussians, camera, fisher=False)
        for row, value in zip(found.index.tolist(), found.value.tolist(), strict=True):
            total[row] += value
    score = Scores("speedy", cameras).measure(gaussians)
    assert score[BEHIND] == -math.inf and total[BEHIND] == 0
    assert score[:BEHIND].tolist() == pytest.approx(np.log(total[:BEHIND]).tolist())
    assert torch.nonzero(~without_lowest(score, 2)).squeeze(1).tolist() == [HIDDEN, BEHIND]


def test_pup_is_the_log_determinant_over_views():
    """Matrices of all views are added before the determinant is taken, which one view of a ball leaves at next to nothing."""
    gaussians, cameras = round_gaussians(BALLS), views_of(forward_camera())
    total = np.zeros((len(BALLS), 6, 6))
    for camera in cameras:
        found = sensitivity(gaussians, camera)
        total[found.index.numpy()] += found.fisher.numpy()
    score = Scores("pup", cameras).measure(gaussians)
    assert score[BEHIND] == -math.inf
    expected = np.linalg.slogdet(total[:BEHIND])[1]
    assert score[:BEHIND].tolist() == pytest.approx(expected.tolist(), rel=1e-6)
    halves = torch.eye(6, dtype=torch.float64)[None].repeat(2, 1, 1)
    halves[1] *= 0.5
    assert pup(halves[:, UPPER[0], UPPER[1]]).tolist() == pytest.approx([0.0, 6 * math.log(0.5)])


def test_removals_are_sums_over_the_views_and_the_tiles_that_pay():
    gaussians, cameras = round_gaussians(BALLS), views_of(forward_camera())
    each = [removal(gaussians, camera) for camera in cameras]
    change, tiles = torch.zeros(len(BALLS), dtype=torch.float64), torch.zeros(len(BALLS), dtype=torch.float64)
    for found in each:
        change[found.index] += found.change
        tiles[found.index] += found.tiles
    assert tiles.max() > len(cameras) and (tiles == 0).any()
    assert torch.equal(Scores("removal", cameras).measure(gaussians), change)
    assert torch.equal(Scores("removal_per_tile", cameras).measure(gaussians), change / tiles.clamp(min=1))


@pytest.mark.parametrize("criterion", ["speedy", "pup", "removal", "removal_per_tile"])
def test_sensitivities_measured_in_parts_are_those_measured_at_once(criterion):
    gaussians, cameras = round_gaussians(BALLS[:BEHIND]), views_of(forward_camera())
    expected = Scores(criterion, cameras).measure(gaussians)
    parts = Scores(criterion, cameras, share=3)
    assert all(torch.allclose(parts.measure(gaussians), expected, rtol=1e-6) for _ in range(4))
    keep = torch.tensor([True, True, False, True])
    parts.select(keep)
    again = Scores(criterion, cameras, share=3)
    again.load(parts.state())
    fewer = gaussians.select(keep)
    for _ in range(3):
        now = parts.measure(fewer)
        assert torch.equal(now, again.measure(fewer))
    assert torch.allclose(now, Scores(criterion, cameras).measure(fewer), rtol=1e-6)


def test_without_lowest_is_stable():
    """Of equal scores the first go first."""
    scores = torch.tensor([1.0, 0.0, 2.0, 0.0, 0.0])
    assert without_lowest(scores, 2).tolist() == [True, False, True, False, True]
    assert without_lowest(scores, 0).all()


def test_invisible_and_redundant_giant_go_first():
    """On a grid of balls that share the frame, what lies behind the camera and a faint giant over all tiles go first."""
    grid = [(4.0 + 8 * i, 4.0 + 8 * j, 3.0, 4.0, 0.9) for i in range(8) for j in range(8)]
    gaussians = round_gaussians([*grid[:20], (32.0, 32.0, 2.0, 25.0, 0.02), *grid[20:], (32.0, 32.0, -3.0, 4.0, 0.9)])
    score = Scores("ce", [forward_camera(), forward_camera(cx=30.0)]).measure(gaussians)
    assert torch.nonzero(~without_lowest(score, 2)).squeeze(1).tolist() == [20, len(gaussians) - 1]
    significant = Scores("importance", [forward_camera()]).measure(gaussians)
    assert torch.nonzero(~without_lowest(significant, 2)).squeeze(1).tolist() != [20, len(gaussians) - 1]


@pytest.mark.parametrize(("arguments", "message"), [
    (("size", [forward_camera()]), "'size'"), (("ce", []), "at least one camera"),
])
def test_scores_refuse(arguments, message):
    with pytest.raises(ValueError, match=message):
        Scores(*arguments)


def test_weighted_scale_and_its_gradient():
    """WS = mean of the largest scale times tiles beyond 4; its gradient is that product over N, on the largest axis alone."""
    log_scales = torch.tensor([[0.0, 1.0, -1.0], [2.0, 0.0, 0.0], [0.5, 0.1, 0.2], [3.0, 3.5, 3.1]], requires_grad=True)
    index, tiles = torch.tensor([3, 0, 2]), torch.tensor([5, 10, 4], dtype=torch.int32)
    value = weighted_scale(log_scales, index, tiles)
    assert value.item() == pytest.approx((math.exp(3.5) * 1 + math.exp(1.0) * 6) / 4)
    value.backward()
    expected = torch.zeros(4, 3)
    expected[0, 1], expected[3, 1] = math.exp(1.0) * 6 / 4, math.exp(3.5) / 4
    assert torch.allclose(log_scales.grad, expected)


def test_gamma_rises_and_falls_by_threes():
    """From 0 to the first value at the first pass, and never below it again, nor above the limit."""
    gamma, seen = 0.0, []
    for passed in (False, True, True, True, True, False, False, False, False, True):
        gamma = next_gamma(gamma, passed, 1e-4, 2e-3)
        seen.append(gamma)
    assert seen == pytest.approx([0.0, 1e-4, 3e-4, 9e-4, 2e-3, 2e-3 / 3, 2e-3 / 9, 1e-4, 1e-4, 3e-4])
    assert next_gamma(1e-4, True, 1e-4, 5e-5) == 1e-4


def test_balance_makes_both_terms_equal():
    assert balance(0.06, 2.0) * 2.0 == pytest.approx(0.06) and balance(0.06, 0.0) == 0.0


def test_each_epoch_has_every_view_once_in_an_order_of_its_own():
    views = [3, 5, 8, 9, 11, 14, 20]
    epochs = [[view_at(views, 1, "x", epoch * 7 + i) for i in range(7)] for epoch in range(3)]
    assert all(sorted(epoch) == views for epoch in epochs) and epochs[0] != epochs[1] != epochs[2]
    assert generator(1, "x", 0).random() != generator(1, "y", 0).random()


def test_per_view_keeps_no_more_than_its_limit():
    made = []
    kept = PerView(lambda view: made.append(view) or [view], 2)
    assert [kept(view)[0] for view in (4, 5, 6, 4, 5, 6)] == [4, 5, 6, 4, 5, 6]
    assert made == [4, 5, 6, 6]
    assert views_within(100, 10, 5000) == 5 and views_within(100, 10, 1) == 1
