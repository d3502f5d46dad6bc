"""Training tables: rows, verdicts, the stages they need, plots and pages."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from spec.paths import ROOT

torch = pytest.importorskip("torch")

from golden.metrics.level_pooling import LevelPooling  # noqa: E402
from golden.training.baselines import smfr  # noqa: E402
from golden.training.chain import Planned  # noqa: E402
from golden.training.evaluate import evaluate  # noqa: E402
from golden.training.masks import WAIT, WEIGHT  # noqa: E402
from golden.training.prune_baselines import BASELINES as CRITERIA  # noqa: E402
from golden.training.pruning import OURS  # noqa: E402
from golden.training.recipe import ReadyStage, Recipe  # noqa: E402
from msv2.studies.training import (  # noqa: E402
    ablation,
    comparison,
    labels,
    latency,
    pruning_table,
    study,
    table_runs,
    tables,
)
from msv2.studies.training.frame_work import FrameWork  # noqa: E402
from msv2.studies.training.level_curves import LevelCurve, level_curves  # noqa: E402
from msv2.studies.training.rtl_cycles import RtlCycles  # noqa: E402
from msv2.studies.training.tables_text import markdown  # noqa: E402
from msv2.studies.training.tables_text import pruning_table as pruning_text  # noqa: E402
from msv2.studies.training.targets_text import equal_target, targets_rows  # noqa: E402
from spec.errors import InputError  # noqa: E402
from tests.helpers.training_samples import small_dense, small_scene  # noqa: E402

sys.path.insert(0, str(ROOT))

from msv2.studies.results.tables import fill  # noqa: E402

RECIPE = Recipe("H", None, True, 60, 1500, 0)


@pytest.fixture(scope="module")
def scene():
    return small_scene()


@pytest.fixture(scope="module")
def dense():
    return small_dense(600)


def test_comparison_rows(scene, dense):
    ours = smfr(dense, (600, 300, 120, 60), seed=1)
    plain = smfr(dense, (600, 400, 240, 60), seed=1)
    methods = {labels.OURS: ours, labels.PLAIN: plain}
    rows = comparison.compare(replace(scene, test=scene.test[:1]), methods, {"ours": 3.0}, LevelPooling())
    assert [row.method for row in rows] == [labels.OURS, labels.PLAIN]
    assert rows[0].points_percent == (100.0, 50.0, 20.0, 10.0) and rows[0].seconds == 3.0
    assert comparison.fewer_percent(*rows) == pytest.approx((0.0, 25.0, 50.0, 0.0))
    assert rows[0].storage_mb == ours.storage.total / 1e6
    assert rows[0].hvsq[0] == rows[1].hvsq[0] > 0 and len(rows[0].hvsq) == len(rows[0].hvsq_validation) == 4
    assert rows[0].hvsq_validation[0] != rows[0].hvsq[0]
    assert rows[0].hvsq == rows[0].hvsq_by_kind["blocks"] and rows[0].hvsq[3] != rows[0].hvsq_by_kind["box"][3]
    assert rows[0].points_per_pixel == pytest.approx([count / 64**2 for count in (600, 300, 120, 60)])
    assert rows[0].frame.entries < rows[1].frame.entries


def test_ablation_rows(scene, dense):
    few = dense.select(torch.arange(0, 600, 2))
    levels = smfr(few, (300, 200, 100, 50))
    rows = ablation.ablate(replace(scene, test=scene.test[:1]), (("dense", dense), ("few", few), ("levels", levels)))
    assert [row.points for row in rows] == [600, 300, 300] and rows[0].points_per_pixel == 600 / 64**2
    assert rows[0].psnr_gate == evaluate(dense, scene, scene.validation).psnr != rows[0].psnr
    assert rows[1].psnr == rows[2].psnr != rows[0].psnr
    assert rows[0].frame.entries > rows[1].frame.entries > rows[2].frame.entries
    assert rows[1].storage_mb == rows[0].storage_mb / 2 < rows[2].storage_mb


def test_versions_lose_points_and_the_dense_frame_is_measured_once(scene, dense):
    measured = []

    def rtl(model, camera):
        measured.append((len(model), camera.width, camera.height))
        return RtlCycles(10 * len(model), 100, 7)

    versions = latency.measure(dense, scene, edge=32, removed=(0.0, 0.5, 1.0), rtl=rtl)
    assert [(v.criterion, v.points) for v in versions] == [
        ("importance", 600), ("importance", 300), ("importance", 1), ("ce", 600), ("ce", 300), ("ce", 1)]
    assert measured == [(600, 32, 32), (300, 32, 32), (1, 32, 32), (300, 32, 32), (1, 32, 32)]
    assert versions[0].work == versions[3].work and versions[0].rtl == versions[3].rtl
    assert versions[1].work.entries != versions[4].work.entries
    assert versions[0].work.cycles > versions[1].work.cycles > versions[2].work.cycles


def versions_of(rows):
    """Versions of (points, entries, cycles by the model, RTL cycles)."""
    return [latency.Version("ce", 0.0, points, FrameWork(points, entries, 4, cycles, 0),
                            None if rtl is None else RtlCycles(rtl, 0, entries)) for points, entries, cycles, rtl in rows]


def test_proportionality_in_closed_form():
    result = latency.proportionality(versions_of([(100, 40, 400, 1000), (50, 20, 200, 1000), (25, 30, 300, 1000)]))
    assert result["model, lpddr3"]["entries"] == pytest.approx({"pearson": 1.0, "off": 0.0})
    assert result["model, lpddr3"]["points"]["off"] == pytest.approx(np.log(3) / 3)
    assert np.isnan(result["rtl"]["points"]["pearson"])  # what never changes correlates with nothing
    assert result["rtl"]["entries"]["off"] == pytest.approx((np.log(2) + np.log(4 / 3)) / 3)
    assert "rtl" not in latency.proportionality(versions_of([(1, 1, 1, 5), (2, 2, 2, None)]))


def test_level_curves_pair_each_look_with_the_points_it_saw():
    def at(stage, points, **more):
        return {"stage": stage, "points": points, "loss": 1.0, **({"target": 2.0} | more if more else {})}

    records = [
        at("dense", 500), at("level2", 90, hvsq=1.0), at("level2", 90), at("level2", 80, hvsq=1.8), at("level2", 80, hvsq=3.0),
        at("level2", 80, hvsq=2.4), at("level2", 90, hvsq=1.9), at("level3", 70, hvsq=1.6), at("level3", 60, hvsq=2.0),
        at("level2-plain", 99, hvsq=5.0)]
    two, three = level_curves(records, (100, 90, 60))
    assert two == LevelCurve(2, (80, 90, 100), (1.2, 0.9, 0.5), 90)
    assert three == LevelCurve(3, (60, 90), (1.0, 0.8), 60)
    assert level_curves(records, (100, 99), "-plain") == (LevelCurve(2, (99,), (2.5,), 99),)
    assert level_curves(records[:1], (100, 90)) == ()


def stub_plan(seen):
    """Stands in for `plan`: stages that leave their name and recipe, and note what they were given."""
    def make(recipe, scene, device, dense=None):
        names = ("dense", "prune", "finetune", "level2", "level3", "level4", *(
            ("separate2", "separate3", "separate4") if recipe.baseline == "mmfr" else ()))

        def maker(name):
            def make_stage(results):
                seen.append((name, recipe, dict(results)))
                return ReadyStage(name, f"{name} {recipe.variant} {'ours' if recipe.enhancement else 'plain'}")

            return make_stage

        return [Planned(name, 3, maker(name)) for name in names]

    return make


def test_parts_are_those_that_tables_need():
    assert table_runs.parts_of(["latency"]) == ("level1",)
    assert table_runs.parts_of(["pruning", "latency"]) == ("level1", "pruning")
    assert table_runs.parts_of(["ablation"]) == ("level1", "levels", "scale-decay", "plain")
    assert table_runs.parts_of(labels.TABLES) == table_runs.PARTS
    assert set(table_runs.NEEDED) == set(labels.TABLES)


def test_parts_add_what_the_tables_need_and_keep_what_is_ready(monkeypatch):
    seen, results = [], {"dense": "there", "prune": "too"}
    monkeypatch.setattr(table_runs, "plan", stub_plan(seen))
    planned = {}
    for part in table_runs.PARTS:
        stages = table_runs.part_plan(part, RECIPE, None, "cpu", dict(results))
        planned[part] = [(stage.name, stage.total) for stage in stages]
        made = {}
        for stage in stages:
            by_plan = stage.total == 3
            made[stage.name] = stage.make(dict(made)).result() if by_plan else stage.name
        results |= made
    budget, levels = RECIPE.budget("prune"), ("level2", "level3", "level4")
    assert planned == {
        "level1": [("finetune", 3)], "levels": [(name, 3) for name in levels], "scale-decay": [("scale-decay", budget)],
        "plain": [(f"{name}-plain", 3) for name in levels], "mmfr": [("separate2", 3), ("separate3", 3), ("separate4", 3)],
        "pruning": [*((f"prune-{name}", budget) for name in CRITERIA),
                    ("prune-M", 3), ("finetune-M", 3), ("prune-L", 3), ("finetune-L", 3)]}
    assert results["dense"] == "there" and results["level3-plain"] == "level3 H plain" and results["level3"] == "level3 H ours"
    given = next(given for name, recipe, given in seen if name == "level3" and not recipe.enhancement)
    assert given["level2"] == "level2 H plain" and given["finetune"] == "finetune H ours" and "level4" not in given
    given = next(given for name, _, given in seen if name == "separate3")
    assert given["level4"] == "level4 H ours"
    given = next(given for name, recipe, given in seen if name == "finetune" and recipe.variant == "L")
    assert given["prune"] == "prune L ours" and given["dense"] == "there"
    assert table_runs.part_plan("pruning", RECIPE, None, "cpu", results) == []


def test_loops_share_gate_interval_and_iterations(scene, dense):
    """Other criteria and scale decay alone run with the recipe's own options, from the dense model."""
    options, before = RECIPE.prune_options(), {"dense": dense, "prune": dense, "finetune": dense}
    stages = {stage.name: stage for part in ("scale-decay", "pruning")
              for stage in table_runs.part_plan(part, RECIPE, scene, "cpu", before)}
    changes = {"scale-decay": {"criterion": None}, "prune-M": {}, "prune-L": {}} | {
        f"prune-{name}": {"criterion": name, "scale_decay": False} for name in CRITERIA if name not in ("ce", "compact")}
    changes["prune-ce"] = {"criterion": "ce"}
    changes["prune-compact"] = {"criterion": None, "interval": WAIT, "recovery": options.interval, "gamma_first": WEIGHT}
    for name, changed in changes.items():
        stage = stages[name].make({})
        assert stage.options == replace(options, **changed) and stage.total == stages[name].total == options.iterations
        assert stage.variant == (name[-1] if name[-1] in "ML" else "H") and len(stage.gaussians) == len(dense)
        assert stage.gaussians is not dense


def test_looks_at_the_gate_come_from_the_log():
    dense = pruning_table.Look(30.0, 900.0, True)
    records = [{"stage": "prune", "psnr": 29.9, "entries": 500.0, "passed": True}, {"stage": "prune", "loss": 1.0},
               {"stage": "finetune", "psnr": 9.0}, {"stage": "prune-M", "psnr": 9.0, "entries": 1.0, "passed": True},
               {"stage": "prune", "psnr": 29.0, "entries": 300.0, "passed": False}]
    ours = pruning_table.looks(records, "prune", dense)
    assert [(look.entries, look.passed) for look in ours] == [(900.0, True), (500.0, True), (300.0, False)]
    count = [dense, pruning_table.Look(29.8, 700.0, True), pruning_table.Look(29.0, 200.0, False)]
    assert pruning_table.equal_quality(count, ours) == pruning_table.EqualQuality(29.8, 700.0, 500.0)
    better = [dense, pruning_table.Look(30.1, 700.0, True)]
    assert pruning_table.equal_quality(better, ours) == pruning_table.EqualQuality(30.1, 700.0, None)
    assert pruning_table.equal_quality([dense], ours) == pruning_table.EqualQuality(30.0, 900.0, 900.0)


def trained(dense):
    """Models that no training made, related as trained ones are."""
    level1 = dense.select(torch.arange(0, 600, 2))
    separate = {f"separate{level + 1}": level1.select(torch.arange(count)) for level, count in ((1, 120), (2, 60), (3, 30))}
    others = {f"prune-{name}": dense.select(torch.arange(500)) for name in (*CRITERIA, "M", "L")}
    tuned = {f"finetune-{name}": dense.select(torch.arange(400)) for name in "ML"}
    results = {"dense": dense, "scale-decay": dense, "prune": level1, "finetune": level1, **separate, **others, **tuned,
               "level4": smfr(level1, (300, 120, 60, 30), 1), "level4-plain": smfr(level1, (300, 200, 100, 50), 1)}
    records = [{"stage": "level2", "points": 120, "hvsq": 2.5, "target": 2.0},
               {"stage": "level2", "points": 120, "hvsq": 1.0, "target": 2.0},
               {"stage": "prune", "psnr": 99.0, "entries": 1.0, "passed": True},
               {"stage": "prune-count", "psnr": 98.0, "entries": 3.0, "passed": True},
               {"stage": "prune-importance", "psnr": 99.5, "entries": 2.0, "passed": True}]
    return table_runs.Trained(RECIPE, results, {"dense": 1.5}, records)


def prepared(scene):
    return tables.Prepared(replace(scene, test=scene.test[:1]), "photographs", RECIPE, {}, {}, [], {"scene": "embedded"})


@pytest.mark.parametrize(("ours", "says", "good"), [
    (50.0, "2.00 times fewer at 29.20 dB", True), (150.0, "1.50 times as many at 29.20 dB", False),
    (None, "ours never looked at 29.20 dB", False)])
def test_what_equal_psnr_costs_is_said_either_way(ours, says, good):
    equal = {"psnr": 29.2, "entries": 100.0, "ours": ours}
    assert equal_target({"equal": equal})[1:] == (says, good)


def test_page_plot_and_json_hold_every_scene(tmp_path, scene, dense):
    pytest.importorskip("matplotlib")
    record, shown = tables.measure_scene(
        prepared(scene), trained(dense), labels.TABLES, edge=32, rtl=lambda model, camera: RtlCycles(7 * len(model), 31, 5))
    tables.write(tmp_path, "training", [record, record | {"scene": "other"}], [shown, replace(shown, name="other")])
    assert {path.name for path in tmp_path.iterdir()} == {"training.json", "training.md", "training.png"}
    page = (tmp_path / "training.md").read_text()
    for text in ("## embedded, 64x64", "## other, 64x64", "| SMFR |", "| MMFR |", "| ours |", "| + scale decay | 600 |",
                 "300 (100.0 %) | 120 (40.0 %) | 60 (20.0 %) | 30 (10.0 %)", "100 % | 40.1 % | 21.8 % | 17.4 %",
                 "-40.0 % points in L4", "| CE | 97 % | 18 |", "RTL cycles against intersections", "(training.png)",
                 "| L2 | ours | 120 | 120: 0.500, 300: 1.250 |", "161.6", "2.12 / 10.1 / 21.7 / 28.3",
                 "| ours, fine-tuned: L1 | M | 400 | 66.7 % |", "| count (opacity) | H | 500 |",
                 "at equal PSNR reached: 3.00 times fewer at 98.00 dB", "at equal PSNR missed: ours never looked at 99.50 dB",
                 "| embedded, 64x64 | L1 of H: intersections cut >= 3 times |"):
        assert text in page, text
    kept = json.loads((tmp_path / "training.json").read_text())["scenes"]
    assert page.count("| squares/frame | fewer squares, times | squares / exact |") == 2
    older = [{name: value for name, value in row.items() if "squares" not in name} for row in kept[0]["pruning"]]
    assert "squares/frame" not in pruning_text(older)  # as reports before there were such columns
    for head in ("| points a pixel | PSNR of dense, gate views | gate to test |", "| HVSQ 1e-5 of L1 to L4, blocks | box |"):
        assert page.count(head) == (4 if "gate views" in head else 2), head
    assert [each["scene"] for each in kept] == ["embedded", "other"]
    assert kept[0]["latency"]["versions"][0]["rtl"]["cycles"] == 7 * 600 + 31
    assert markdown(kept, "training.png").rstrip() == page.rstrip()  # nothing is on the page that is not in the JSON
    assert (tmp_path / "training.png").read_bytes().startswith(b"\x89PNG")
    results_have_the_tables(tmp_path, page)


def results_have_the_tables(folder, page):
    """The section of docs/results.md, filled from the reports in a folder, has the page's rows, and nothing unmeasured."""
    text = (ROOT / "docs" / "results.md").read_text()
    (folder / "results.md").write_text(text[text.index("\n## Training\n") :])
    assert fill(folder / "results.md", folder) == 0
    filled = (folder / "results.md").read_text()
    assert "(not measured yet)" not in filled and "reports/training.png" in filled
    for name in ("training_headline", "training_pooling"):  # tables of runs of golden/train.py, which the page has not
        of_runs = filled.index(f"<!-- table:{name} -->")
        filled = filled[:of_runs] + filled[filled.index("<!-- end -->", of_runs) :]
    rows = [line for line in filled.splitlines() if line.startswith("|")]
    assert len(rows) > 50 and set(rows) <= set(page.splitlines())
    assert filled.count("**other, 64x64**") == 5
    assert fill(folder / "results.md", folder, check=True) == 0


@pytest.mark.parametrize("name, keys, plotted", [
    ("representations", {"comparison", "fewer_percent", "level_curves"}, True), ("ablation", {"ablation"}, False),
    ("pruning", {"pruning"}, False), ("latency", {"latency"}, True)])
def test_each_table_alone(tmp_path, scene, dense, name, keys, plotted):
    if plotted:
        pytest.importorskip("matplotlib")
    record, shown = tables.measure_scene(prepared(scene), trained(dense), [name], edge=32, rtl=None)
    common = {"scene", "size", "references", "options", "views", "seconds"}
    assert set(record) == common | keys
    tables.write(tmp_path, "t", [record], [shown])
    page = (tmp_path / "t.md").read_text()
    assert (tmp_path / "t.png").exists() == plotted == ("t.png" in page)
    heads = {"representations": "### Foveated", "ablation": "### Ablation", "pruning": "### Pruning", "latency": "## Latency"}
    assert [head for head in heads.values() if head in page] == [heads[name]]


def test_verdicts_follow_the_numbers(scene, dense):
    """Of the dense model pruned to itself: all of its PSNR, none of its intersections cut."""
    same = trained(dense)
    same = replace(same, results=same.results | {"prune": dense, "finetune": dense})
    rows = [row.record(first) for rows in [pruning_table.pruning_rows(replace(scene, test=scene.test[:1]), same)]
            for first in rows[:1] for row in rows]
    assert [(row["criterion"], row["variant"], row["tuned"]) for row in rows] == [
        (None, None, False), (OURS, "H", False), (OURS, "H", True), (OURS, "M", False), (OURS, "M", True), (OURS, "L", False),
        (OURS, "L", True), *((name, "H", False) for name in CRITERIA)]
    told = {what: verdict for what, _, verdict in targets_rows({"scene": "x", "pruning": rows})}
    assert told["L1 of H: PSNR >= 99 % of dense"] == "reached"
    assert told["L1 of H: intersections cut >= 3 times"] == "missed"
    assert [verdict for what, verdict in told.items() if "equal PSNR than by" in what] == [
        "reached", "reached", "missed", "reached", "reached", "reached"]
    assert rows[1]["cut_squares"] == 1.0 and rows[3]["cut_squares"] > 1.0 and rows[0]["squares"] > rows[0]["frame"]["entries"]
    assert rows[1]["cut"] == 1.0 and rows[3]["cut"] > 1.0 and rows[4]["points_percent"] == pytest.approx(200 / 3)


def test_targets_of_levels_and_dense_models():
    def method(name, hvsq, over):
        return {"method": name, "hvsq": hvsq, "hvsq_validation": [1.0, 1.0, 0.9, 1.04], "over_l1_percent": over}

    scene = {"scene": "fern", "ablation": [{"psnr": 21.0}], "fewer_percent": [0.0, 0.0, 10.0, -1.0],
             "comparison": [method("SMFR", [1.0, 2.0, 3.0, 4.0], 6.0), method("ours", [1.0, 1.04, 1.05, 1.1], 6.4)]}
    assert [(what[:12], verdict) for what, _, verdict in targets_rows(scene)] == [
        ("dense PSNR >", "missed"), ("HVSQ of L2, ", "reached"), ("HVSQ of L2, ", "missed"), ("storage <= 6", "reached"),
        ("SMFR's HVSQ ", "reached"), ("opacity enha", "missed")]


@pytest.mark.parametrize("option, told", [
    (["--edge", "8"], "edge 8"), (["--device", "tpu"], "tpu"), (["--size", "9"], "size '9'"),
    (["--variant", "X"], "variant 'X'"), (["--iterations", "3"], "iterations 3"),
    (["nowhere"], "nowhere"), (["--tables", "pruning,speed"], "'speed' is not accepted: choose of representations, ablation"),
    (["--tables", ","], "tables ''"), (["--out", "Makefile"], "Makefile")])
def test_bad_options_are_told(tmp_path, option, told):
    folders = ["--runs", str(tmp_path), "--work", str(tmp_path / "work"), "--out", str(tmp_path / "out")]
    with pytest.raises(InputError, match=told):
        study.main([*folders, *option])


@pytest.mark.long
def test_the_whole_command_and_again_without_training(tmp_path, capsys):
    pytest.importorskip("matplotlib")
    command = ["--size", "48x48", "--iterations", "60", "--max-points", "1000", "--edge", "48",
               "--runs", str(tmp_path / "none"), "--work", str(tmp_path / "work"), "--out", str(tmp_path / "out")]
    assert study.main([*command, "--tables", "latency,pruning", "--no-rtl"]) == 0
    assert capsys.readouterr().err.count("training in") == 2
    pruning = json.loads((tmp_path / "out" / "tables.json").read_text())["scenes"][0]["pruning"]
    assert study.main(command) == 0
    told = capsys.readouterr().err
    assert told.count("going on in") == 2 and told.count("training in") == 4
    first = json.loads((tmp_path / "out" / "tables.json").read_text())
    assert first["scenes"][0]["pruning"] == pruning
    versions = first["scenes"][0]["latency"]["versions"]
    assert all(version["rtl"]["entries"] == version["work"]["entries"] for version in versions)
    assert study.main(command) == 0
    assert "training in" not in capsys.readouterr().err
    again = json.loads((tmp_path / "out" / "tables.json").read_text())
    del first["provenance"], again["provenance"]  # which say when and how long
    assert again == first
