"""`msv2 sweep` as a user meets it: files, errors, resuming, outputs; several processes and a cluster that loses a worker."""

from __future__ import annotations

import csv
import json
import os
import re
import signal
from pathlib import Path

import pytest

from golden.scenes.save import save_model
from msv2.sweep import command, measure, output, points, run
from msv2.sweep.points import options, points_of, read_sweep
from perf import __main__ as perf
from spec.errors import InputError
from spec.paths import ROOT
from spec.private import output_folder
from tests.helpers.golden_samples import ball

SWEEP = """
[base]
config = "tiny"
size = "48x32"
gaze = "centre"
levels = 2

[vary]
splat_cache_lines = [32, 64]
bandwidth = [6.4, "unlimited"]

[[point]]
formats.colour = "UQ1.8"
clock_mhz = 500

[[point]]
splat_cache_lines = 64
bandwidth = 6.4
"""
"""Four combinations, a point of its own, and one that is a combination again."""


@pytest.fixture
def scene(tmp_path) -> Path:
    path = tmp_path / "ball.ply"
    save_model(ball(), path)
    return path


@pytest.fixture
def sweep(scene, tmp_path, monkeypatch) -> Path:
    """The file, with the caches of this process in a folder of their own."""
    monkeypatch.setattr(measure, "CACHE", tmp_path / "traces")
    path = tmp_path / "sweep.toml"
    path.write_text(SWEEP.replace("[base]", f'[base]\nscene = "{scene}"'))
    return path


def results(out: Path) -> list[dict]:
    return json.loads((out / "results.json").read_text())["points"]


def test_the_memory_is_lpddr3_unless_a_bandwidth_is_named():
    def memories(content: dict) -> list[str]:
        return [point.checked()[1].memory.kind for point in points_of(content)]

    assert memories({"vary": {"culling_units": [1, 2]}}) == ["lpddr3"] * 2
    assert memories({"vary": {"bandwidth": [12.8, 25.6]}, "point": [{"culling_units": 1}]}) == ["ideal"] * 3
    assert memories({"vary": {"memory": ["lpddr3", "ideal"]}}) == ["lpddr3", "ideal"]
    mixed = points_of({"base": {"memory": "lpddr3"}, "point": [{"culling_units": 1}, {"memory": "ideal", "bandwidth": 6.4}]})
    assert [dict(point.varied)["bandwidth"] for point in mixed] == ["of lpddr3", "6.4"]


def test_points_are_combinations_and_single_ones_each_once(sweep, capsys):
    found = read_sweep(sweep)
    assert len(found) == 5
    assert [dict(point.varied).get("bandwidth") for point in found] == ["6.4", "unlimited", "6.4", "unlimited", "25.6"]
    assert dict(found[-1].varied) == {
        "splat_cache_lines": "64", "bandwidth": "25.6", "formats.colour": "UQ1.8", "clock_mhz": "500"}
    assert all("--gaze=24,16" in point.argv for point in found) and found[-1].clock_mhz == 500
    assert command.main([str(sweep), "--list"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 5 and all("msv2 perf --" in line for line in lines)


def test_a_point_is_what_perf_says(sweep, tmp_path, monkeypatch):
    out = tmp_path / "out"
    assert command.main([str(sweep), "--jobs", "1", "--out", str(out)]) == 0
    monkeypatch.setattr(perf, "CACHE", tmp_path / "traces")
    for row in results(out)[::2]:
        argv = row["command"].removeprefix("msv2 perf ").split()
        assert perf.main([*argv, "--out", str(tmp_path / "perf")]) == 0
        alone = json.loads((tmp_path / "perf" / "perf.json").read_text())
        assert row["cycles"] == alone["total"] and row["intersections"] == alone["entries"]
        assert row["read_bytes"] == alone["dram_bytes"]["read"]
    slow = next(row for row in results(out) if row["settings"]["clock_mhz"] == "500")
    assert slow["frames_per_s"] == pytest.approx(5e8 / slow["cycles"])


def test_points_with_the_same_pixels_share_a_trace(sweep, tmp_path):
    command.main([str(sweep), "--jobs", "1", "--out", str(tmp_path / "out")])
    assert len(list((tmp_path / "traces").iterdir())) == 2  # the formats of one point differ


def test_outputs(sweep, tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="needs the extra `plots`")
    out = tmp_path / "out"
    command.main([str(sweep), "--jobs", "1", "--out", str(out)])
    rows = list(csv.DictReader((out / "results.csv").open()))
    assert len(rows) == 5 and {row["area_basis"] for row in rows} == {"estimate"}
    assert [row["splat_cache_lines"] for row in rows] == ["32", "32", "64", "64", "64"]
    assert float(rows[0]["mm2"]) < float(rows[2]["mm2"]) and float(rows[0]["cycles"]) > float(rows[1]["cycles"])
    assert {row["pareto"] for row in rows} > {""}
    assert (out / "pareto.png").stat().st_size > 5000
    assert "5 points, 0 of them known" in capsys.readouterr().out


def test_a_second_run_measures_nothing_and_an_interrupted_one_the_rest(sweep, tmp_path, monkeypatch):
    out, measured = tmp_path / "out", []
    monkeypatch.setattr(run, "tried", lambda point: measured.append(point) or measure.tried(point))
    command.main([str(sweep), "--jobs", "1", "--out", str(out)])
    assert len(measured) == 5
    first = (out / "results.csv").read_text()
    command.main([str(sweep), "--jobs", "1", "--out", str(out)])
    assert len(measured) == 5
    kept = sorted((out / "points").iterdir())
    kept[0].unlink()
    kept[1].write_text("{broken")
    command.main([str(sweep), "--jobs", "1", "--out", str(out)])
    assert len(measured) == 7 and (out / "results.csv").read_text() == first


def test_a_changed_scene_is_measured_again(sweep, scene, tmp_path):
    before = {measure.point_key(point) for point in read_sweep(sweep)}
    os.utime(scene, ns=(1, 1))
    assert not before & {measure.point_key(point) for point in read_sweep(sweep)}


def test_a_point_that_fails_is_named_and_the_others_are_kept(sweep, tmp_path, capsys):
    sweep.write_text(sweep.read_text() + '\n[[point]]\ngaze = "900,900"\n')
    out = tmp_path / "out"
    assert command.main([str(sweep), "--jobs", "1", "--out", str(out)]) == 1
    assert re.search(r"failed: .*gaze=900,900: gaze 900\.0,900\.0 is ", capsys.readouterr().out)
    assert len(results(out)) == 5 and len(list((out / "points").iterdir())) == 5


def test_without_matplotlib_the_numbers_come(sweep, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(output, "find_pyplot", lambda: None)
    out = tmp_path / "out"
    assert command.main([str(sweep), "--jobs", "1", "--out", str(out)]) == 0
    assert "no diagram without matplotlib (extra plots)" in capsys.readouterr().out
    assert (out / "results.csv").is_file() and not (out / "pareto.png").exists()


def test_a_sweep_must_be_named():
    with pytest.raises(InputError, match="no sweep is named"):
        command.main([])


def test_one_sweep_at_a_time_in_a_folder(sweep, tmp_path):
    with output_folder(tmp_path / "out", tmp_path), pytest.raises(InputError, match="while another run writes to it"):
        command.main([str(sweep), "--jobs", "1", "--out", str(tmp_path / "out")])


@pytest.mark.parametrize(("content", "says"), [
    ("[vari]\na = [1]", "table 'vari' is not accepted: choose one of base, vary, point; did you mean 'vary'?"),
    ("[vary]\nsplat_cach_lines = [64]", "did you mean 'splat_cache_lines'?"),
    ("[vary.formats]\ncolor = ['UQ1.8']", "did you mean 'formats.colour'?"),
    ("[vary]\nbandwith = [64]", "did you mean 'bandwidth'?"),
    ("[vary]\nculling_units = 4", "vary: culling_units = 4 is not accepted: a list of values is"),
    ("[vary]\nculling_units = [16]", "point culling_units=16: .*culling_units must be in 1..8, not 16"),
    ("[vary]\nbandwidth = [65]", "point bandwidth=65: bandwidth '65' is not accepted: 0.01..64 bytes a cycle are"),
    ("[vary]\nlevels = ['x']", "point levels=x: argument --levels: invalid int value: 'x'"),
    ("[base]\npipeline = true", "setting 'pipeline' is not accepted: incremental"),
    ("[base]\nstereo = 3", "stereo 3 is not accepted: true or false is"),
    ("[base]\nset.stereo = true", "setting 'set.stereo' is not accepted: stereo, the frame's option, is"),
    ("[base]\nscene = 'nowhere'", "scene 'nowhere' is not accepted"),
    ("[base]\nclock_mhz = 0", "clock_mhz 0 is not accepted: 1..100000 MHz are"),
    ("[base]\nmemory = 'lpddr3'\nbandwidth = 25.6", "bandwidth is not accepted with memory 'lpddr3'"),
    ("[base]\nout = 'x'", "setting 'out' is not accepted"),
    ("point = 3", "each listed point is a table"), ("base = 3", "a table \\[base\\] is"),
    ("[vary]\nlatency = []", "a list of values is"), ("[base", "is not TOML"),
])
def test_bad_files_are_refused(content, says, tmp_path):
    path = tmp_path / "bad.toml"
    path.write_text(content)
    with pytest.raises(InputError, match=says.replace("?", r"\?")) as caught:
        read_sweep(path)
    assert "bad.toml" in str(caught.value)


def test_too_many_points_are_refused_before_they_are_made():
    with pytest.raises(InputError, match="1,000,000 points are not accepted: at most 100,000 are"):
        points_of({"vary": {name: list(range(1, 101)) for name in ("latency", "seed", "beta")}})
    with pytest.raises(InputError, match=r"absent\.toml' cannot be read"):
        read_sweep(Path("absent.toml"))


def test_names_of_both_mean_the_frames(sweep):
    assert {"levels", "depth", "stereo"} <= set(options())
    args, asked = points_of({"base": {"levels": 2, "set": {"levels": 3}}})[0].checked()
    assert asked.config.levels == 3 and args.levels == 2
    args, _ = points_of({"base": {"stereo": True, "config": "paper_small"}})[0].checked()
    assert args.stereo and args.ipd > 0
    assert {"scene", "clock_mhz", "set.depth"} <= set(points.names()) and "set.stereo" not in points.names()


def test_the_example_is_a_sweep():
    found = read_sweep(ROOT / "examples" / "sweep.toml")
    assert len(found) == 26
    text = (ROOT / "docs" / "sweep.md").read_text(encoding="utf-8")
    for name in output.COLUMNS:
        assert f"`{name}`" in text, f"docs/sweep.md does not explain {name}"



def test_the_frontier_is_what_nothing_beats():
    rows = [{"mm2": area, "frames_per_s": rate} for area, rate in ((1, 5), (2, 4), (2, 9), (3, 9), (4, 12))]
    assert output.frontier(rows, "mm2", "frames_per_s") == [0, 2, 4]


@pytest.mark.long
def test_processes_give_what_one_gives(sweep, tmp_path):
    for name, jobs in (("one", "1"), ("two", "2")):
        assert command.main([str(sweep), "--jobs", jobs, "--out", str(tmp_path / name)]) == 0
    assert (tmp_path / "one" / "results.csv").read_text() == (tmp_path / "two" / "results.csv").read_text()


@pytest.mark.long
def test_a_cluster_that_loses_a_worker_loses_no_point(scene, tmp_path):
    """Four workers, one of which is killed while points are measured: each point is there, and once."""
    distributed = pytest.importorskip("distributed")
    vary = {"latency": [50, 75, 100, 125, 150], "splat_cache_lines": [16, 32, 64, 128], "culling_units": [1, 2]}
    found = points_of({"base": {"scene": str(scene), "config": "tiny", "size": "48x32"}, "vary": vary})
    assert len(found) == 40
    seen, killed = [], []
    with distributed.LocalCluster(n_workers=4, threads_per_worker=1, dashboard_address=None) as cluster:
        with distributed.Client(cluster) as client:
            workers = list(client.run(os.getpid).values())

        def done(point: points.Point, row: dict) -> None:
            seen.append(row["key"])
            if len(seen) == 8:
                killed.append(workers[0])
                os.kill(workers[0], signal.SIGKILL)

        rows = run.run_points(found, tmp_path / "out", scheduler=cluster.scheduler_address, done=done)
        assert len(killed) == 1 and len(seen) == len(set(seen)) == 40
        assert [row.get("error") for row in rows] == [None] * 40
        assert {path.stem for path in (tmp_path / "out" / "points").iterdir()} == {row["key"] for row in rows} == set(seen)
        run.run_points(found, tmp_path / "out", scheduler=cluster.scheduler_address, done=done)
        assert len(seen) == 40


@pytest.mark.slow  # it waits for the cluster
def test_a_cluster_that_does_not_answer_is_named(sweep, tmp_path):
    pytest.importorskip("distributed")
    with pytest.raises(InputError, match=r"scheduler 'tcp://127\.0\.0\.1:1' is not accepted"):
        command.main([str(sweep), "--scheduler", "tcp://127.0.0.1:1", "--out", str(tmp_path / "out")])
