"""Masks of photographs under the names that COLMAP, nerfstudio and gsplat give them."""

import json

import numpy as np
import pytest
from PIL import Image

from golden.scenes.datasets import load_dataset
from golden.scenes.masks import masks_beside, read_mask
from spec.errors import InputError
from tests.golden.scenes.test_datasets import HEIGHT, VIEWS, WIDTH, write_set


@pytest.mark.parametrize("name", ["view_03.png", "view_03.png.png"])
@pytest.mark.parametrize(("kind", "folder"), [
    ("llff", "masks"), ("llff", "masks_4"), ("nerfstudio", "mask"), ("blender", "masks")])
def test_masks_in_a_folder(tmp_path, kind, folder, name):
    write_set(kind, tmp_path)
    assert load_dataset(tmp_path).masks is None
    (tmp_path / folder).mkdir()
    Image.new("L", (WIDTH, HEIGHT), 255).save(tmp_path / folder / name)
    masks = load_dataset(tmp_path).masks
    assert len(masks) == VIEWS and masks[3] == tmp_path / folder / name and masks[:3] + masks[4:] == (None,) * (VIEWS - 1)


def test_masks_of_photographs_in_folders_and_of_other_suffixes(tmp_path):
    (tmp_path / "masks" / "left").mkdir(parents=True)
    Image.new("L", (3, 3)).save(tmp_path / "masks" / "left" / "a.png")
    assert masks_beside(tmp_path, ["left/a.jpg", "right/a.jpg"]) == (tmp_path / "masks" / "left" / "a.png", None)
    with pytest.raises(InputError, match=r"masks: has no mask of b\.jpg, nor of any other photograph; b\.jpg\.png"):
        masks_beside(tmp_path, ["b.jpg"])


def test_masks_that_a_transforms_json_names(tmp_path):
    write_set("nerfstudio", tmp_path)
    path = tmp_path / "transforms.json"
    meta = json.loads(path.read_text())
    meta["frames"][0]["mask_path"] = "m/last.png"  # the file goes backwards: this is the last photograph
    path.write_text(json.dumps(meta))
    assert load_dataset(tmp_path).masks == (None,) * (VIEWS - 1) + (tmp_path / "m" / "last.png",)


def test_reading_a_mask(tmp_path):
    path = tmp_path / "mask.png"
    grey = np.zeros((4, 6), np.uint8)
    grey[1:, 2:] = 255
    Image.fromarray(grey).save(path)
    assert np.array_equal(read_mask(path, 6, 4), grey > 0)
    assert np.array_equal(read_mask(path, 12, 8), (grey > 0).repeat(2, axis=0).repeat(2, axis=1))
    with pytest.raises(InputError, match=r"mask\.png: is 6x4, its photograph 6x9"):
        read_mask(path, 6, 9)
    path.write_bytes(b"nothing")
    with pytest.raises(InputError, match=r"mask\.png: is not a readable mask"):
        read_mask(path, 6, 4)
    with pytest.raises(InputError, match="absent"):
        read_mask(tmp_path / "absent.png", 6, 4)
