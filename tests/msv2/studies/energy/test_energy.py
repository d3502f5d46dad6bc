"""Energy of a frame: parts sum, work costs, no work costs clock and leakage only; every number says what it is from."""

from __future__ import annotations

import json
from dataclasses import fields, replace

import pytest

from msv2.studies.energy import study
from msv2.studies.energy.dram import LPDDR3
from msv2.studies.energy.estimates import estimates
from msv2.studies.energy.frame import CHIP, PARTS, WorkCounts, counter_counts, frame_energy
from msv2.studies.energy.sources import SRAM_POINTS, SRAM_TO_16NM, sram_access_pj
from msv2.studies.energy.table import TABLE, Memory, Table, Unit, load_table
from spec.config import PAPER, PAPER_SMALL
from spec.errors import InputError

ROUNDED = 0.6e-6
"""Numbers in the JSON have six decimals."""

REFERENCE = {"cores": 256, "culling_units": 8, "warp_lanes": 4}
SMALL = Table(
    units=(
        Unit("adder", "points", 3.0, 1.0, 2.0, 0.5, (), "made up", "culling_units"),
        Unit("cores", "ops", 40.0, 20.0, 8.0, 0.25, (Memory(1024, 64, 1.0, 0.5),), "made up", "cores"),
        Unit("idler", "cycles", 7.0, 1.0, 1.0, 0.125, (), "made up")),
    config="paper", reference=REFERENCE, node="7 nm", to_16nm=2.5, scaling="x 2.5", flop_leakage_pw=200.0, commit="none")
WORK = WorkCounts(points=100, survivors=40, entries=300, spilled_entries=10, ops=350, pixels=1000, tiles=12, read_beats=70,
                  write_beats=50)


@pytest.fixture(scope="module", params=("small", "measured"))
def table(request) -> Table:
    return SMALL if request.param == "small" else load_table()


def test_parts_sum_to_the_total(table):
    report = frame_energy(WORK, 5000, PAPER, table)
    assert sum(report.sum_mj(part) for part in PARTS) == pytest.approx(report.total_mj, rel=1e-12)
    assert sum(sum(parts.values()) for parts in report.by_unit().values()) == pytest.approx(report.total_mj, rel=1e-12)
    assert report.chip_mj == pytest.approx(sum(report.sum_mj(part) for part in CHIP))
    assert all(row.value_mj == pytest.approx(row.operations * row.coefficient_pj * 1e-9) for row in report.rows)
    content = report.as_json()
    assert sum(content["by_part_mj"].values()) == pytest.approx(content["total_mj"])
    assert sum(content["pj_per_entry"].values()) * WORK.entries * 1e-9 == pytest.approx(content["total_mj"])


def test_more_of_any_work_costs_more(table):
    before = frame_energy(WORK, 5000, PAPER.with_(stereo=True), table)
    for field in fields(WorkCounts):
        more = replace(WORK, **{field.name: (getattr(WORK, field.name) or 0) + 7})
        after = frame_energy(more, 5000, PAPER.with_(stereo=True), table)
        costs = {unit.operation for unit in table.units} | {"read_beats", "write_beats", "activates", "refreshes"}
        if field.name in costs or (field.name == "spilled_entries" and "sorted_entries" in costs):
            assert after.total_mj > before.total_mj, field.name
        else:
            assert after.total_mj == before.total_mj, field.name
    longer = frame_energy(WORK, 6000, PAPER, table)
    shorter = frame_energy(WORK, 5000, PAPER, table)
    for part in ("clock", "leakage", "dram"):
        assert longer.sum_mj(part) > shorter.sum_mj(part)
    assert longer.sum_mj("dynamic", "sram") == shorter.sum_mj("dynamic", "sram")


def test_no_work_costs_clock_and_leakage_only(table):
    report = frame_energy(WorkCounts(), 5000, PAPER, table)
    assert report.sum_mj("dynamic") == report.sum_mj("sram") == 0
    assert report.sum_mj("clock") > 0 < report.sum_mj("leakage")
    assert report.sum_mj("assumed") == pytest.approx(estimates().clock_tree.value * report.sum_mj("clock"))
    idle = LPDDR3.channels * (LPDDR3.open_mw + LPDDR3.interface.clock_mw)
    assert report.sum_mj("dram") == pytest.approx(idle * 5000 * 1e-9)
    nothing = frame_energy(WorkCounts(), 0, PAPER, table)
    assert nothing.total_mj == 0


def test_by_hand():
    report = frame_energy(WORK, 5000, PAPER, SMALL)
    assert report.sum_mj("dynamic") == pytest.approx(2.5 * (100 * 3 + 350 * 40) * 1e-9)
    assert report.sum_mj("clock") == pytest.approx(2.5 * 5000 * 11 * 1e-9)
    bits = 1024 * 64 * 0.25 * 200e-9
    assert report.sum_mj("leakage") == pytest.approx(2.5 * (0.875 + bits) * 5000 * 1e-9)
    assert report.sum_mj("sram") == pytest.approx(350 * 1.5 * 10 / 7.16 * 1e-9)  # 8 KB, 64 bits: Horowitz' first number
    slower = frame_energy(WORK, 5000, PAPER, SMALL, clock_hz=5e8)
    assert slower.sum_mj("leakage") == pytest.approx(2 * report.sum_mj("leakage"))
    assert slower.sum_mj("dynamic", "clock", "sram") == pytest.approx(report.sum_mj("dynamic", "clock", "sram"))


def test_a_smaller_machine_has_less_to_clock():
    half, whole = (frame_energy(WORK, 5000, PAPER.with_(cores_y=y), SMALL).by_unit()["cores"] for y in (8, 16))
    assert half["clock"] == pytest.approx(whole["clock"] / 2) and half["dynamic"] == pytest.approx(whole["dynamic"] / 2)
    fewer = frame_energy(WORK, 5000, PAPER_SMALL, SMALL)
    assert fewer.by_unit()["adder"]["clock"] == pytest.approx(2.5 * 5000 * 2 / 4 * 1e-9)


def test_every_row_says_what_it_is_from(table):
    for row in frame_energy(WORK, 5000, PAPER, table).rows:
        assert row.part in PARTS and row.unit and row.operation
        assert all(len(text) > 3 for text in (row.node, row.source, row.scaling)), row


def test_memories():
    for bits, energy in SRAM_POINTS:
        assert sram_access_pj(bits // 64, 64) == pytest.approx(energy * SRAM_TO_16NM)
    shapes = [sram_access_pj(1 << k, 64) for k in range(7, 20)]
    assert shapes == sorted(shapes) and shapes[0] < shapes[-1]
    assert sram_access_pj(512, 128) == pytest.approx(2 * sram_access_pj(1024, 64))
    assert sram_access_pj(4, 8) == pytest.approx(sram_access_pj(16, 8))  # no smaller than the smallest


def test_bad_values_are_named(tmp_path):
    for cycles in (0, -1, 2.5):
        with pytest.raises(ValueError, match="cycles must"):
            frame_energy(WORK, cycles, PAPER, SMALL)
    with pytest.raises(ValueError, match="clock_hz must"):
        frame_energy(WORK, 10, PAPER, SMALL, clock_hz=0)
    for value in (-1, 1.5, True):
        with pytest.raises(ValueError, match="points must"):
            WorkCounts(points=value)
    with pytest.raises(ValueError, match="operation must"):
        WORK.of("unknown")
    with pytest.raises(InputError, match=r"energy_per_operation"):
        load_table(tmp_path / "absent.json")
    (tmp_path / "other.json").write_text("{}")
    with pytest.raises(InputError, match="without 'units'"):
        load_table(tmp_path / "other.json")


def test_report_of_a_frame_through_the_rtl(tmp_path):
    rows = json.loads((TABLE.parent / "machine.json").read_text())["rows"]
    frame = next(row for row in rows if row["scene"] == "embedded" and row["gaze"])
    path = tmp_path / "frame.json"
    path.write_text(json.dumps(frame))
    assert study.main(["--frame", str(path), "--out", str(tmp_path)]) == 0
    content = json.loads((tmp_path / "energy.json").read_text())
    (found,) = content["frames"]
    assert found["memory"] == "ideal" and found["dram_not_counted"] == ["activates", "refreshes"]
    expected = frame_energy(counter_counts(frame), study.counted_cycles(frame), PAPER, load_table())
    assert found["total_mj"] == pytest.approx(expected.total_mj, abs=ROUNDED) and found["work"] == "RTL counters"
    assert 0.9 * frame["frame_cycles"] < found["cycles"] < frame["frame_cycles"]
    assert found["counts"]["points"] == frame["events"]["points"]
    assert all(price[key] for price in content["prices"] for key in ("node", "source", "scaling"))
    assert {price["unit"] for price in content["prices"]} == set(found["by_unit_mj"])
    page = (tmp_path / "energy.md").read_text()
    assert content["commit"] in page and f"{expected.chip_mj:.3f}" in page and "not counted" in page
    for unit in load_table().units:
        assert unit.name in page
    path.write_text("{}")
    with pytest.raises(InputError, match=r"frame\.json"):
        study.main(["--frame", str(path), "--out", str(tmp_path)])
    with pytest.raises(InputError, match="config 'huge'"):
        study.main(["--config", "huge", "--out", str(tmp_path)])


@pytest.mark.long
def test_the_model_counts_what_the_machine_counted(tmp_path):
    """The embedded frame of reports/machine.json, every count of it."""
    rows = json.loads((TABLE.parent / "machine.json").read_text())["rows"]
    frame = next(row for row in rows if row["scene"] == "embedded" and row["gaze"] and row["merge"] and row["pipeline"])
    width, height = frame["size"]
    gaze = ",".join(f"{x:g}" for x in frame["gaze"])
    assert study.main(["embedded", "--size", f"{width}x{height}", "--gaze", gaze, "--levels", str(frame["levels"]),
                               "--out", str(tmp_path)]) == 0
    first, found = json.loads((tmp_path / "energy.json").read_text())["frames"]
    assert (first["memory"], found["memory"]) == ("lpddr3", "ideal") and first["cycles"] > found["cycles"]
    assert first["dram_mj"] > found["dram_mj"] and first["counts"]["activates"] > 0 and not first["dram_not_counted"]
    assert WorkCounts(**found["counts"]) == counter_counts(frame)
    assert found["cycles"] == pytest.approx(study.counted_cycles(frame), rel=0.02)
