"""Reports say what was measured: numbers that can be checked, pages made of nothing else, curves that lose nothing."""

import json

import numpy as np
import pytest
from PIL import Image

torch = pytest.importorskip("torch")
pytest.importorskip("matplotlib")

from golden.diff.gaussians import from_model  # noqa: E402
from golden.metrics.image import psnr_vs  # noqa: E402
from golden.oracle.render import render as render_oracle  # noqa: E402
from golden.scenes.load import load_model, load_scene  # noqa: E402
from golden.training import report_machine  # noqa: E402
from golden.training.baselines import SeparateModels  # noqa: E402
from golden.training.foveated import FoveatedModel  # noqa: E402
from golden.training.plots import curves, plot_curves, read_log  # noqa: E402
from golden.training.recipe import models_of  # noqa: E402
from golden.training.report import Trained, numbers, write_report  # noqa: E402
from golden.training.report_text import markdown  # noqa: E402
from golden.training.scene import load_training_scene  # noqa: E402
from spec.errors import InputError  # noqa: E402

SIZE = 48
KEYS = ("psnr_dense", "psnr_l1", "points", "entries_per_frame", "hvsq", "storage", "quantised_loss_db", "seconds")


@pytest.fixture(scope="module")
def scene():
    return load_training_scene("embedded", (SIZE, SIZE))


@pytest.fixture(scope="module")
def results():
    """A chain's results: the embedded model, its larger half, and random levels of that."""
    dense = from_model(load_scene("embedded").model.with_sh_degree(0))
    base = dense.select(torch.argsort(dense.log_scales.sum(1), descending=True)[: len(dense) // 2])
    bound = np.random.default_rng(2).integers(1, 5, len(base))
    model = FoveatedModel.nested(base, bound)
    return {"dense": dense, "prune": base, "finetune": base, **{f"level{k}": model.truncated(k) for k in (2, 3, 4)}}


def trained(results, levels=None, names=None):
    names = names or list(results)
    spent = {name: {"iterations": 10, "seconds": 1.5} for name in results}
    return Trained(results["dense"], levels or results["level4"], models_of(results, names), spent,
                   {"scene": "embedded", "variant": "H", "from": None}, "photographs")


def write_log(folder):
    with open(folder / "log.jsonl", "w") as file:
        for iteration in range(1, 31):
            stage = "dense" if iteration <= 20 else "prune"
            record = {"iteration": iteration, "stage": stage, "loss": 1 / iteration, "points": 100 - iteration}
            record["seconds"] = iteration
            file.write(json.dumps(record | ({"psnr": 20.0 + iteration} if iteration % 5 == 0 else {})) + "\n")


@pytest.fixture(scope="module")
def written(scene, results, tmp_path_factory):
    folder = tmp_path_factory.mktemp("report")
    write_log(folder)
    write_report(trained(results), scene, folder, note=lambda text: None)
    return folder, json.loads((folder / "report.json").read_text())


def test_numbers_are_what_was_measured(written, scene, results):
    _, report = written
    assert all(report[key] is not None for key in KEYS)
    assert report["points"] == {"dense": len(results["dense"]), "levels": list(results["level4"].counts)}
    model = results["finetune"]
    from golden.diff.gaussians import to_model

    oracle = [psnr_vs(render_oracle(to_model(model, up=scene.up, name="l1"), scene.cameras[view]).image,
                      scene.photograph(view).numpy()) for view in scene.test]
    assert report["psnr_l1"] == pytest.approx(np.mean(oracle), abs=1e-3)
    assert report["psnr_dense"] > report["psnr_l1"]
    entries = report["entries_per_frame"]
    assert entries["dense"] > entries["l1"] > entries["foveated"] > 0
    assert report["stages"][0]["entries"] == pytest.approx(entries["dense"], rel=0.02)
    assert abs(report["quantised_loss_db"]) < 0.05
    assert report["machine"]["psnr_float"] == pytest.approx(np.mean(oracle), abs=1e-6)
    assert report["storage"]["total"] == results["level4"].storage.total
    assert [row["stage"] for row in report["stages"]] == ["dense", "prune", "finetune", "level2", "level3", "level4"]
    assert [row["level"] for row in report["stages"]] == [1, 1, 1, 2, 3, 4]
    assert [row["points"] for row in report["stages"][2:]] == list(results["level4"].counts)
    assert report["hvsq"] == [row["hvsq"] for row in report["stages"][2:]]
    assert report["seconds"]["total"] == pytest.approx(9 + report["seconds"]["report"])


def test_regions_cover_the_frame_and_lose_with_eccentricity(written):
    _, report = written
    regions = report["regions"]
    assert sum(row["pixels"] for row in regions) == pytest.approx(1)
    loss = [row["hvsq_foveated"] / row["hvsq_l1"] for row in regions]  # of R1 what its rim blends in, of R4 random levels
    assert 1 < loss[0] < loss[-1] and loss[-1] > 1.2
    assert all(row["hvsq_dense"] < row["hvsq_foveated"] for row in regions)


def test_the_page_is_made_of_the_numbers_alone(written):
    folder, report = written
    page = (folder / "report.md").read_text()
    assert page == markdown(report)
    for path in [*report["pictures"].values(), report["curves"]]:
        assert path in page
    for count in report["points"]["levels"]:
        assert f"{count:,}" in page
    assert f"{report['psnr_l1']:.2f} dB" in page and f"{report['quantised_loss_db']:.4f} dB" in page


def test_pictures_show_what_they_say(written, scene):
    folder, report = written
    images = {name: np.asarray(Image.open(folder / path)).astype(int) for name, path in report["pictures"].items()}
    assert set(images) == {"reference", "dense", "foveated", "difference", "regions", *(f"level {k}" for k in (1, 2, 3, 4))}
    assert all(image.shape == (SIZE, SIZE, 3) for image in images.values())
    assert np.array_equal(images["reference"], scene.images[scene.test[0]])
    expected = np.minimum(4 * np.abs(images["foveated"] - images["reference"]), 255)
    assert np.abs(images["difference"] - expected).max() <= 4  # the picture is rounded once, this twice
    errors = [np.abs(images[f"level {level}"] - images["dense"]).mean() for level in (1, 2, 3, 4)]
    assert errors == sorted(errors) and errors[0] < errors[3]


def test_the_model_is_loaded_again(written, results):
    folder, _ = written
    model = load_model(folder / "model.ply")
    assert model.levels == 4
    assert [(model.quality_bound > level).sum() for level in range(4)] == list(results["level4"].counts)


def test_separate_models_and_one_level_are_reported(scene, results, tmp_path):
    each = SeparateModels(tuple(results["level4"].level(level) for level in range(4)))
    names = ["dense", "prune", "finetune", "level2", "separate2"]
    separate = numbers(trained(results | {"separate2": each.level(1)}, each, names), scene)
    assert separate["storage"]["total"] == each.storage.total
    assert separate["machine"]["foveated_psnr_float"] is None and separate["entries_per_frame"]["foveated"] > 0
    assert [row["level"] for row in separate["stages"]] == [1, 1, 1, 2, 2]
    assert separate["regions"][-1]["hvsq_foveated"] > separate["regions"][-1]["hvsq_l1"]
    assert list(report_machine.model_files(each, scene)) == ["model.ply", *(f"model_l{level}.ply" for level in (1, 2, 3, 4))]

    one = numbers(trained(results, FoveatedModel(results["finetune"]), ["dense", "prune", "finetune"]), scene)
    assert len(one["hvsq"]) == 1 and "foveated" not in one["entries_per_frame"]
    for report in (one, separate):
        page = markdown(report | {"pictures": {"reference": "r.png"}, "curves": "c.png"})
        assert "## Levels" in page and "nan" not in page and "None" not in page


def test_frames_wider_than_the_rows_are_left_to_the_float_renderer(scene, results, monkeypatch):
    from dataclasses import replace

    monkeypatch.setattr(report_machine, "PAPER", replace(report_machine.PAPER, row_width=SIZE - 16))
    report = numbers(trained(results, names=["dense", "finetune"]), scene)
    assert report["quantised_loss_db"] is None and report["machine"] is None
    assert report["entries_per_frame"]["dense"] > report["entries_per_frame"]["l1"]
    assert "wider than the machine's rows" in markdown(report | {"pictures": {}, "curves": "c.png"})


def test_curves_keep_stages_apart_and_average(tmp_path):
    write_log(tmp_path)
    shown = curves(read_log(tmp_path / "log.jsonl"), samples=10)
    assert shown["stages"] == [{"name": "dense", "first": 1, "last": 20}, {"name": "prune", "first": 21, "last": 30}]
    assert shown["iteration"] == [3, 6, 9, 12, 15, 18, 20, 23, 26, 29, 30]
    assert shown["loss"][0] == pytest.approx((1 + 1 / 2 + 1 / 3) / 3)
    assert shown["loss"][6] == pytest.approx((1 / 19 + 1 / 20) / 2)
    assert shown["points"][:2] == [97, 94] and shown["seconds"][-1] == 30
    assert shown["psnr"][:3] == [None, 25.0, None]
    plot_curves(shown, tmp_path / "curves.png")
    picture = np.asarray(Image.open(tmp_path / "curves.png").convert("RGB"))
    blue = (np.abs(picture.astype(int) - [31, 119, 180]).sum(2) < 60).nonzero()[0]
    height = len(picture)
    assert all((blue * 3 // height == third).any() for third in range(3))  # each of the three plots has its curve
    assert json.loads((tmp_path / "curves.json").read_text()) == shown


def test_a_log_that_is_none_is_told(tmp_path):
    (tmp_path / "log.jsonl").write_text("{nothing")
    with pytest.raises(InputError, match="no readable log"):
        read_log(tmp_path / "log.jsonl")
    assert curves([])["iteration"] == curves([])["stages"] == []
