"""The reports: machines beside each other, the models of others, means, the pages."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from golden.msv2_ref import pipeline
from golden.msv2_ref.eyes import render_stereo
from golden.scenes.stereo import stereo_pair
from msv2.studies.labels import overlapping
from msv2.studies.performance import area, frames, gpu, machines, page, pictures, steps, study, summary, sweeps, tiles
from msv2.studies.report import overview
from msv2.studies.report.study import main as whole_report
from msv2.studies.report.study import summary as together
from msv2.studies.scenes import MODELS, TRAINED_HERE
from msv2.studies.web import maker, markdown
from msv2.studies.web.check import problems
from perf import frames as perf_frames
from perf.gscore import gscore_trace
from perf.trace import trace_of
from spec.config import PAPER, V3
from spec.errors import InputError
from tests.helpers.golden_samples import map_for, random_model, view


@pytest.fixture(scope="module")
def frame():
    """Four levels of random splats, 96x64."""
    camera = view(96, 64)
    pair, model = stereo_pair(camera, units_per_metre=1.0), random_model(np.random.default_rng(3), 250, levels=4)
    both = {"config": frames.TWO_EYES, "foveation": map_for(camera, (0.5, 0.5), 4)}
    whole = render_stereo(model, pair, threshold_deg=180.0, **both)
    warped = render_stereo(model, pair, source=whole.source, threshold_deg=0.0, **both)
    traces = (trace_of(eye) for eye in (whole.source, whole.target, warped))
    lists = {machine.name: perf_frames.trace_of(pipeline.render(
        model, camera, config=machine, foveation=map_for(camera, (0.5, 0.5), 4))) for machine in frames.TRACED}
    return frames.Compared("random", "random", False, *traces, gscore_trace(whole.source), lists, {"size": [96, 64]})


@pytest.fixture(scope="module")
def areas():
    names = ("array", "culling and conversion", "lists", "warp")
    groups = {name: {"logic_um2_16nm": 1e5, "memory_um2_16nm": 1e4} for name in names}
    return {"builds": {V3.name: {"mm2_16nm": 0.6},
                       "1ghz": {"groups": groups, "commit": "abc", "mm2_16nm": 0.44, "mm2_16nm_without_warp_memories": 0.43}},
            "delay_to_16nm": 2.0, "commit": "abc"}


@pytest.fixture(scope="module")
def content(frame, areas):
    """A report's numbers, of one frame."""
    runs, kept = machines.run_all(frame)
    runs += steps.run_steps(frame)
    found = [study.frame_rows(frame, runs)]
    means, known = summary.means(found), area.known_mm2(areas)
    sizes = {step.name: 0.5 + number / 10 for number, step in enumerate(steps.STEPS)}
    by_step = steps.over_gscore(frame, runs, sizes)
    equal = {key: sweeps.at_equal_area(frame, [r for r in runs if r.machine == name], known[config.name])
             for key, name, config in (("equal_area", machines.BOTH.name, PAPER),
                                       ("equal_area_supertiles", machines.SUPER, V3))}
    equal["equal_area_whole"] = by_step[machines.WHOLE]
    return {
        "commit": "abc", "command": "x", "size": "96x64", "levels": 4, "config": "paper", "clock_hz": 1e9, "missing": ["none"],
        "trained": [], "model_error": {"total": 0.01, "mean": 0.01, "frames": 3}, "frames": found, "means": means,
        "beside_paper": summary.beside_paper(found, means, **equal), "goals": summary.goals(found, means, **equal),
        "steps": steps.summary(found, by_step, sizes), **equal, "iso_area": sweeps.iso_area(frame, areas), "area_source": "abc",
        "bandwidth": sweeps.bandwidth_rows(frame), "sweeps": sweeps.sweeps(frame), "full_hd": [],
        "scaled_clock": 0.5, "reached_ghz": 0.7,
        "chip_129": summary.CHIP_129, "gpu_published": gpu.PUBLISHED, "gpu_model": "stated",
        "timeline": {"frame": "random", "memory": "lpddr3", "folder": "build", "machines": [
            {"machine": "base", "groups": kept.groups, "render": kept.phases["render"]}]}}


def runs_of(content, machine, memory):
    return next(r for r in content["frames"][0]["runs"] if (r["machine"], r["memory"]) == (machine, memory))


def test_every_machine_with_every_memory_over_its_own_base(content):
    names = [(r["machine"], r["memory"]) for r in content["frames"][0]["runs"]]
    assert len(names) == len(set(names)) == 3 * 22 and machines.MEMORIES == ("lpddr3", "ideal", "unlimited")
    for memory in machines.MEMORIES:
        base, two = (runs_of(content, name, memory) for name in (machines.BASE.name, machines.TWO_BASE))
        assert base["speedup"] == two["speedup"] == base["energy_ratio"] == 1 and (base["eyes"], two["eyes"]) == (1, 2)
        warping = runs_of(content, machines.WARPING, memory)
        assert warping["speedup"] == pytest.approx(two["cycles"] / warping["cycles"]) and warping["eyes"] == 2
        for r in content["frames"][0]["runs"]:
            assert r["floor"] is None or 0 < r["floor"] <= r["cycles"]


def test_ideal_memories_are_bounds(content):
    for machine in (machines.BASE.name, machines.BOTH.name, machines.LOCKSTEP.name, machines.WARPING, machines.GSCORE,
                    machines.SUPER, machines.SUPER_BASE):
        real, limited, free = (runs_of(content, machine, memory) for memory in machines.MEMORIES)
        assert free["cycles"] <= limited["cycles"]
        if machine not in (machines.SUPER, machines.SUPER_BASE):  # they wait for latency, of which LPDDR3 has less
            assert limited["cycles"] < real["cycles"]
        assert free["dram_bytes"] == limited["dram_bytes"] == real["dram_bytes"]
        if machine != machines.GSCORE:
            assert real["dram_mj"] > limited["dram_mj"]


def test_lpddr3_comes_first(content):
    """In every table that has a memory, and in every table of means."""
    text = page.page(content, [])
    assert all(list(row["ours"]) == list(machines.MEMORIES) for row in content["beside_paper"])
    for block in text.split("\n\n"):
        rows = [[cell.strip() for cell in line.split("|")] for line in block.splitlines() if line.startswith("| ")]
        if rows and "memory" in rows[0]:
            assert rows[2][rows[0].index("memory")] == "4 x LPDDR3-1600", block
    head = next(line for line in text.splitlines() if line.startswith("| geomean"))
    assert head.index("ours, 4 x LPDDR3-1600") < head.index("ours, ideal") < head.index("ours, unlimited")


def test_the_other_machine_gets_our_share_of_lpddr3(content):
    ours, other = (runs_of(content, name, "lpddr3") for name in (machines.BOTH.name, machines.GSCORE))
    assert other["bytes_per_cycle"] == pytest.approx(ours["dram_bytes"] / ours["cycles"])
    (real,) = [e for e in content["equal_area"] if e["memory"] == "lpddr3"]
    assert real["speedup_bound"] < real["speedup"]
    assert all(e["speedup_bound"] == e["speedup"] for e in content["equal_area"] if e["memory"] != "lpddr3")
    with pytest.raises(ValueError, match="rate must be a number with LPDDR3"):
        machines.run_gscore(None, "lpddr3")


def test_resources_that_are_less_are_slower_and_smaller(content):
    found = [r for r in content["iso_area"] if r["memory"] == "unlimited"]
    for machine in (machines.BOTH.name, machines.GSCORE):
        mine = [(r["mm2_16nm"], r["frames_per_s"]) for r in found if r["machine"] == machine]
        assert mine == sorted(mine) and mine[0][0] < mine[-1][0] and mine[0][1] < mine[-1][1]


def test_area_is_that_of_the_groups_without_the_warp_unit(areas):
    assert area.machine_mm2(areas, PAPER) == pytest.approx(3 * 0.11)
    half = area.machine_mm2(areas, PAPER.with_(cores_x=8, culling_units=4))
    assert half == pytest.approx(0.11 + 2 * 0.06)
    assert area.known_mm2(areas) == {"paper": pytest.approx(3 * 0.11), V3.name: 0.6} and area.known_mm2(None) == {}
    assert area.load_area(area.REPORTS / "nowhere.json") is None and sweeps.iso_area(None, None) == []


def test_equal_area_scales_the_other_machine_to_ours(content):
    assert {e["mm2_16nm"] for e in content["equal_area_supertiles"]} == {0.6} and sweeps.at_equal_area(None, [], None) == []
    for e in (*content["equal_area"], *content["equal_area_supertiles"]):
        assert e["factor"] * area.GSCORE_MM2_16NM == pytest.approx(e["mm2_16nm"])
        assert e["speedup"] == pytest.approx(e["gscore_cycles"] / e["ours_cycles"])


def test_steps_are_the_whole_machine_and_what_it_is_without_each(content, frame):
    rows = content["steps"]
    assert rows[0]["without"] == "" and set(rows[0]["of_whole"].values()) == {1.0}
    assert set(rows[-1]["over_source"].values()) == {1.0} and rows[-1]["bytes_gain"] == rows[-1]["energy_gain"] == 1
    for row in rows:
        for memory in machines.MEMORIES:
            assert row["over_source"][memory] == pytest.approx(rows[0]["over_source"][memory] * row["of_whole"][memory])
            step = next(step for step in steps.STEPS if step.name == row["machine"])
            (other,) = sweeps.at_equal_area(frame, [steps.run_step(frame, step, memory)], row["mm2_16nm"])
            assert row["gscore_like_gain"][memory] == pytest.approx(other["speedup"])
    assert [run["busy"] for run in content["frames"][0]["runs"] if run["machine"] == machines.WHOLE]
    for step in steps.STEPS[:7]:
        assert frame.steps["v3"].pairs == frame.steps["v3_streams"].pairs and step.config.supertiles
    without = {step.without for step in steps.STEPS}
    assert len(without) == len(steps.STEPS) and steps.step_areas().keys() == {step.name for step in steps.STEPS}


def test_the_gpu_is_a_roofline(frame):
    few, many = (gpu.gpu_frame(frame.frame, ops) for ops in (0, 10**6))
    assert few.preprocess == many.preprocess and few.sort == many.sort and few.dram_bytes == many.dram_bytes
    assert many.blend == pytest.approx(10**6 * 256 * gpu.PAIR_FLOPS / gpu.FLOPS_PER_S)
    assert few.seconds >= few.dram_bytes / gpu.BYTES_PER_S * (1 - 1e-12)


def test_one_tile_a_buffer_waits_where_tiles_differ(frame):
    eye = frame.frame.eyes[0]

    def cycles(counts):
        n = len(counts)
        flat = replace(eye, counts=np.array(counts), use=np.ones(sum(counts), np.uint8), rendered=np.ones(n, bool),
                       blend=np.zeros(n, bool))
        return tiles.tile_granular(flat)

    even, uneven = cycles([100] * 8), cycles([20, 180] * 4)
    assert even == {"waiting": 100 + 8 * 101, "rows": 100 + 8 * 117, "drained": 100 + 8 * 200 + 117,
                    "never_waiting": 808}
    assert uneven == {"waiting": 20 + 4 * (180 + 181), "rows": 20 + 4 * (180 + 197),
                      "drained": 20 + 180 + 4 * (360 + 197), "never_waiting": 808}
    assert cycles([4096] * 2)["drained"] == 2 * 4096 + 2 * 4113  # so large a tile leaves the sorter as fast as it has entered


def test_means_are_geometric():
    assert summary.geomean([1, 4]) == pytest.approx(2) and summary.geomean([]) is None
    assert summary.PAPER["speedup"] == pytest.approx(1.13, abs=5e-3)


def test_goals_say_what_is_missed(content):
    assert len(content["goals"]) == 17
    for goal in content["goals"]:
        reached = goal["found"] >= goal["wanted"] if goal["least"] else goal["found"] <= goal["wanted"]
        assert goal["reached"] == reached and math.isfinite(goal["found"])
    missed = "| **no** |" in page.page(content, [])
    assert missed == any(not goal["reached"] for goal in content["goals"])


def test_pages_and_pictures(content, frame, tmp_path):
    made = pictures.draw(content, study.timelines(frame), tmp_path)
    text = page.page(json.loads(json.dumps(content)), made)
    assert all((tmp_path / f"performance_{name}.png").stat().st_size > 1000 for name in made)
    assert text.count("![") == len(made)
    rows = [line for line in text.splitlines() if line.startswith("|")]
    for block in text.split("\n\n"):
        widths = {line.count(" | ") for line in block.splitlines() if line.startswith("|")}
        assert len(widths) <= 1 and " nan " not in block, block
    shown = maker.page("Report", "", [maker.Chapter("Performance", text)])
    assert shown.count("<table>") == shown.count("</table>") == sum(line.startswith("| ---") for line in rows)
    assert shown.count("<details") == text.count("\n## ") + 1  # the introduction folds, too
    assert "**" not in shown and shown.count("<img") == len(made)


def test_words_of_the_page_in_html():
    assert markdown.inline("a `x*y <b>` **c** [d](e)") == 'a <code>x*y &lt;b&gt;</code> <b>c</b> <a href="e">d</a>'
    body = markdown.body("# A b\ntext\n\n- one\n- two\n\n```\n# no\n\nheading\n```\n| x | y |\n| --- | ---: |\n| 1 | 2 |\n")
    assert '<h1 id="a-b">A b</h1>' in body and body.count("<li>") == 2 and "<pre># no\n\nheading</pre>" in body
    assert '<tr><td class="number">1</td><td class="number">2</td></tr>' in body


def test_the_whole_report(content, areas):
    energy = {"frames": [{"scene": "s", "size": [1, 1], "work": "w", "memory": "lpddr3", "chip_mj": 0.1, "dram_mj": 0.2}]}
    found = together(content, energy, areas, {"summary": {"model_error_total": 0.01}})
    assert found["area_mm2_16nm"] == 0.44 and found["model_error_total"] == 0.01
    assert found["speedup"][machines.BASE.name] == {
        memory: {"frame": pytest.approx(1), "render": pytest.approx(1)} for memory in machines.MEMORIES}
    assert found["energy_mj_per_frame"]["random"][machines.BOTH.name] > 0
    found["frame"] = {"scene": "random", "points": 250, "levels": 4, "trained": False}
    text = overview.markdown(found, content, {"performance": "# Performance"})
    assert "0.440 mm²" in text and "| 0.44 mm² |" in text and "random subsets of the splats" in text
    bare = together(content, energy, None, None) | {"frame": found["frame"]}
    assert "no reports/area.json" in overview.markdown(bare, content, {})
    shown = overview.html(found, content, {"performance": "# Performance\n\nwords\n\n## Goals\n\nmore"})
    assert shown.index("<img") < shown.index('class="card"') < shown.index("<section>") and shown.count("<details") == 3


def test_labels_of_the_pictures_do_not_overlap(content, frame, tmp_path, monkeypatch):
    pytest.importorskip("matplotlib", reason="needs the extra `plots`")
    figures = {}
    monkeypatch.setattr(pictures, "save_figure", lambda figure, path, **_: figures.update({path.stem: figure}))
    assert len(pictures.draw(content, study.timelines(frame), tmp_path)) == len(figures) == 6
    many = content | {"frames": [found | {"name": f"garden_large, view {i}"} for i in range(10) for found in content["frames"]]}
    pictures.draw(many, study.timelines(frame), tmp_path / "many")
    for name, figure in figures.items():
        assert overlapping(figure) == [], name
        assert figure.get_size_inches()[0] * 100 <= 1200, name


def test_steps_are_those_that_are_taken():
    todo = [("embedded", "orbit"), ("embedded", "3")]
    assert study.steps_of(todo, ["embedded"], True) == [
        "embedded, orbit: traces", "embedded, orbit: machines", "embedded, 3: traces", "embedded, 3: machines",
        "embedded: sweeps", "Full HD"]


@pytest.mark.long
def test_the_command_writes_all_of_it(tmp_path):
    assert whole_report(["embedded", "--size", "64x48", "--out", str(tmp_path)]) == 0
    found = json.loads((tmp_path / "report.json").read_text())
    assert {"area_mm2_16nm", "energy_mj_per_frame", "model_error_total", "speedup", "commit", "config"} <= set(found)
    for name in ("area", "energy", "performance"):
        assert (tmp_path / f"{name}.json").is_file() and f'href="{name}.json"' in (tmp_path / "report.html").read_text()
    assert problems(tmp_path / "report.html") == []


def test_scenes_that_are_not_there_are_named():
    with pytest.raises(InputError, match="SCENE 'no_such_scene' is not accepted"):
        frames.request("no_such_scene", "64x64")
    here, missing = frames.scenes_here()
    assert here[0] == "embedded" and set(here[1:]) | set(missing) == {*MODELS[1:], *TRAINED_HERE}
