"""A foveated model under training: nesting, quality bounds, what files and renderers get of it, and what it stores."""

import io

import numpy as np
import pytest

from tests.helpers.scenes_samples import float32_model

torch = pytest.importorskip("torch")

from golden.diff.gaussians import Gaussians, from_model  # noqa: E402
from golden.scenes.load import load_model  # noqa: E402
from golden.scenes.save import save_model  # noqa: E402
from golden.training.foveated import FoveatedModel, Version, floats_per_point, level_alpha_max  # noqa: E402
from spec.constants import AMP_MAX  # noqa: E402

UP = np.array([0.0, 0.6, -0.8])


def gaussians(n: int = 12, sh_degree: int = 3, seed: int = 0) -> Gaussians:
    """n Gaussians drawn at random, none amplified."""
    draw = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(shape, generator=draw)

    return Gaussians(normal(n, 3), normal(n, 3) - 3, normal(n, 4), normal(n), torch.zeros(n), normal(n, 3),
                     normal(n, (sh_degree + 1) ** 2 - 1, 3))


def version(rows: list[int], seed: int = 1) -> Version:
    draw = torch.Generator().manual_seed(seed)
    opacity, log_amp, sh_dc = (make(len(rows), generator=draw) for make in (torch.randn, torch.rand, torch.randn))
    return Version(torch.tensor(rows), opacity, log_amp, sh_dc[:, None].repeat(1, 3))


def four_levels() -> FoveatedModel:
    """12, 7, 3 and 1 points."""
    return FoveatedModel(gaussians(), (version([0, 1, 3, 4, 8, 9, 11]), version([1, 8, 11], 2), version([8], 3)))


def test_quality_bound_is_the_highest_level_that_uses_the_point():
    model = four_levels()
    assert model.levels == 4 and model.counts == (12, 7, 3, 1)
    assert model.quality_bound.tolist() == [2, 3, 1, 2, 2, 1, 1, 1, 4, 2, 1, 3]
    assert [level_alpha_max(level) for level in range(4)] == [0.99, 1.0, 1.0, 1.0]


def test_levels_share_geometry_and_have_their_own_opacity_and_colour():
    model = four_levels()
    level = model.level(2)
    rows = [1, 8, 11]
    for name in ("means", "log_scales", "quats", "sh_rest"):
        assert torch.equal(getattr(level, name), getattr(model.base, name)[rows])
    assert torch.equal(level.opacity, model.versions[1].opacity) and torch.equal(level.sh_dc, model.versions[1].sh_dc)
    assert torch.equal(level.log_amp, model.versions[1].log_amp)
    assert torch.equal(model.level(0).opacity, model.base.opacity)
    for index in (-1, 4):
        with pytest.raises(ValueError, match=f"not {index}"):
            model.level(index)
    assert model.truncated(2).counts == (12, 7)


@pytest.mark.parametrize("rows", [[], [1, 1], [8, 1], [2], [-1, 1], [12]])
def test_what_is_no_subset_of_the_level_before_is_refused(rows):
    two = FoveatedModel(gaussians(), (version([0, 1, 3, 4, 8, 9, 11]),))
    with pytest.raises(ValueError, match="rows of level 3"):
        two.with_level(version(rows))


def test_number_of_levels_is_checked():
    with pytest.raises(ValueError, match="not 5"):
        four_levels().with_level(version([8]))
    with pytest.raises(ValueError, match="not 0"):
        FoveatedModel(gaussians(0))


def test_beyond_its_bound_a_point_repeats_its_last_level():
    model = four_levels()
    exported = model.to_model(up=UP, name="four")
    amplified = torch.sigmoid(model.versions[0].opacity) * torch.exp(model.versions[0].log_amp)
    np.testing.assert_array_equal(exported.opacity[[0, 1, 3, 4, 8, 9, 11], 1], amplified.numpy())
    np.testing.assert_array_equal(exported.opacity[0, 1:], exported.opacity[0, 1])  # bound 2
    np.testing.assert_array_equal(exported.opacity[2], exported.opacity[2, 0])  # bound 1
    np.testing.assert_array_equal(exported.sh_dc[11, 3], model.versions[1].sh_dc[2].numpy())  # bound 3
    assert exported.opacity[8, 3] != exported.opacity[8, 2]
    np.testing.assert_array_equal(exported.quality_bound, model.quality_bound.numpy())
    assert exported.name == "four" and exported.levels == 4


def test_amplified_opacity_is_capped():
    capped = Version(torch.tensor([3]), torch.tensor([9.0]), torch.tensor([50.0]), torch.zeros(1, 3))
    exported = FoveatedModel(gaussians(), (capped,)).to_model(up=UP, name="capped")
    assert exported.opacity[3, 1] == AMP_MAX and (exported.opacity[:, 0] < 1).all()


def test_model_and_back():
    model = float32_model(n=50)
    back = FoveatedModel.from_model(model).to_model(up=model.up, name=model.name)
    used = np.arange(4) < model.quality_bound[:, None]
    np.testing.assert_array_equal(back.quality_bound, model.quality_bound)
    np.testing.assert_allclose(back.opacity[used], model.opacity[used], rtol=1e-6, atol=2e-7)
    np.testing.assert_array_equal(back.sh_dc[used], model.sh_dc[used])
    for name in ("means", "log_scales", "quats", "sh_rest", "up"):
        np.testing.assert_array_equal(getattr(back, name), getattr(model, name))


def test_file_and_back(tmp_path):
    model = four_levels().to_model(up=UP, name="four")
    save_model(model, tmp_path / "four.ply")
    loaded = load_model(tmp_path / "four.ply")
    for name in ("means", "log_scales", "quats", "opacity", "sh_dc", "sh_rest", "quality_bound"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(model, name))
    assert FoveatedModel.from_model(loaded).counts == (12, 7, 3, 1)


def test_state_and_back():
    model, buffer = four_levels(), io.BytesIO()
    torch.save(model.state(), buffer)
    back = FoveatedModel.from_state(torch.load(io.BytesIO(buffer.getvalue())))
    for level in range(4):
        for name, tensor in back.level(level).tensors().items():
            assert torch.equal(tensor, getattr(model.level(level), name))
    assert torch.equal(back.quality_bound, model.quality_bound)


def test_nested_levels_differ_in_points_alone():
    base = gaussians(6)
    model = FoveatedModel.nested(base, [3, 1, 2, 3, 1, 2])
    assert model.counts == (6, 4, 2)
    assert torch.equal(model.level(2).opacity, base.opacity[[0, 3]])
    assert torch.equal(model.level(1).sh_dc, base.sh_dc[[0, 2, 3, 5]])


def test_storage_by_hand():
    """59 floats at SH degree 3, four more for each of the 7 + 3 + 1 points of further levels, a byte for each bound."""
    model = four_levels()
    assert floats_per_point(model.base) == 59 and floats_per_point(gaussians(sh_degree=0)) == 14
    assert model.storage.level1 == 12 * 236
    assert model.storage.versions == 11 * 16
    assert model.storage.bounds == 12
    assert model.storage.total == 12 * 236 + 11 * 16 + 12
    assert model.storage.overhead_percent == pytest.approx(100 * 188 / 2832)
    assert model.truncated(1).storage.overhead_percent == 0


def test_trained_values_are_those_of_level_one_of_a_file():
    model = float32_model(n=30)
    amplified = from_model(model).amplified_opacity.numpy()
    np.testing.assert_allclose(FoveatedModel.from_model(model).level(0).amplified_opacity.numpy(), amplified, rtol=0)
