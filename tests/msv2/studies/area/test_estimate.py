"""Areas of machines that were not synthesised: near those that were, and larger for more of anything."""

from __future__ import annotations

import json

import pytest

from msv2.studies.area import estimate
from msv2.studies.area.estimate import BUILDS, ESTIMATE, SHORTENED, SYNTHESISED, estimate_area
from spec.config import PAPER, TINY, V3, V3_RECORDS, V3_STREAMS
from spec.errors import InputError
from spec.paths import REPORTS


@pytest.mark.parametrize("name", BUILDS)
def test_a_synthesised_build_has_its_reports_area(name):
    found = estimate_area(BUILDS[name])
    report = json.loads(estimate.REPORT.read_text())["builds"][name]
    assert (found.basis, found.build) == (SYNTHESISED, name) and found.synthesised
    assert found.mm2 == pytest.approx(report["mm2_16nm"], abs=1e-4)
    assert found.mm2 == pytest.approx(found.logic_mm2 + found.memory_mm2)


def test_no_unit_of_the_builds_at_1_ghz_is_late_in_the_machine():
    """By itself a unit is timed with assumed times at its ports and memories. Where these alone make it late, the linked
    machine, which has the real ones, decides."""
    builds = json.loads(estimate.REPORT.read_text())["builds"]
    linked = json.loads((REPORTS / "machine_timing.json").read_text())["machines"]
    late = {name for name in BUILDS if builds[name]["late_units"]}
    assert {name for name in late if linked[builds[name]["config"]]["typical"]["late_endpoints"]} == set()
    assert all(builds[name]["worst_slack_ps"] > -0.01 * builds[name]["clock_ps"] for name in BUILDS)


@pytest.mark.parametrize("name", SHORTENED)
def test_estimates_with_the_presets_formats_are_near_their_builds(name, monkeypatch):
    report = json.loads(estimate.REPORT.read_text())["builds"][name]
    monkeypatch.setattr(estimate, "BUILDS", {build: BUILDS[build] for build in ("mono", "1ghz")})
    found = estimate_area(SHORTENED[name])
    assert (found.basis, found.build) == (ESTIMATE, "mono")
    assert found.mm2 == pytest.approx(report["mm2_16nm"], rel=0.01)
    for group, area in found.groups.items():
        # the sorter's logic is mapped to 15 % more where its words are two bits shorter, which no estimate can know
        assert area.logic_um2 == pytest.approx(report["groups"][group]["logic_um2_16nm"], rel=0.08), group
        assert area.memory_um2 == pytest.approx(report["groups"][group]["memory_um2_16nm"], rel=0.04, abs=1), group


def test_an_estimate_goes_on_from_the_build():
    """A machine that differs by nothing that has an area is the build; the least change moves it a little."""
    assert estimate_area(PAPER.with_(support_sigma=2.0, name="other")).mm2 == estimate_area(PAPER).mm2
    little = estimate_area(PAPER.with_(line_buffer_bytes=1032))
    assert little.basis == ESTIMATE and little.mm2 == pytest.approx(estimate_area(PAPER).mm2, rel=0.002)


@pytest.mark.parametrize(("field", "values"), [
    ("splat_cache_lines", (64, 256, 1024, 2048, 4096, 65536)), ("sort_buffer_bytes", (4096, 16384, 65536, 1 << 18)),
    ("merge_ways", (2, 8, 32)), ("row_width", (640, 1280, 1920, 3840)), ("culling_units", (1, 2, 4, 8)),
    ("cores_y", (2, 4, 8, 16)), ("sh_degree", (0, 1, 2, 3))])
def test_more_is_larger(field, values):
    areas = [estimate_area(PAPER.with_(**{field: value})).mm2 for value in values]
    assert areas == sorted(areas) and len(set(areas)) == len(areas)


def test_a_smaller_array_does_not_lose_the_sums_of_its_tile():
    """A quarter of the cores hold four times the sums, so that their logic is more than a quarter."""
    array = {cores: estimate_area(PAPER.with_(cores_x=cores, cores_y=cores)).groups["array"].logic_um2 for cores in (8, 16)}
    assert array[16] / 4 < array[8] < array[16] / 2
    assert estimate_area(TINY).mm2 < 0.4 * estimate_area(PAPER).mm2


def test_a_missing_report_is_named(monkeypatch, tmp_path):
    estimate._report.cache_clear()
    monkeypatch.setattr(estimate, "REPORT", tmp_path / "absent.json")
    with pytest.raises(InputError, match=r"absent\.json is not a report of areas"):
        estimate_area(PAPER)
    estimate._report.cache_clear()


def test_lists_by_super_tile_are_estimated_from_a_build_of_their_own():
    found = estimate_area(V3.with_(header_lines=2 * V3.header_lines))
    assert (found.basis, found.build) == (ESTIMATE, "v3")
    assert estimate_area(V3).mm2 < found.mm2 < 1.02 * estimate_area(V3).mm2
    assert estimate_area(V3).logic_mm2 == pytest.approx(found.logic_mm2)


def test_chunks_add_the_logic_of_their_units():
    """Beside the smaller reader that goes: the logic of no other group changes but colour's."""
    chunks, without = (estimate_area(config).groups for config in (V3_RECORDS, PAPER))
    more = {group: area.logic_um2 - without[group].logic_um2 for group, area in chunks.items()}
    units = {row["unit"]: row["logic_um2_16nm"] for row in json.loads(estimate.REPORT.read_text())["builds"]["v3"]["units"]}
    assert more["culling and conversion"] == pytest.approx(units["geometry.bounds"] + units["geometry.chunk_test"])
    assert 0 < more["lists and memory ports"] < units["geometry.headers"] + units["geometry.reader"] + units["queue_chunks"]
    assert more["array"] == more["sorting and tile merging"] == 0


def test_several_streams_cost_what_every_array_has_of_its_own():
    four, one = (estimate_area(config).groups for config in (V3_STREAMS, V3))
    assert 1.02 * estimate_area(V3).mm2 < estimate_area(V3_STREAMS).mm2 < 1.15 * estimate_area(V3).mm2
    for group in one:
        changes = group in ("array", "blending")
        assert (four[group].logic_um2 > one[group].logic_um2) == changes, group
    setup = next(row["logic_um2_16nm"] for row in json.loads(estimate.REPORT.read_text())["builds"]["v3"]["units"]
                 if row["unit"] == "render.array.setup")
    assert four["array"].logic_um2 - one["array"].logic_um2 > 3 * setup
