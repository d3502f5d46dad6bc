"""The sweep of accuracy against time: what follows from points, what travels and is kept, and a small sweep end to end."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace

import numpy as np
import pytest

from golden.metrics.image import psnr
from msv2.studies.tradeoff import choose, hard, knobs, tables, training
from msv2.studies.tradeoff import study as command
from msv2.studies.tradeoff.jobs import run_all
from msv2.studies.tradeoff.scene import SceneRequest
from spec.config import PRESETS, V3
from spec.constants import SUPPORT_SIGMA
from spec.errors import InputError
from spec.formats import UQ
from spec.paths import ROOT


def row(knob: str, value: str = "", *, cycles: float = 100.0, photo: float | None = 25.0, oracle: float = 70.0,
        hvsq: float | None = 1e-5, bits: int = 500, broken: tuple[str, ...] = (), **more: object) -> dict:
    return {"knob": knob, "value": value, "cycles": cycles, "psnr_photo_db": photo, "psnr_oracle_db": oracle, "hvsq": hvsq,
            "word_bits": bits, "broken": dict.fromkeys(broken, "why"), "threshold_deg": None, "variant": "", "parts": [],
            **more}


def test_frontier_is_what_no_point_beats():
    points = [(3.0, 1.0), (1.0, 5.0), (2.0, 5.0), (2.0, 2.0), (3.0, 1.0), (9.0, 0.5), (8.0, 3.0)]
    beaten = [any(q != p and q[0] <= p[0] and q[1] <= p[1] for q in points) for p in points]
    found = choose.pareto(points)
    assert {points[i] for i in found} == {p for p, lost in zip(points, beaten, strict=True) if not lost}
    assert found == [1, 3, 0, 5]


def test_loss_without_photographs_is_that_of_uncorrelated_errors():
    rng = np.random.default_rng(1)
    photograph = rng.random((64, 64, 3)) * 0.5 + 0.25
    model = photograph + rng.normal(0, 0.03, photograph.shape)
    shown = model + rng.normal(0, 0.01, photograph.shape)
    told = choose.uncorrelated_psnr(psnr(shown, model), psnr(model, photograph))
    assert told == pytest.approx(psnr(shown, photograph), abs=0.05)


def test_losses_count_from_the_default_and_two_eyes_from_both_rendered():
    rows = [row("default"), row("a", photo=24.9, cycles=50.0), row("lucky", photo=26.0, oracle=25.0),
            row("ecc", photo=24.0, threshold_deg=knobs.BOTH_RENDERED), row("ecc", photo=23.5, hvsq=2e-5, threshold_deg=18.0),
            row("bad", error="ValueError: no", psnr_photo_db=None)]
    choose.with_losses(rows)
    assert rows[1]["loss_db"] == pytest.approx(0.1) and rows[1]["speedup"] == 2
    assert rows[2]["loss_db"] == pytest.approx(10 * math.log10(2), abs=1e-3)  # nearer the photographs, as far from the model
    assert rows[4]["loss_db"] == pytest.approx(0.5) and rows[4]["hvsq_change"] == pytest.approx(1.0)
    assert rows[5]["loss_db"] is None


def test_what_breaks_a_hard_case_is_neither_recommended_nor_on_the_frontier():
    rows = [row("default"), row("quick", "1", cycles=10.0, broken=("06-needle",)), row("words", "4", bits=400, photo=24.995),
            row("words", "2", bits=300, photo=24.0), row("sh", "0", cycles=60.0, photo=24.95)]
    choose.with_losses(rows)
    choose.frontier(rows)
    assert [r["pareto"] for r in rows] == [True, False, False, False, True]
    found = {b.name: choose.recommended(rows, b) for b in choose.BUDGETS}
    assert found["0.01 dB"] is rows[2] and found["0.1 dB"] is rows[4]
    assert choose.candidate_parts(rows, choose.BUDGETS[1]) == [("words", "4"), ("sh", "0")]


def test_of_settings_as_fast_and_long_the_one_with_fewer_harmonics_is_taken_and_presets_are_no_settings():
    rows = [row("default", functions=15), row("preset", "fast", cycles=10.0),
            row("tile test", "OBB", cycles=20.0, in_rtl=False), row("sh", "2", cycles=60.0, functions=8),
            row("sh", "1", cycles=60.05, photo=24.96, functions=3)]
    choose.with_losses(rows)
    choose.frontier(rows)
    assert choose.recommended(rows, choose.BUDGETS[0]) is rows[3] and choose.recommended(rows, choose.BUDGETS[1]) is rows[4]
    assert [r["pareto"] for r in rows] == [False, False, False, True, False]


def test_presets_are_the_recommendations_of_the_report():
    content = json.loads((ROOT / "reports" / "tradeoff.json").read_text())
    assert content["presets"] == {b.preset: b.name for b in choose.BUDGETS if b.preset}
    for name, budget in content["presets"].items():
        parts = content["recommended"][budget]["parts"]
        setting = knobs.combined(name, [tuple(part) for part in parts], 3, content["levels"])
        formats = setting.config.formats
        # The report is older than case 76, which a depth key of 22 bits breaks.
        formats = replace(formats, depth_key=UQ(max(23, formats.depth_key.int_bits), 0))
        assert formats == PRESETS[name].formats, name
        assert (3 if setting.sh_degree is None else setting.sh_degree) == PRESETS[name].sh_degree, name
        assert PRESETS[name].with_(name=V3.name, formats=V3.formats, sh_degree=3) == V3


def test_every_word_length_of_the_sweep_is_one_that_machines_take():
    for knob, values in knobs.WORDS.items():
        for change in values.values():
            assert change(knobs.Setting()).config != knobs.BASE, knob


def test_every_setting_is_one_change_of_a_machine_that_can_be():
    settings = knobs.single(3, "4, untrained", ["M"])
    assert settings[0] == knobs.Setting() and len({s.name for s in settings}) == len(settings)
    assert {"preset", "levels", "ecc_thresh", "support radius", "SH degree", "tile test", "variant", *knobs.WORDS} == {
        s.knob for s in settings[1:]}
    for setting in settings[1:]:
        same = replace(setting, knob="default", value="", config=setting.config.with_(name=knobs.BASE.name))
        assert same != knobs.Setting(), setting.name
    both = knobs.combined("x", [("conic significand", "12"), ("SH degree", "1")], 3, "4, untrained")
    assert both.config.formats.conic.sig_bits == 12 and both.sh_degree == 1
    shorter = 4 + 4 + 3 * 3  # its factor, and three sums of the exponent
    assert knobs.word_bits(both.config) == knobs.word_bits(knobs.BASE) - shorter


def test_a_key_without_octaves_breaks_hard_cases_and_the_default_none():
    assert hard.hard_cases(knobs.Setting())["broken"] == {}
    short = knobs.applied("depth key bits", "20", knobs.WORDS["depth key bits"]["20"])
    assert hard.hard_cases(short)["broken"]


def test_rims_are_allowed_what_their_radius_shows():
    setting = replace(knobs.Setting(), config=knobs.BASE.with_(support_sigma=2.0))
    assert hard.rim_of(hard.RIM, setting) == pytest.approx(hard.RIM * math.exp(-2.0) / math.exp(-SUPPORT_SIGMA**2 / 2))
    assert hard.rim_of(hard.RIM / 2, setting) == hard.RIM / 2 and hard.rim_of(hard.RIM, knobs.Setting()) == hard.RIM


def test_work_is_done_in_processes_alike_and_a_cluster_without_dask_is_refused(monkeypatch):
    calls = [(float(i),) for i in range(4)]
    assert dict(run_all(math.sqrt, calls)) == dict(run_all(math.sqrt, calls, jobs=2)) == {i: math.sqrt(i) for i in range(4)}
    monkeypatch.setattr("msv2.studies.tradeoff.jobs.find_spec", lambda name: None)
    with pytest.raises(InputError, match="Dask is not installed"):
        list(run_all(math.sqrt, calls, scheduler="tcp://127.0.0.1:1"))
    with pytest.raises(InputError, match="jobs 0"):
        list(run_all(math.sqrt, calls, jobs=0))


@pytest.mark.parametrize(("argv", "message"), [
    (["--knob", "colours"], "knob 'colours'"), (["--variant", "M"], "variant"), (["--size", "wide"], "size 'wide'"),
    (["--views", "9"], "views 9"), (["--units-per-metre", "0"], "units per metre")])
def test_bad_input_is_named(argv, message, tmp_path):
    with pytest.raises(InputError, match=message):
        command.main(["--size", "64x48", "--views", "1", *argv, "--out", str(tmp_path), "--work", str(tmp_path)])


@pytest.mark.long
def test_a_small_sweep_is_kept_and_goes_on(tmp_path, monkeypatch):
    argv = ["--size", "64x48", "--views", "1", "--jobs", "1", "--knob", "SH degree", "--runs", str(tmp_path),
            "--out", str(tmp_path / "out"), "--work", str(tmp_path / "kept")]
    assert command.main(argv) == 0
    content = json.loads((tmp_path / "out" / "tradeoff.json").read_text())
    default, *degrees = content["machine"]
    assert [r["value"] for r in degrees[:3]] == ["0", "1", "2"] and default["loss_db"] == 0
    assert default["cycles"] > degrees[0]["cycles"] and degrees[0]["psnr_oracle_db"] < default["psnr_oracle_db"]
    assert [r["name"] for r in content["simulation"]["rows"]] == ["oracle", "float kernel", "integer golden", "cycle model"]
    assert content["simulation"]["rows"][2]["psnr_oracle_db"] > 45
    with open(tmp_path / "out" / "tradeoff_machine.csv", newline="") as file:
        assert [float(r["cycles"]) for r in csv.DictReader(file)] == [r["cycles"] for r in content["machine"]]
    page = (tmp_path / "out" / "tradeoff.html").read_text()
    assert tables.recommendation(content).splitlines()[2].split("|")[2].strip() in page
    monkeypatch.setattr(command, "run_all", lambda work, calls, **_: iter(()) if not calls else pytest.fail("again"))
    assert command.main(argv) == 0


def test_training_is_read_of_finished_runs(tmp_path):
    stage = {"level": 1, "entries": 5.0, "psnr": 20.0, "ssim": 0.5, "hvsq": 1e-5, "seconds": 2.0}
    made = {"options": {"scene": "x/fern", "variant": "H", "iterations": 30}, "size": [64, 48],
            "stages": [{"stage": "dense", "iterations": 10, "points": 9, **stage},
                       {"stage": "prune", "iterations": 20, "points": 4, **stage}]}
    for name, content in (("fern", made), ("broken", {"options": {}})):
        (tmp_path / name).mkdir()
        (tmp_path / name / "report.json").write_text(json.dumps(content))
    curve = {"iteration": [5, 10, 15], "psnr": [10.0, None, 30.0], "points": [9, 9, 4], "seconds": [1, 2, 3]}
    (tmp_path / "fern" / "curves.json").write_text(json.dumps(curve))
    runs = training.runs([tmp_path, tmp_path])
    assert len(runs) == 1 and [s["iterations"] for s in runs[0]["stages"]] == [10, 30]
    assert runs[0]["curve"]["iteration"] == [5] and runs[0]["stages"][1]["seconds"] == 4


def test_a_request_names_its_variants():
    args = command.parse_arguments(["--variant", "M=a/b", "--variant", "L=c"])
    assert command.scene_request(args) == SceneRequest(
        "embedded", "192x108", 2, (("M", "a/b"), ("L", "c")), 1.0, "build/tradeoff/kept")
