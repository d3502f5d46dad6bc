"""HVSQ against closed forms, its definition written out, finite differences, and an independent implementation."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter
from skimage.data import astronaut

torch = pytest.importorskip("torch")

from torch.nn.functional import interpolate  # noqa: E402

from golden.metrics.hvsq import FULL_WIDTH, POOLING_PX, Hvsq, foveated, pooling_map, pooling_px  # noqa: E402
from golden.metrics.level_pooling import LevelPooling  # noqa: E402
from golden.metrics.pooling import KINDS, MapPooling, UniformPooling  # noqa: E402
from golden.metrics.pyramid import LEVELS, SteerablePyramid, filters  # noqa: E402
from golden.scenes.gaze import Display  # noqa: E402
from spec.constants import REGION_START_DEG  # noqa: E402
from spec.errors import InputError  # noqa: E402

OFFSET_HVSQ = 0.05**2 / (51 * 3)
"""Of a uniform offset of 0.05: luma alone differs, in the low-pass alone."""


@pytest.fixture(autouse=True, scope="module")
def one_thread():
    """Tensors this small gain nothing from threads, and on a busy machine wait for them."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def picture(height, width, seed=0):
    """A scene of shades, stripes and grain: float64 (H, W, 3) in 0..1."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width] / 64
    stripes = np.stack([np.sin(5 * x + 9 * y), np.sin(30 * x * y), np.sin(3 * y)], axis=-1)
    grain = gaussian_filter(rng.normal(0, 1, (height, width, 3)), (0.7, 0.7, 0)) * (x[..., None] % 1)
    return np.clip(0.5 + 0.2 * stripes + 0.15 * grain, 0, 1)


def tensors(*arrays, dtype=torch.float32):
    return [torch.from_numpy(np.ascontiguousarray(a)).to(dtype) for a in arrays]


def noisy(image, seed=1, noise=0.05):
    return image + np.random.default_rng(seed).normal(0, noise, image.shape)


def poolings(height, width):
    """One of each kind: within a pixel, fractional, wide, wider than the image, and by eccentricity."""
    display = Display(width, height)
    by_gaze = pooling_map(display.eccentricity((width / 3, height / 2)))
    return [0.3, 1.0, 2.26, 7.0, 12.0, 500.0, 12 * by_gaze]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("size", [(64, 96), (50, 71)])
def test_a_uniform_offset_is_known_in_closed_form(size, kind):
    (reference,) = tensors(picture(*size))
    for pooling in poolings(*size):
        if kind == "blocks" and isinstance(pooling, np.ndarray):
            continue
        metric = Hvsq(reference, pooling, kind)
        assert metric(reference + 0.05).item() == pytest.approx(OFFSET_HVSQ, rel=2e-3)
        mask = torch.zeros(size, dtype=torch.bool)
        mask[3:9, 20:50] = True
        assert metric(reference + 0.05, mask).item() == pytest.approx(OFFSET_HVSQ, rel=2e-3)
        assert metric(reference).item() == 0 == metric.absolute(reference).item()


@pytest.mark.parametrize("pooling", [1.0, 3.0, 12.0])
def test_rises_with_blur_and_with_noise(pooling):
    reference = picture(64, 96)
    metric = Hvsq(*tensors(reference), pooling)
    for worse in (lambda s: gaussian_filter(reference, (s, s, 0)), lambda s: noisy(reference, noise=0.05 * s)):
        scores = [metric(*tensors(worse(s))).item() for s in (0.3, 0.6, 1, 2, 4)]
        assert scores == sorted(scores) and scores[-1] > 5 * scores[0]


def test_a_texture_of_like_statistics_is_forgiven_only_where_pooling_is_wide():
    rng = np.random.default_rng(5)
    texture, other = (0.5 + rng.normal(0, 0.1, (128, 128, 3)) for _ in range(2))
    flat = np.full_like(texture, 0.5)

    def score(image, pooling):
        return Hvsq(*tensors(texture), pooling)(*tensors(image)).item()

    # The squared error of a flat image is half of the other texture's, yet seen from the periphery it is the worse.
    assert np.mean((texture - flat) ** 2) < 0.6 * np.mean((texture - other) ** 2)
    assert score(flat, 1) < score(other, 1)
    assert score(flat, 16) > 4 * score(other, 16)
    assert score(other, 16) < 0.2 * score(other, 1)


def test_follows_the_definition():
    """Mean and deviation of windows of whole pixels, summed map by map and pixel by pixel."""
    image, reference = noisy(picture(32, 32)), picture(32, 32)
    total = 0.0
    for (size, a), (_, r) in zip(maps_by_the_text(image), maps_by_the_text(reference), strict=True):
        if size is None:
            total += np.mean((a - r) ** 2)
            continue
        for y in range(a.shape[0]):
            for x in range(a.shape[1]):
                (mean_a, sigma_a), (mean_r, sigma_r) = (window_statistics(m, y, x, size) for m in (a, r))
                total += ((mean_a - mean_r) ** 2 + (sigma_a - sigma_r) ** 2).sum() / a.size
    image, reference = tensors(image, reference, dtype=torch.float64)
    assert Hvsq(reference, 5)(image).item() == pytest.approx(total / 51, rel=1e-9)


def maps_by_the_text(rgb):
    """(pooling width or None, (h, w, 3) map) of an image, pooled by 5, 2.5, 1.25 and 0.625 pixels."""
    high, low, bands = filters()
    luma = rgb @ [0.299, 0.587, 0.114]
    image = np.stack([luma, 0.5 + 0.713 * (rgb[..., 0] - luma), 0.5 + 0.564 * (rgb[..., 2] - luma)], axis=-1)
    yield 5.0, correlated(image, high)
    image = correlated(image, low)
    for level in range(LEVELS - 1):
        for band in bands:
            yield 5.0 / 2**level, correlated(image, band)
        image = (image[::2, ::2] + image[1::2, ::2] + image[::2, 1::2] + image[1::2, 1::2]) / 4
    yield None, image


def correlated(image, taps):
    padded = np.pad(image, ((2, 2), (2, 2), (0, 0)), mode="reflect")
    height, width = image.shape[:2]
    return sum(taps[j, i] * padded[j : j + height, i : i + width] for j in range(5) for i in range(5))


def window_statistics(image, y, x, width):
    """(3,) mean and (3,) deviation of the box around a pixel; the pixels at its rim count in part."""
    shares = []
    for centre, n in ((y + 0.5, image.shape[0]), (x + 0.5, image.shape[1])):
        start, end = centre - max(width, 1) / 2, centre + max(width, 1) / 2
        shares.append([max(0.0, min(end, p + 1) - max(start, p)) for p in range(n)])
    weight = np.outer(*shares)[..., None] / np.sum(np.outer(*shares))
    mean = (weight * image).sum((0, 1))
    return mean, np.sqrt(np.maximum((weight * image**2).sum((0, 1)) - mean**2, 1e-7))


@pytest.mark.parametrize("width", [0.5, 1.0, 1.13, 2.0, 3.0, 6.7, 200.0])
def test_one_width_a_pixel_and_one_for_all_agree_and_have_true_adjoints(width):
    rng = np.random.default_rng(3)
    a, b = tensors(*rng.normal(size=(2, 2, 70, 33)), dtype=torch.float64)
    uniform, by_pixel = UniformPooling(max(width, 1), (70, 33), a), MapPooling(np.full((70, 33), width), a)
    assert torch.allclose(uniform.mean(a), by_pixel.mean(a), atol=1e-12)
    assert torch.allclose(uniform.adjoint(a), by_pixel.adjoint(a), atol=1e-12)
    for pooling in (uniform, by_pixel, MapPooling(rng.uniform(0, 9, (70, 33)), a)):
        assert (pooling.mean(a) * b).sum().item() == pytest.approx((a * pooling.adjoint(b)).sum().item())
        assert torch.allclose(pooling.mean(torch.ones_like(a)), torch.ones_like(a))


def test_a_map_of_one_width_is_that_width():
    image, reference = tensors(noisy(picture(64, 96)), picture(64, 96))
    for width in (0.7, 1.0, 3.1, 12.0):
        uniform, by_pixel = Hvsq(reference, width), Hvsq(reference, np.full((64, 96), width))
        assert by_pixel(image).item() == pytest.approx(uniform(image).item(), rel=1e-5)


def test_is_continuous_in_the_width():
    image, reference = tensors(noisy(picture(64, 96)), picture(64, 96), dtype=torch.float64)
    widths = [0.2, 1, 1.001, 1.999, 2, 2.001, 3.999, 4, 4.001]
    scores = [Hvsq(reference, width)(image).item() for width in widths]
    assert scores[0] == scores[1] and scores == sorted(scores, reverse=True)
    for a, b in ((1, 2), (3, 4), (4, 5), (6, 7), (7, 8)):
        assert scores[a] == pytest.approx(scores[b], rel=3e-3)


@pytest.mark.parametrize("size", [(32, 32), (29, 35)])
@pytest.mark.parametrize("which", [1.0, 2.6, "map"])
def test_gradient_is_that_of_finite_differences(size, which):
    rng = np.random.default_rng(2)
    pooling = rng.uniform(0, 5, size) if which == "map" else which
    image, reference = tensors(noisy(picture(*size)), picture(*size), dtype=torch.float64)
    metric = Hvsq(reference, pooling)
    mask = torch.from_numpy(rng.uniform(size=size) > 0.5)
    for value in (metric, metric.absolute, lambda x: metric(x, mask), lambda x: (metric.per_pixel(x) * mask).sum()):
        point = image.clone().requires_grad_()
        (gradient,) = torch.autograd.grad(value(point), point)
        for seed in range(3):
            direction = torch.from_numpy(np.random.default_rng(seed).normal(size=image.shape))
            step = 1e-7
            slope = (value(image + step * direction) - value(image - step * direction)) / (2 * step)
            assert (gradient * direction).sum().item() == pytest.approx(slope.item(), rel=1e-3, abs=1e-10)


def test_gradient_leads_to_the_reference_from_a_flat_image():
    """Where variances are clamped the deviation has no slope, yet the means lead on: no nan, and training goes down."""
    (reference,) = tensors(picture(32, 32))
    metric = Hvsq(reference, 3.0)
    image = torch.full_like(reference, 0.5).requires_grad_()
    before = metric.absolute(image)
    before.backward()
    assert torch.isfinite(image.grad).all()
    assert metric.absolute(image.detach() - 1e-3 * image.grad / image.grad.norm()) < before


@pytest.mark.parametrize("size", [(64, 96), (50, 71)])
def test_regions_recombine_to_the_whole(size):
    image, reference = tensors(noisy(picture(*size)), picture(*size), dtype=torch.float64)
    eccentricity = Display(size[1], size[0]).eccentricity((size[1] / 2, size[0] / 2))
    rings = [torch.from_numpy((eccentricity >= a) & (eccentricity < b)) for a, b in ((0, 10), (10, 25), (25, 90))]
    metric = Hvsq(reference, 2.5)
    scores = metric.regions(image, rings)
    assert scores.tolist() == pytest.approx([metric(image, ring).item() for ring in rings])
    weights = torch.tensor([float(ring.sum()) for ring in rings], dtype=torch.float64)
    exact = size == (64, 96)  # elsewhere resizing changes the regions' shares a little
    whole = pytest.approx(metric(image).item(), rel=1e-9 if exact else 0.03)
    assert (scores * weights).sum().item() / weights.sum().item() == whole
    pixels = metric.per_pixel(image)
    assert pixels.shape == size and pixels.mean().item() == whole
    part = metric(image, corner(size, 32)).item()
    assert pixels[:32, :32].mean().item() == pytest.approx(part, rel=1e-9 if exact else 0.1)


def corner(size, n):
    mask = torch.zeros(size, dtype=torch.bool)
    mask[:n, :n] = True
    return mask


def test_a_change_counts_in_its_own_region_alone():
    (reference,) = tensors(picture(96, 160))
    image = reference.clone()
    image[:32, :32] += 0.2
    near, far = corner((96, 160), 64), torch.zeros(96, 160, dtype=torch.bool)
    far[:, 128:] = True
    near_score, far_score = Hvsq(reference, 3).regions(image, [near, far]).tolist()
    assert near_score > 1e-5 and far_score < 1e-12


def test_widths_follow_levels_and_resolution():
    assert [pooling_px(level, 1237) for level in range(4)] == [1, 3, 7, 12]
    assert pooling_px(3, 400) == pytest.approx(12 * 400 / 1237)
    with pytest.raises(ValueError, match="4 "):
        pooling_px(4, 1237)


def test_widths_of_the_levels_are_those_where_their_regions_start():
    display = Display(1237, 822)
    eccentricity = display.eccentricity((1237 / 2, 411))
    widths, row = pooling_map(eccentricity)[411], eccentricity[411]
    for start, expected in list(zip(REGION_START_DEG, POOLING_PX, strict=True))[1:]:
        assert round(np.interp(start, row[619:], widths[619:])) == expected
    assert widths[618] < 1e-3


def test_a_foveated_metric_forgives_the_periphery_what_it_does_not_forgive_the_fovea():
    reference = picture(96, 160)
    eccentricity = Display(160, 96).eccentricity((20, 48))
    other = reference + gaussian_filter(noisy(np.zeros_like(reference), noise=0.1), (0, 0, 0))
    metric = foveated(*tensors(reference), eccentricity)
    near, far = (torch.from_numpy(m) for m in (eccentricity < 10, eccentricity > 50))
    scores = metric.regions(*tensors(other), [near, far]).tolist()
    plain = Hvsq(*tensors(reference), 1).regions(*tensors(other), [near, far]).tolist()
    assert scores[0] == pytest.approx(plain[0], rel=0.05) and scores[1] < 0.8 * plain[1]


def test_the_pyramid_splits_frequencies_evenly():
    """High-pass and low-pass powers add up to about one; the bands' energy turns evenly with the orientation."""
    high, low, bands = filters()
    assert high.sum() == pytest.approx(0, abs=0.03) and low.sum() == pytest.approx(1, abs=1e-3)
    assert np.abs(bands.sum((1, 2))).max() < 1e-7
    power = [np.abs(np.fft.fft2(taps, (64, 64))) ** 2 for taps in (high, low, *bands)]
    assert np.abs(power[0] + power[1] - 1).max() < 0.12
    y, x = np.meshgrid(np.fft.fftfreq(64), np.fft.fftfreq(64), indexing="ij")
    ring = sum(power[2:])[np.abs(np.hypot(y, x) - 0.2) < 0.01]
    assert ring.std() < 0.12 * ring.mean()


def test_statistics_are_of_the_stated_size():
    (reference,) = tensors(picture(64, 96))
    assert Hvsq(reference, 12).nbytes <= 216 * 64 * 96
    assert Hvsq(reference, 1).nbytes <= 108 * 64 * 96


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: Hvsq(torch.zeros(40, 40), 1), "40, 40"),
        (lambda: Hvsq(torch.zeros(40, 40, 3, dtype=torch.uint8), 1), "uint8"),
        (lambda: Hvsq(torch.zeros(40, 40, 3), float("nan")), "nan"),
        (lambda: Hvsq(torch.zeros(40, 40, 3), -1.0), "-1.0"),
        (lambda: Hvsq(torch.zeros(40, 40, 3), np.ones((40, 41))), "40, 41"),
        (lambda: Hvsq(torch.zeros(40, 40, 3), 1, "disc"), "kind 'disc'"),
        (lambda: Hvsq(torch.zeros(40, 40, 3), np.ones((40, 40)), "blocks"), "box alone with a map"),
        (lambda: Hvsq(torch.zeros(40, 40, 3), 1)(torch.zeros(40, 41, 3)), "40, 41"),
        (lambda: Hvsq(torch.zeros(40, 40, 3), 1)(torch.zeros(40, 40, 3), torch.zeros(40, 40)), "none"),
        (lambda: Hvsq(torch.zeros(40, 40, 3), 1)(torch.zeros(40, 40, 3), torch.zeros(4, 40)), "4, 40"),
    ],
)
def test_bad_input_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


@pytest.mark.parametrize("width", [1.5, 2.26, 3, 7, 12, 500])
@pytest.mark.parametrize("size", [(64, 96), (50, 71)])
def test_blocks_are_areas_down_and_bilinear_up(width, size):
    """As torch resizes; the adjoint is the transposed map."""
    planes, other = torch.rand(2, 3, *size, dtype=torch.float64, generator=torch.Generator().manual_seed(3))
    blocks = UniformPooling(width, size, planes, "blocks")
    areas = interpolate(planes[None], size=[max(1, int(n / width)) for n in size], mode="area")
    expected = interpolate(areas, size=size, mode="bilinear", align_corners=False)[0]
    assert torch.allclose(blocks.mean(planes), expected, atol=1e-12)
    assert float((blocks.mean(planes) * other).sum()) == pytest.approx(float((planes * blocks.adjoint(other)).sum()))


@pytest.mark.parametrize("width", [3.0, 7.0, 12.0])
def test_blocks_forgive_a_shift_that_boxes_see(width):
    reference = astronaut()[:288, :416] / 255
    shifted = np.roll(reference, 1, axis=1)
    by_box, by_blocks = (Hvsq(*tensors(reference), width, kind)(*tensors(shifted)).item() for kind in ("box", "blocks"))
    assert 1.2 < by_box / by_blocks < 2


def test_gradient_over_blocks_is_that_of_finite_differences():
    reference, image = tensors(picture(32, 64), noisy(picture(32, 64)), dtype=torch.float64)
    metric = Hvsq(reference, 5.0, "blocks")
    image.requires_grad_()
    metric(image).backward()
    direction = torch.rand(image.shape, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    with torch.no_grad():
        rise = (metric(image + 1e-5 * direction) - metric(image - 1e-5 * direction)).item() / 2e-5
    assert float((image.grad * direction).sum()) == pytest.approx(rise, rel=1e-5)


def test_levels_pool_over_the_papers_pixels():
    """Or over fewer, where the frame is taken to be shown as large as the paper's."""
    assert LevelPooling().widths == POOLING_PX and LevelPooling().kind == "blocks"
    assert LevelPooling(FULL_WIDTH // 2).widths == pytest.approx(np.divide(POOLING_PX, 2), rel=1e-3)
    reference, image = tensors(picture(64, 96), noisy(picture(64, 96)))
    for kind in KINDS:
        pooling = LevelPooling().of_kind(kind)
        assert pooling.hvsq(reference, 2)(image) == Hvsq(reference, 7.0, kind)(image)
    for arguments, message in (((0,), "pooling-width 0"), ((10, "disc"), "pooling 'disc' .* blocks, box")):
        with pytest.raises(InputError, match=message):
            LevelPooling(*arguments)


def odaks(name):
    """A module of the independent implementation, and its pyramid with the settings that make it ours."""
    module = pytest.importorskip(f"odak.learn.perception.{name}")
    from odak.learn.perception.spatial_steerable_pyramid import SpatialSteerablePyramid

    settings = {"n_channels": 3, "n_orientations": 6, "filter_size": 5, "filter_type": "cropped"}
    return module, SpatialSteerablePyramid(use_bilinear_downup=True, **settings)


def nchw(image):
    return image.permute(2, 0, 1)[None].contiguous()


def alterations(reference):
    return {
        "noise": noisy(reference),
        "blur": gaussian_filter(reference, (0.8, 0.8, 0)),
        "shift": np.roll(reference, 1, axis=1),
    }


def test_odaks_pyramid_is_ours():
    _, pyramid = odaks("metameric_loss_uniform")
    (image,) = tensors(picture(64, 96).transpose(2, 0, 1))
    high, bands, low = SteerablePyramid(image)(image)
    theirs = pyramid.construct_pyramid(image[None], LEVELS)
    assert torch.allclose(high, theirs[0]["h"][0], atol=1e-6) and torch.allclose(low, theirs[-1]["l"][0], atol=1e-6)
    for ours, level in zip(bands, theirs, strict=False):
        assert torch.allclose(ours.view(3, 6, *ours.shape[1:]), torch.stack(level["b"], dim=2)[0], atol=1e-6)


@pytest.mark.parametrize("width", [1, 2, 3, 4, 7, 12])
def test_odak_agrees(width):
    """Its pooling interpolates between means of separate blocks, which smooths more than a window around each pixel.

    What that takes depends on how far apart the differences' signs alternate: most from a photograph's shift.
    """
    module, pyramid = odaks("metameric_loss_uniform")
    reference = astronaut()[:288, :416] / 255
    for name, image in alterations(reference).items():
        theirs = module.MetamericLossUniform(pooling_size=width, n_orientations=6)
        theirs.pyramid_maker = pyramid
        expected = theirs(*(nchw(t) for t in tensors(image, reference))).item()
        ratio = Hvsq(*tensors(reference), width)(*tensors(image)).item() / expected
        most = 1 if width == 1 else 1.6 if name == "shift" else 1.2
        assert 1 - 1e-4 < ratio < most + 1e-4


@pytest.mark.parametrize("width", [2.5, 3, 5, 7.3, 12])
def test_odak_agrees_exactly_once_it_pools_as_we_do(width, monkeypatch):
    module, pyramid = odaks("metameric_loss_uniform")
    reference = picture(64, 96)
    theirs = module.MetamericLossUniform(pooling_size=width, n_orientations=6)
    theirs.pyramid_maker = pyramid
    monkeypatch.setattr(module, "uniform_blur", boxes)
    for image in alterations(reference).values():
        expected = theirs(*(nchw(t) for t in tensors(image, reference))).item()
        assert Hvsq(*tensors(reference), width)(*tensors(image)).item() == pytest.approx(expected, rel=1e-4)


@pytest.mark.parametrize("width", [2, 4, 8])
def test_odak_agrees_exactly_over_blocks(width, monkeypatch):
    """Its blocks are ours; within a pixel, where ours are the pixel itself, its resizing is switched off."""
    module, pyramid = odaks("metameric_loss_uniform")
    reference = picture(64, 96)
    theirs = module.MetamericLossUniform(pooling_size=width, n_orientations=6)
    theirs.pyramid_maker = pyramid
    blur = module.uniform_blur
    monkeypatch.setattr(module, "uniform_blur", lambda image, size: blur(image, size) if size > 1 else image)
    for image in alterations(reference).values():
        expected = theirs(*(nchw(t) for t in tensors(image, reference))).item()
        assert Hvsq(*tensors(reference), width, "blocks")(*tensors(image)).item() == pytest.approx(expected, rel=1e-4)


def boxes(image, width):
    """Means over boxes, from windows of whole pixels: the box ends in a share of the next pixel each way."""
    reach = int(np.ceil((max(width, 1) - 1) / 2))
    taps = torch.ones(2 * reach + 1)
    if reach:
        taps[0] = taps[-1] = (width - 1) / 2 - (reach - 1)
    n, c, h, w = image.shape

    def summed(planes):
        return torch.nn.functional.conv2d(planes.reshape(n * c, 1, h, w), torch.outer(taps, taps)[None, None], padding=reach)

    return (summed(image) / summed(torch.ones_like(image))).view(n, c, h, w)


def test_odaks_foveated_loss_agrees():
    module, pyramid = odaks("metameric_loss")
    height, width = 160, 224
    reference = astronaut()[:height, :width] / 255
    ninety_degrees = {"real_image_width": 2.0, "real_viewing_distance": 1.0}
    gaze = (0.1, 0.5)
    display = Display(width, height)
    ours = foveated(*tensors(reference), display.eccentricity((gaze[0] * width, gaze[1] * height)))
    for image in alterations(reference).values():
        theirs = module.MetamericLoss(alpha=0.05, n_orientations=6, use_l2_foveal_loss=False, **ninety_degrees)
        theirs.pyramid_maker = pyramid
        expected = theirs(*(nchw(t) for t in tensors(image, reference)), gaze=gaze).item()
        assert 0.9 < ours(*tensors(image)).item() / expected < 1.4
