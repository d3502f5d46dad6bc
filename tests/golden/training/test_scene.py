"""Training scenes: views divided, photographs reduced, the first Gaussians, and every bad input named."""

import json
from dataclasses import replace

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from PIL import Image  # noqa: E402

from golden.diff.render import render  # noqa: E402
from golden.metrics.hvsq import Hvsq  # noqa: E402
from golden.metrics.ssim import Ssim  # noqa: E402
from golden.scenes.datasets import load_dataset  # noqa: E402
from golden.training import embedded_photographs as embedded  # noqa: E402
from golden.training import random_points  # noqa: E402
from golden.training.evaluate import evaluate  # noqa: E402
from golden.training.initial import OPACITY, WIDEST, initial_gaussians  # noqa: E402
from golden.training.losses import photometric  # noqa: E402
from golden.training.photographs import area_resized  # noqa: E402
from golden.training.scene import load_training_scene  # noqa: E402
from spec.constants import SH_C0  # noqa: E402
from spec.errors import InputError  # noqa: E402
from tests.golden.scenes.test_datasets import HEIGHT, VIEWS, WIDTH, little_scene, paint, write_colmap, write_set  # noqa: E402


def test_a_scene_of_each_format(tmp_path):
    for kind in ("llff", "nerfstudio"):
        (tmp_path / kind).mkdir()
        cameras, points = write_set(kind, tmp_path / kind)
        scene = load_training_scene(tmp_path / kind)
        assert (scene.name, scene.size, len(scene)) == (kind, (WIDTH, HEIGHT), VIEWS)
        assert (scene.test, scene.validation, scene.train) == ((0, 8), (2, 6), (1, 3, 4, 5, 7))
        for i, camera in enumerate(cameras):
            assert np.array_equal(scene.images[i], paint(camera, points))
            photograph = scene.photograph(i)
            assert photograph.dtype == torch.float32
            assert torch.equal(photograph * 255, torch.tensor(paint(camera, points)).float())
        assert sorted(map(tuple, scene.points.round(6))) == sorted(map(tuple, points))
        positions = np.array([cameras[i].position for i in scene.train])
        assert scene.extent == pytest.approx(1.1 * np.linalg.norm(positions - positions.mean(axis=0), axis=1).max())


@pytest.mark.parametrize("views", [3, 4, 9, 17, 100])
def test_views_are_divided(views):
    cameras = little_scene()[0]
    from golden.training.scene import divided_scene

    scene = divided_scene("many", np.array([0.0, 0, 1]), tuple(cameras[i % VIEWS] for i in range(views)),
                          np.zeros((views, HEIGHT, WIDTH, 3), np.uint8), np.ones((4, 3)), np.ones((4, 3)))
    assert sorted(scene.test + scene.validation + scene.train) == list(range(views))
    assert min(len(scene.test), len(scene.validation), len(scene.train)) >= 1 and scene.extent > 0
    assert scene.test == tuple(range(0, views, 8))


@pytest.mark.parametrize(("views", "validate", "train"), [(20, 4, 13), (24, 5, 16), (48, 5, 37), (100, 11, 76)])
def test_small_sets_validate_with_more_than_an_eighth(views, validate, train):
    """At least 5 views, but at most a quarter of those that do not test."""
    cameras = little_scene()[0]
    from golden.training.scene import divided_scene

    scene = divided_scene("many", np.array([0.0, 0, 1]), tuple(cameras[i % VIEWS] for i in range(views)),
                          np.zeros((views, HEIGHT, WIDTH, 3), np.uint8), np.ones((4, 3)), np.ones((4, 3)))
    assert (len(scene.validation), len(scene.train)) == (validate, train)


def test_doubtful_views_neither_train_nor_validate():
    cameras = little_scene()[0]
    from golden.training.scene import divided_scene, doubtful_poses

    def divided(doubtful):
        return divided_scene("many", np.array([0.0, 0, 1]), tuple(cameras[i % VIEWS] for i in range(24)),
                             np.zeros((24, HEIGHT, WIDTH, 3), np.uint8), np.ones((4, 3)), np.ones((4, 3)), doubtful)

    whole, part = divided(()), divided((0, 1, 4, 5))
    assert part.doubtful == (0, 1, 4, 5) and part.test == whole.test
    assert whole.judged == whole.test == (0, 8, 16) and part.judged == (8, 16)
    assert replace(part, doubtful=(0, 8, 16)).judged == (0, 8, 16)
    assert part.train == tuple(i for i in whole.train if i not in part.doubtful)
    assert part.validation == tuple(i for i in whole.validation if i not in part.doubtful)
    assert {1, 4, 5} <= {*whole.train, *whole.validation}
    assert divided(tuple(range(24))).train == whole.train and divided(whole.validation).doubtful == ()
    assert doubtful_poses(None) == doubtful_poses(np.full(3, np.nan)) == ()
    assert doubtful_poses(np.array([0.3, 0.2, np.nan, 0.9, 0.21])) == (3,)


def test_size(tmp_path):
    write_set("llff", tmp_path)
    full = load_training_scene(tmp_path)
    scene = load_training_scene(tmp_path, (48, 32))
    assert scene.size == (48, 32) and scene.images.shape == (VIEWS, 32, 48, 3)
    assert scene.cameras[3].fx == pytest.approx(full.cameras[3].fx * 0.8)
    assert np.array_equal(scene.images, full.resized(48, 32).images)
    for size in ((61, 41), (40, 27 + 4), (30, 20), (0, 0), (60, 80)):
        with pytest.raises(InputError, match=f"size {size[0]}x{size[1]}"):
            load_training_scene(tmp_path, size)


def test_area_resizing():
    random = np.random.default_rng(0)
    image = random.integers(0, 256, (6, 12, 3), dtype=np.uint8)
    half = image.reshape(3, 2, 6, 2, 3).mean(axis=(1, 3))
    assert np.array_equal(area_resized(image[None], 6, 3)[0], np.floor(half + 0.5))
    odd = area_resized(image, 5, 4)  # by its definition: the mean over the area, here in sixtieths and halves of a pixel
    fine = image.repeat(2, axis=0).repeat(5, axis=1).astype(float)
    want = fine.reshape(4, 3, 5, 12, 3).mean(axis=(1, 3))
    assert np.abs(odd - want).max() <= 0.5 + 1e-4
    assert np.array_equal(area_resized(np.full((7, 9, 3), 200, np.uint8), 4, 4), np.full((4, 4, 3), 200))


def reject(tmp_path, match):
    with pytest.raises(InputError, match=match):
        load_training_scene(tmp_path)


def test_no_photographs(tmp_path):
    pytest.importorskip("pycolmap")
    write_colmap(tmp_path, *little_scene())
    reject(tmp_path, "no photographs; a folder 'images'")


@pytest.mark.parametrize(("count", "word"), [(1, "1 photograph;"), (2, "2 photographs;")])
def test_too_few_photographs(tmp_path, count, word):
    write_set("nerfstudio", tmp_path)
    path = tmp_path / "transforms.json"
    meta = json.loads(path.read_text())
    path.write_text(json.dumps(meta | {"frames": meta["frames"][:count]}))
    reject(tmp_path, f"{word} at least 3")


def test_photographs_that_are_not_the_cameras(tmp_path):
    pytest.importorskip("pycolmap")
    for kind in ("colmap", "llff", "nerfstudio"):
        folder = tmp_path / kind
        folder.mkdir()
        write_set(kind, folder)
        for image in folder.glob("images*/*.png"):  # all of them turned: one size, not the cameras' proportions
            Image.new("RGB", (HEIGHT, WIDTH)).save(image)
        reject(folder, f"view_00.png: is {HEIGHT}x{WIDTH}, its camera {WIDTH if kind != 'llff' else 4 * WIDTH}x")
    (tmp_path / "colmap" / "images" / "view_02.png").unlink()
    reject(tmp_path / "colmap", r"view_0[02]\.png")
    (tmp_path / "llff" / "images_4" / "view_02.png").unlink()
    reject(tmp_path / "llff", "9 poses, 8 photographs")


def test_mixed_sizes(tmp_path):
    write_set("nerfstudio", tmp_path)
    Image.new("RGB", (WIDTH * 2, HEIGHT * 2)).save(tmp_path / "images" / "view_03.png")
    reject(tmp_path, r"view_03\.png: is 120x80, view_00\.png 60x40; photographs of one size")


def test_masks(tmp_path):
    write_set("nerfstudio", tmp_path)
    assert load_training_scene(tmp_path).masks is None
    hidden = np.full((HEIGHT, WIDTH), 255, np.uint8)
    hidden[:10, :20] = 0
    (tmp_path / "masks").mkdir()
    reject(tmp_path, r"masks: has no mask of view_00\.png")
    Image.fromarray(hidden).save(tmp_path / "masks" / "view_01.png")
    scene = load_training_scene(tmp_path)
    assert np.array_equal(scene.masks[1], hidden > 0) and np.delete(scene.masks, 1, axis=0).all()
    assert scene.shown_share(1) == pytest.approx(1 - 200 / (WIDTH * HEIGHT)) and scene.shown_share(0) == 1
    half = scene.resized(48, 32)  # 0.8 of the size: the ninth pixel across is the first that the mask leaves alone as a whole
    assert half.masks.shape == (VIEWS, 32, 48) and not half.masks[1, :8, :16].any() and half.masks[1, 8:].all()
    Image.new("L", (WIDTH, HEIGHT)).save(tmp_path / "masks" / "view_01.png")
    reject(tmp_path, r"view_01\.png: hides all of view_01\.png")


def test_masked_pixels_neither_train_nor_judge(tmp_path):
    write_set("nerfstudio", tmp_path)
    shown = np.full((HEIGHT, WIDTH), 255, np.uint8)
    shown[:, 30:] = 0
    (tmp_path / "masks").mkdir()
    for name in ("view_00", "view_01"):
        Image.fromarray(shown).save(tmp_path / "masks" / f"{name}.png")
    scene, hidden = load_training_scene(tmp_path), torch.from_numpy(shown == 0)
    image = torch.rand(HEIGHT, WIDTH, 3, generator=torch.manual_seed(0), requires_grad=True)
    photograph = scene.photograph(1)
    photometric(scene.unmasked(1, image), Ssim(photograph), photograph).backward()
    assert not image.grad[hidden].any() and image.grad[~hidden].any(dim=-1).float().mean() > 0.9
    assert torch.equal(scene.unmasked(2, image), image)

    model = initial_gaussians(scene, 0)
    plain = evaluate(model, replace(scene, masks=None), [0])
    spoilt = scene.images.copy()
    spoilt[0][shown == 0] = 255 - spoilt[0][shown == 0]
    one, other = (evaluate(model, replace(scene, images=images), [0], hvsq=[lambda photograph: Hvsq(photograph, 1.0)])
                  for images in (scene.images, spoilt))
    assert one.psnr == pytest.approx(other.psnr, abs=1e-4) != pytest.approx(plain.psnr, abs=1e-2)
    left = scene.images[0][shown > 0] / np.float32(255)
    drawn = render(model, scene.cameras[0]).image.clamp(0, 1).numpy()[shown > 0]
    assert one.psnr == pytest.approx(-10 * np.log10(np.mean((left - drawn) ** 2)), abs=1e-3)  # of the pixels that are shown


def test_transparent_photographs_are_composited_over_black(tmp_path):
    write_set("nerfstudio", tmp_path)
    pixels = np.full((HEIGHT, WIDTH, 4), 200, np.uint8)
    pixels[..., 3] = 255
    pixels[2, 3:8, 3] = 51
    Image.fromarray(pixels).save(tmp_path / "images" / "view_01.png")
    image = load_training_scene(tmp_path).images[1]
    assert (image[2, 3:8] == 40).all() and (np.delete(image, 2, axis=0) == 200).all()


@pytest.mark.parametrize("kind", ["colmap", "nerfstudio"])
def test_photographs_of_distorted_lenses(tmp_path, kind):
    write_set(kind, tmp_path)
    c = little_scene()[0][0]
    if kind == "colmap":
        pytest.importorskip("pycolmap")
        (tmp_path / "sparse" / "0" / "cameras.txt").write_text(f"1 SIMPLE_RADIAL {WIDTH} {HEIGHT} {c.fx} {c.cx} {c.cy} 0.1\n")
    else:
        path = tmp_path / "transforms.json"
        path.write_text(json.dumps(json.loads(path.read_text()) | {"k1": 0.1}))
    data = load_dataset(tmp_path)
    scene = load_training_scene(tmp_path)
    assert scene.size == (WIDTH, HEIGHT) and scene.cameras[0].fx > c.fx
    assert np.array_equal(scene.images[2], data.pixels(2)[..., :3]) and scene.images[2].any()


def test_random_points_where_there_are_none(tmp_path):
    write_set("blender", tmp_path)
    scene = load_training_scene(tmp_path)
    assert scene.random_start and len(scene.points) == len(scene.colours) == random_points.COUNT
    assert len(load_training_scene(tmp_path, points_needed=False).points) == 0
    cameras = [scene.cameras[i] for i in scene.train]
    seen = sum(random_points.in_frame(scene.points, camera).astype(int) for camera in cameras)
    assert seen.min() >= len(cameras) / 2
    assert len(initial_gaussians(scene, 0, max_points=500)) == 500
    again = load_training_scene(tmp_path)
    assert np.array_equal(again.points, scene.points) and np.array_equal(again.colours, scene.colours)


@pytest.mark.parametrize("content", [b"", b"not an image", None])
def test_unreadable_photographs(tmp_path, content):
    write_set("llff", tmp_path)
    path = tmp_path / "images_4" / "view_05.png"
    noise = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), dtype=np.uint8)
    Image.fromarray(noise).save(path)
    path.write_bytes(path.read_bytes()[:-1000] if content is None else content)  # None: the header is whole, the rest is not
    reject(tmp_path, r"view_05\.png: is not a readable photograph")


def test_no_data_set(tmp_path):
    reject(tmp_path, "poses_bounds")
    reject(tmp_path / "absent", "does not exist")


def test_first_gaussians(tmp_path):
    write_set("llff", tmp_path)
    scene = load_training_scene(tmp_path)
    g = initial_gaussians(scene, 0)
    assert len(g) == len(scene.points) == 5 and g.sh_rest.shape == (5, 15, 3) and not g.sh_rest.any()
    torch.testing.assert_close(g.means, torch.tensor(scene.points, dtype=torch.float32))
    torch.testing.assert_close(torch.sigmoid(g.opacity), torch.full((5,), OPACITY))
    torch.testing.assert_close(g.sh_dc * SH_C0 + 0.5, torch.tensor(scene.colours, dtype=torch.float32))
    assert torch.equal(g.quats, torch.tensor([1.0, 0, 0, 0]).repeat(5, 1))
    for i, point in enumerate(scene.points):
        distance = np.sort(np.linalg.norm(scene.points - point, axis=1))[1:4].mean()
        eye = min(np.linalg.norm(scene.cameras[k].position - point) for k in scene.train)
        assert g.log_scales[i].exp().numpy() == pytest.approx([min(distance, WIDEST * eye)] * 3, rel=1e-5)


def test_points_out_of_view_are_dropped_and_points_alike_are_finite(tmp_path):
    write_set("llff", tmp_path)
    scene = load_training_scene(tmp_path)
    behind = scene.cameras[1].position + 10 * (scene.cameras[1].position - scene.points.mean(axis=0))
    crowd = replace(scene, points=np.concatenate([np.repeat(scene.points[:1], 6, axis=0), behind[None]]),
                    colours=np.ones((7, 3)))
    g = initial_gaussians(crowd, 0, sh_degree=0)
    assert len(g) == 6 and torch.isfinite(g.log_scales).all() and g.sh_rest.shape == (6, 0, 3)
    with pytest.raises(InputError, match="0 of 4 points"):
        initial_gaussians(replace(scene, points=np.tile(behind, (4, 1)), colours=np.ones((4, 3))), 0)
    for bad in ({"max_points": 3}, {"sh_degree": 4}):
        with pytest.raises(ValueError, match=next(iter(bad))):
            initial_gaussians(scene, 0, **bad)


def test_a_subset_of_the_points_is_drawn_by_the_seed():
    scene = load_training_scene("embedded", (32, 32))
    one, again, other = (initial_gaussians(scene, seed, max_points=100) for seed in (3, 3, 4))
    assert len(one) == 100 and torch.equal(one.means, again.means) and not torch.equal(one.means, other.means)


def test_embedded_photographs_and_points_are_kept(tmp_path, monkeypatch):
    cameras = load_training_scene("embedded", (32, 32)).cameras[:2]

    def equal(one, other):
        return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))

    first = embedded.photographs_and_points(cameras, 50, tmp_path)
    assert first[0].shape == (2, 32, 32, 3) and first[1].shape == first[2].shape == (50, 3)
    assert first[0].std() > 20 and np.array_equal(first[0], load_training_scene("embedded", (32, 32)).images[:2])
    (path,) = tmp_path.iterdir()
    monkeypatch.setattr(embedded.scene, "render_reference", lambda camera: pytest.fail("traced again"))
    assert equal(embedded.photographs_and_points(cameras, 50, tmp_path), first)
    monkeypatch.undo()
    whole = path.read_bytes()
    for broken in (b"", whole[:200], whole[:-100]):
        path.write_bytes(broken)
        assert equal(embedded.photographs_and_points(cameras, 50, tmp_path), first)
    assert path.read_bytes() == whole
    with pytest.raises(InputError, match="31x32"):
        load_training_scene("embedded", (31, 32))


@pytest.mark.data
def test_real_scenes(data_dir):
    pytest.importorskip("pycolmap")
    fern = load_training_scene(data_dir / "posed" / "fern")
    assert fern.size == (504, 378) and (len(fern.test), len(fern.validation), len(fern.train)) == (3, 4, 13)
    assert len(fern.points) == 10091 and 0.9 * len(fern.points) < len(initial_gaussians(fern, 0))
