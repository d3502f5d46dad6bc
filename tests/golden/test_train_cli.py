"""golden/train.py as a user meets it: a run, an interrupt and its resume, bad input, what is written."""

import json
import re
import shlex
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from spec.paths import ROOT

torch = pytest.importorskip("torch")

from golden.diff.gaussians import from_model  # noqa: E402
from golden.metrics.level_pooling import LevelPooling  # noqa: E402
from golden.scenes.embedded.scene import cached_embedded_model, embedded_cameras  # noqa: E402
from golden.scenes.load import load_model, load_scene  # noqa: E402
from golden.scenes.save import save_model  # noqa: E402
from golden.train import main, parse_arguments  # noqa: E402
from golden.training import chain as chain_module  # noqa: E402
from golden.training import dense as dense_module  # noqa: E402
from golden.training import run as run_module  # noqa: E402
from golden.training.checkpoint import Checkpoints  # noqa: E402
from golden.training.evaluate import evaluate  # noqa: E402
from golden.training.recipe import RESULTS, Recipe, full_points, plan  # noqa: E402
from golden.training.scene import load_training_scene  # noqa: E402
from spec.errors import InputError  # noqa: E402

TINY = ("--size", "48x48", "--iterations", "20", "--max-points", "300", "--device", "cpu")


def train(*argv: object) -> int:
    return main([str(a) for a in argv])


@pytest.fixture
def unreported(monkeypatch):
    """Runs end with model.ply and no report, whose renderers take long to compile."""
    def write_report(trained, scene, folder, note):
        save_model(trained.levels.to_model(up=scene.up, name=scene.name), folder / "model.ply")
        return {"psnr_dense": 0.0, "psnr_l1": 0.0, "seconds": {"total": 0.0}}

    monkeypatch.setattr(run_module, "write_report", write_report)


@pytest.fixture
def interrupts(monkeypatch):
    """Iterations of the whole run after which Ctrl-C is pressed, each once."""
    due = []
    real = chain_module.Chain._check

    def check(self, stage, record):
        real(self, stage, record)
        if due and due[0] == self.iteration:
            due.pop(0)
            signal.raise_signal(signal.SIGINT)

    monkeypatch.setattr(chain_module.Chain, "_check", check)
    return due


@pytest.fixture
def model(tmp_path) -> Path:
    """A dense model as PLY: the larger splats of the embedded one."""
    whole = load_scene("embedded").model
    path = tmp_path / "dense.ply"
    save_model(whole.select(np.argsort(-whole.log_scales.sum(1))[:600]), path)
    return path


def results(folder: Path) -> dict:
    return Checkpoints(folder / "checkpoints", RESULTS).load().results


def test_interrupted_in_every_stage_and_resumed_is_the_uninterrupted_run(tmp_path, unreported, interrupts, capsys):
    assert train(*TINY, "--out", tmp_path / "whole") == 0
    interrupts += [4, 9, 13, 18, 19, 21]  # in dense, at its end, in prune, at the end of fine-tuning, of level 2, of all
    assert train(*TINY, "--out", tmp_path / "parts") == 130
    told = capsys.readouterr().err
    assert "interrupted at iteration 4, in dense; go on with: python golden/train.py" in told
    command = shlex.split(told.strip().splitlines()[-1].partition("go on with: python golden/train.py ")[2])
    for _ in range(5):
        assert train(*command) == 130
    assert not interrupts
    assert train(*command) == 0
    assert (tmp_path / "parts" / "model.ply").read_bytes() == (tmp_path / "whole" / "model.ply").read_bytes()
    whole, parts = results(tmp_path / "whole"), results(tmp_path / "parts")
    assert whole.keys() == parts.keys() == {"dense", "prune", "finetune", "level2", "level3", "level4"}
    for left, right in ((whole[name], parts[name]) for name in ("dense", "prune", "finetune")):
        assert all(torch.equal(a, b) for a, b in zip(left.tensors().values(), right.tensors().values(), strict=True))
    log = [json.loads(line) for line in (tmp_path / "parts" / "log.jsonl").read_text().splitlines()]
    assert [record["iteration"] for record in log] == list(range(1, 22))
    assert {record["stage"] for record in log} == set(whole)


def test_resume_refuses_other_options_by_name(tmp_path, unreported, interrupts):
    interrupts += [2]
    assert train(*TINY, "--out", tmp_path) == 130
    for option, named in ((("--variant", "M"), "variant 'M'.*variant 'H'"), (("--seed", "1"), "seed 1.*seed 0"),
                          (("--no-opacity-enhancement",), "opacity-enhancement False.*opacity-enhancement True"),
                          (("--size", "64x64"), "size '64x64'.*size '48x48'"), (("--baseline", "smfr"), "baseline 'smfr'"),
                          (("--iterations", "21"), "iterations 21.*iterations 20")):
        with pytest.raises(InputError, match=f"--resume with {named}"):
            train(*TINY, *option, "--resume", "--out", tmp_path)
    with pytest.raises(InputError, match="stopped at iteration 2; go on with it by --resume"):
        train(*TINY, "--out", tmp_path)


def test_a_loss_of_nan_stops_with_status_1_and_keeps_the_checkpoint(tmp_path, unreported, monkeypatch, capsys):
    real, calls = dense_module.photometric, []

    def photometric(*arguments):
        calls.append(1)
        return real(*arguments) * (float("nan") if len(calls) == 5 else 1)

    monkeypatch.setattr(dense_module, "photometric", photometric)
    assert train(*TINY, "--out", tmp_path) == 1
    told = capsys.readouterr().err
    assert re.search(r"error: dense: stopped after iteration 5 \(\d of the stage, view \d+\): the loss is nan; "
                     r"the last checkpoint is intact: .*iteration_000000000_00.pt", told)
    assert train(*TINY, "--resume", "--out", tmp_path) == 0


def test_a_trained_model_takes_the_place_of_dense_training(tmp_path, unreported, model):
    assert train(*TINY[:4], "--from", model, "--out", tmp_path / "out") == 0
    dense = results(tmp_path / "out")["dense"]
    assert np.allclose(dense.means.numpy(), load_model(model).means, atol=1e-6)
    log = (tmp_path / "out" / "log.jsonl").read_text()
    assert '"dense"' not in log and '"prune"' in log
    other = load_model(model)
    save_model(replace(other, opacity=other.opacity * 0.5), model)
    with pytest.raises(InputError, match=r"--resume with from 'dense.ply \(sha256"):
        train(*TINY[:4], "--from", model, "--resume", "--out", tmp_path / "out")


def test_the_dense_model_of_a_run_serves_another_variant(tmp_path, unreported, interrupts):
    interrupts += [2]
    assert train(*TINY, "--out", tmp_path / "H") == 130
    with pytest.raises(InputError, match="H: dense training has not ended"):
        train(*TINY[:4], "--from", tmp_path / "H", "--out", tmp_path / "M")
    interrupts.clear()
    assert train(*TINY, "--resume", "--out", tmp_path / "H") == 0
    assert train(*TINY[:4], "--from", tmp_path / "H", "--variant", "M", "--out", tmp_path / "M") == 0
    first, second = (results(tmp_path / name)["dense"] for name in "HM")
    assert all(torch.equal(ours, first.tensors()[name]) for name, ours in second.tensors().items())
    assert '"dense"' not in (tmp_path / "M" / "log.jsonl").read_text()
    with pytest.raises(InputError, match=r"out .*H' is not accepted: --from reads the run in this folder"):
        train(*TINY[:4], "--from", tmp_path / "H", "--out", tmp_path / "H")
    assert torch.equal(results(tmp_path / "H")["dense"].means, first.means)  # the refused run left the other as it was


def inria_folder(tmp_path: Path, count: int = 12) -> Path:
    """cameras.json as INRIA's trainer writes it, and no photographs."""
    folder = tmp_path / "trained"
    folder.mkdir()
    entries = [{
        "id": i, "img_name": camera.name, "width": camera.width, "height": camera.height, "fx": camera.fx, "fy": camera.fy,
        "position": camera.position.tolist(), "rotation": camera.rotation.T.tolist()} for i, camera in
        enumerate(embedded_cameras(64, 64, count))]
    (folder / "cameras.json").write_text(json.dumps(entries))
    return folder


def test_cameras_without_photographs_are_taught_by_the_dense_model(tmp_path, unreported, model):
    folder = inria_folder(tmp_path)
    dense = run_module.loaded_dense(model, "cpu")
    scene, references = run_module.chosen_scene(str(folder), (48, 48), dense)
    assert references == "renders of the dense model" and len(scene) == 12 and scene.size == (48, 48)
    assert scene.up[2] > 0.8
    assert evaluate(dense, scene, scene.test).psnr > 50  # but for the 8 bits
    assert train(folder, *TINY[:4], "--from", model, "--out", tmp_path / "out") == 0
    with pytest.raises(InputError, match="at least 3 are needed"):
        run_module.chosen_scene(str(inria_folder_of_two(tmp_path)), None, dense)
    with pytest.raises(InputError, match="has none of"):
        train(folder, "--out", tmp_path / "other")  # nothing to train on without a model


def inria_folder_of_two(tmp_path: Path) -> Path:
    (tmp_path / "two").mkdir()
    return inria_folder(tmp_path / "two", count=2)


@pytest.mark.parametrize(("argv", "message"), [
    (["--variant", "X"], "variant 'X' is not accepted: choose one of H, M, L"),
    (["--baseline", "best"], "baseline 'best' is not accepted: choose one of ce, smfr, mmfr, count, importance, "
     "speedy, pup, compact, lightgs"),
    (["--size", "64"], "size '64'"), (["--size", "16x16"], "size 16x16"), (["--iterations", "0"], "iterations 0"),
    (["--iterations", "19"], "iterations 19 is not accepted: 20 or more is"), (["--max-points", "3"], "max-points 3"),
    (["--gate", "ssim"], "gate 'ssim' is not accepted: choose one of psnr, both"),
    (["--dense", "sparse"], "dense 'sparse' is not accepted: choose one of adc, minisplatting"),
    (["--from", "missing.ply", "--dense", "minisplatting"], "dense 'minisplatting' is not accepted together with --from"),
    (["--pooling", "disc"], "pooling 'disc' is not accepted: choose one of blocks, box"),
    (["--pooling-width", "0"], "pooling-width 0 is not accepted"),
    (["--seed", "-1"], "seed -1"), (["--device", "tpu"], "device 'tpu' is not accepted: auto, cpu, cuda are"),
    (["--from", "missing.ply"], "missing.ply: does not exist"), (["missing"], "missing: does not exist"),
    (["--from", "missing.ply", "--max-points", "9"], "max-points is not accepted together with --from"),
    (["--size", "64x64", "--resume"], "holds no checkpoint to resume from"),
])
def test_bad_input_names_the_value(tmp_path, argv, message):
    with pytest.raises(InputError, match=re.escape(message)):
        train(*argv, "--out", tmp_path / "out")


def test_no_cuda_no_torch_no_folder(tmp_path, monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(InputError, match="device cuda cannot be used"):
        train("--device", "cuda")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="output folder"):
        train(*TINY, "--out", tmp_path / "file")
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(InputError, match="needs torch"):
        train()


def scene_model():
    """A few Gaussians of the embedded scene."""
    return from_model(cached_embedded_model(200))


def test_recipes(tmp_path):
    scene = load_training_scene("embedded", (48, 48))
    default = Recipe("H", None, True, 1000, 500, 0)

    def names(recipe, **given):
        return [stage.name for stage in plan(recipe, scene, "cpu", **given)]

    ours = ["dense", "prune", "finetune", "level2", "level3", "level4"]
    assert names(default) == ours
    assert all(names(replace(default, baseline=name)) == ours[:3] for name in (
        "count", "importance", "speedy", "pup", "compact"))
    assert names(replace(default, baseline="lightgs")) == ours[:2]
    assert names(replace(default, baseline="smfr")) == [*ours, "smfr"]
    assert names(replace(default, baseline="mmfr")) == [*ours, "separate2", "separate3", "separate4"]
    paper = replace(default, baseline="ce")
    assert names(paper) == ours and [
        stage.make({name: scene_model() for name in ("dense", "finetune")}).options.criterion
        for recipe in (default, paper) for stage in plan(recipe, scene, "cpu") if stage.name in ("prune", "level2")] == [
        "removal_per_tile", "removal", "ce", "ce"]
    assert sum(stage.total for stage in plan(default, scene, "cpu")) == 1000
    assert all(stage.total >= 1 for stage in plan(replace(default, iterations=20), scene, "cpu"))
    assert [run_module.run_name("fern", r) for r in (
        default, replace(default, variant="M"), replace(default, baseline="smfr", enhancement=False))] == [
        "fern", "fern-M", "fern-smfr-v1"]
    mini = replace(default, dense="minisplatting")
    assert run_module.run_name("fern", mini) == "fern-minisplatting" and names(mini) == ours
    dense = plan(mini, scene, "cpu")[0].make({}).options
    assert dense == replace(plan(default, scene, "cpu")[0].make({}).options, blurred=2e-4, reinitialised=(1 / 6, 1 / 3))
    other = replace(default, pooling_width=400, windows="box", gate="both")
    assert default.pooling == LevelPooling(1237, "blocks") and other.pooling == LevelPooling(400, "box")
    assert run_module.run_name("fern", other) == "fern-pooled400-box-ssim"
    stages = {planned.name: planned.make({"prune": scene_model(), "dense": scene_model(), "finetune": scene_model()})
              for planned in plan(other, scene, "cpu") if planned.name in ("prune", "finetune", "level2")}
    assert stages["finetune"].pooling == stages["level2"].options.pooling == other.pooling
    assert stages["prune"].options.gate == "both" and stages["finetune"]._gate.reads_ssim


def test_pruning_has_time_for_twenty_passes():
    """20 passes of 10 % leave 12 % of the points: as many intervals fit twice, whatever the number of iterations."""
    for iterations in (1000, 8000, 30_000):
        options = Recipe("H", None, True, iterations, 500, 0).prune_options()
        assert options.iterations >= 2 * 20 * options.interval


def test_full_runs_have_a_point_and_a_half_a_pixel():
    assert [full_points(size) for size in ((256, 256), (504, 378), (400, 266))] == [100_000, 285_000, 160_000]
    full = run_module.chosen_recipe(parse_arguments(["--full"]))
    assert full.iterations > run_module.chosen_recipe(parse_arguments([])).iterations
    assert run_module.chosen_recipe(parse_arguments(["--full", "--iterations", "70"])).iterations == 70


def test_the_cap_of_a_full_run_follows_the_frames(tmp_path, unreported, monkeypatch):
    seen = []
    monkeypatch.setattr(run_module, "plan", lambda recipe, *rest: seen.append(recipe) or plan(recipe, *rest))
    assert train("--size", "64x48", "--iterations", "20", "--full", "--device", "cpu", "--out", tmp_path / "a") == 0
    assert train(*TINY, "--full", "--out", tmp_path / "b") == 0
    assert [recipe.max_points for recipe in seen] == [full_points((64, 48)), 300]


@pytest.mark.parametrize("argv", [
    [], ["scene dir", "--variant", "L", "--size", "50x40", "--no-opacity-enhancement"],
    ["a", "--from", "b.ply", "--baseline", "mmfr", "--seed", "4", "--device", "cpu", "--iterations", "99"],
    ["--max-points", "77"], ["--ship", "--views", "12"],
    ["--full", "--gate", "both", "--pooling", "box", "--pooling-width", "400"],
])
def test_the_command_to_resume_asks_for_the_same(argv):
    args = parse_arguments(argv)
    command = shlex.split(run_module.resume_command(args, Path("x y")))
    again = parse_arguments(command[2:])
    assert vars(again) == vars(args) | {"resume": True, "out": "x y"}


def test_help_and_make_dispatch():
    def output(*command):
        return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout

    text = output(sys.executable, "golden/train.py", "--help")
    assert "python golden/train.py fern/ --resume" in text and "--no-opacity-enhancement" in text
    made = output("make", "-n", "train", "SCENE=a b", "VARIANT=M", "FROM=d.ply", "BASELINE=smfr", "SIZE=64x48", "ITERATIONS=50",
                  "DEVICE=cpu", "RESUME=1", "OUT=o")
    line = next(line for line in made.replace("\\\n", " ").splitlines() if "msv2 train" in line)
    args = parse_arguments(shlex.split(line.partition("msv2 train")[2]))
    assert (args.scene, args.variant, args.source, args.baseline) == ("a b", "M", "d.ply", "smfr")
    assert (args.size, args.iterations, args.device, args.resume, args.out) == ("64x48", 50, "cpu", True, "o")


@pytest.mark.long
@pytest.mark.parametrize("baseline", [None, "smfr", "mmfr", "count", "lightgs"])
def test_a_whole_run_renders_through_the_golden_renderer(tmp_path, baseline):
    given = ["--size", "64x64", "--iterations", "300", "--max-points", "2000", "--out", tmp_path / "out"]
    assert train(*given, *(["--baseline", baseline] if baseline else [])) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["psnr_dense"] > 15 and report["psnr_l1"] > (0.8 if baseline == "lightgs" else 0.97) * report["psnr_dense"]
    assert abs(report["quantised_loss_db"]) < 0.05
    assert report["entries_per_frame"]["l1"] < report["entries_per_frame"]["dense"]
    for name in ("report.md", "curves.png", "curves.json", "log.jsonl", "pictures/foveated.png"):
        assert (tmp_path / "out" / name).stat().st_size > 0
    levels = load_model(tmp_path / "out" / "model.ply").levels
    assert levels == (4 if baseline in (None, "smfr") else 1)
    rendered = subprocess.run(
        [sys.executable, "golden/render.py", str(tmp_path / "out" / "model.ply"), "--size", "64x64", "--compare", "oracle",
         "--out", str(tmp_path / "frame"), *(["--gaze", "32,32"] if levels == 4 else [])],
        cwd=ROOT, capture_output=True, text=True)
    assert rendered.returncode == 0, rendered.stderr
    stats = json.loads((tmp_path / "frame" / "stats.json").read_text())
    assert stats["levels"] == levels and stats["psnr_vs_oracle_db"] > 40
    assert train(*given, *(["--baseline", baseline] if baseline else []), "--resume") == 0  # makes the report again
