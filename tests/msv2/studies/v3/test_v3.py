"""The study of the steps from `paper` to `v3`."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest

from golden.msv2_ref.buckets import next_bounds
from golden.scenes.load import EMBEDDED
from golden.scenes.request import resolve
from msv2.studies.memory import IDEAL, LPDDR3
from msv2.studies.performance.frames import request
from msv2.studies.v3 import frames, photographs, study, summary, supertiles
from msv2.studies.v3.page import page
from spec.config import PAPER, V3, V3_EYES_LARGE, V3_PACKED, V3_RECORDS, V3_STREAMS_PACKED
from spec.errors import InputError


def row(frame: str, machine: str, memory: str, cycles: int, total: int, **more: object) -> dict[str, object]:
    return {"frame": frame, "scene": frame, "size": "64x48", "machine": machine, "memory": memory, "cycles": cycles,
            "phases": {"geometry": cycles // 2, "render": cycles // 2}, "bytes": {"read": {"geometry": total}, "write": {}},
            "total_bytes": total, "activates": cycles // 10, "refreshes": 1, "points": 100, "points_read": 100, "chunks": None,
            "chunks_read": None, "survivors": 50, "entries": 60,
            "energy_mj": {"chip": 1e-6 * cycles, "dram": 2e-6 * cycles, "dram_by_use": {}}} | more


@pytest.fixture
def rows() -> list[dict[str, object]]:
    """Two frames. `v3_records` is 2 and 8 times as fast, which is 4 as a geometric mean, and moves half of the bytes. `v3`
    is twice as fast again, and moves a quarter of them."""
    out = []
    for frame, gain in (("truck", 2), ("garden_large", 8)):
        for memory, cycles in ((LPDDR3, 8_000), (IDEAL, 4_000)):
            for machine in frames.MACHINES:
                records = machine == V3_RECORDS.name
                out.append(row(frame, machine, memory, cycles // gain if records else cycles, 500 if records else 1000,
                               **({"chunks": 10, "chunks_read": 10 // gain} if records else {})))
            out.append(row(frame, V3.name, memory, cycles // gain // 2, 250, size="640x360", pairs=55, places=60,
                           lists=4, batches=5, visits=12, header_misses=3))
    return out


def photo(scene: str, levels: int, loss: float) -> dict[str, object]:
    return {"scene": scene, "size": "64x48", "points": 10, "sh_degree": 3, "levels": levels, "views": 2, "paper_db": 27.0,
            "v3_db": 27.0 - loss, "loss_db": loss, "worst_view_db": loss, "limit_db": photographs.LIMITS[levels]}


def over(share: float, degrees: float | None, foveated: bool = True) -> dict[str, object]:
    return {"frame": "truck", "scene": "truck", "size": "64x48", "foveated": foveated, "degrees": degrees, "pairs": 1000,
            "lists": 4, "largest": 5000, "overflow": round(1000 * share), "overflow_share": share}


def test_gains_are_geometric_means_over_the_frames(rows):
    gains = summary.gains(rows, V3_RECORDS.name)
    assert math.isclose(gains["lpddr3_gain"], 4) and math.isclose(gains["ideal_gain"], 4)
    assert math.isclose(gains["bytes_gain"], 2) and math.isclose(gains["dram_energy_gain"], 4)
    assert math.isclose(summary.gains(rows, "paper, spatial order")["lpddr3_gain"], 1)


def test_steps_have_the_worst_loss_and_their_parts_beside_them(rows):
    step = summary.steps(rows, [photo("fern", 4, 0.004), photo("bonsai", 1, -0.001)], [])["records"]
    assert step["worst_photo_loss_db"] == 0.004
    assert set(step["beside"]) == {"paper, spatial order", "chunks, wide records"}
    assert step["chunks_read"] == {"truck": 0.5, "garden_large": 0.1}
    assert summary.steps(rows, [], [])["records"]["worst_photo_loss_db"] is None


def test_the_step_to_super_tiles_has_its_gains_and_the_worst_overflow_of_foveated_turns(rows):
    turns = [over(0.002, 2.0), over(0.001, 0.5), over(0.5, None), over(0.3, 2.0, foveated=False)]
    step = summary.steps(rows, [], turns)["supertiles"]
    assert math.isclose(step["ideal_gain"], 8) and math.isclose(step["lpddr3_gain"], 8)
    assert math.isclose(step["bytes_gain"], 4) and math.isclose(step["worst_bytes_gain_captured"], 4)
    assert step["overflow_share"] == 0.002 and step["overflow"] == turns
    embedded = [r | {"scene": EMBEDDED} for r in rows]
    assert summary.steps(embedded, [], [])["supertiles"]["worst_bytes_gain_captured"] is None
    goals = {goal["goal"]: goal["reached"] for goal in summary.goals(rows, [], turns)}
    assert goals["super-tiles: ideal cycles of a frame, times fewer"]
    assert goals["super-tiles: share of pairs that overflow after a turn"] is False
    assert summary.goals(rows, [], [])[-1]["reached"] is None


def test_the_step_to_packed_frames_is_in_reports_that_have_it(rows):
    assert "packed" not in summary.steps(rows, [], [])
    packed = [r | {"machine": V3_PACKED.name, "cycles": r["cycles"] // 2, "total_bytes": 125, "bytes": {
        "read": {}, "write": {"frame": 40}}} for r in rows if r["machine"] == V3.name]
    plain = [r | {"bytes": {"read": {}, "write": {"frame": 100}}} if r["machine"] == V3.name else r for r in rows]
    step = summary.steps([*plain, *packed], [], [])["packed"]
    assert math.isclose(step["bytes_gain"], 8) and math.isclose(step["over_v3"]["bytes_gain"], 2)
    assert math.isclose(step["over_v3"]["lpddr3_gain"], 2) and math.isclose(step["ideal_gain"], 16)
    content = {"missing": [], "missing_runs": [], "ordered": [], "goals": [], "steps": summary.steps([*plain, *packed], [], []),
               "frames": [*plain, *packed], "photographs": [], "orders": []}
    text = page(content)
    assert "| truck | 2.000 | 2.000 | 2.000 | 0.400 |" in text and "## Packed frames" in text
    assert "## Packed frames" not in page(content | {"frames": plain, "steps": summary.steps(plain, [], [])})


def test_the_step_to_four_arrays_has_both_eyes_beside_it(rows):
    assert "streams" not in summary.steps(rows, [], [])
    four = [r | {"machine": V3_STREAMS_PACKED.name, "cycles": r["cycles"] / 4} for r in rows
            if r["machine"] == V3.name]
    eyes = {f"{V3_EYES_LARGE.name}, {memory}": {"two_eyes_gain": gain, "second_eye_share": 0.5}
            for memory, gain in ((LPDDR3, 3.5), (IDEAL, 2.5))}
    over_gscore = [{"machine": "other", "gscore_like_gain": {}},
                   {"machine": V3_STREAMS_PACKED.name, "gscore_like_gain": {LPDDR3: 3.7, IDEAL: 3.2}}]
    alone, both = (summary.steps([*rows, *four], [], [], *given) for given in ((), (eyes, over_gscore)))
    assert (both["streams"]["gscore_like_gain"], both["streams"]["gscore_like_gain_ideal"]) == (3.7, 3.2)
    assert alone["streams"]["gscore_like_gain"] is None
    goals = {goal["goal"]: goal["reached"] for goal in summary.goals([*rows, *four], [], [])}
    assert goals["four arrays, packed frames: ideal cycles of a frame, times fewer"]
    assert math.isclose(both["streams"]["over_v3"]["ideal_gain"], 4) and math.isclose(both["streams"]["lpddr3_gain"], 32)
    assert both["streams"]["two_eyes_gain"] == 3.5 and both["streams"]["two_eyes_gain_ideal"] == 2.5
    content = {"missing": [], "missing_runs": [], "ordered": [], "goals": [], "frames": [*rows, *four], "photographs": [],
               "orders": []}
    assert all(text in page(content | {"steps": both}) for text in ("take 3.50 times fewer", "3.70 times as fast"))
    assert "## Four arrays" in page(content | {"steps": alone}) and "Both eyes" not in page(content | {"steps": alone})
    assert "GSCore" not in page(content | {"steps": alone})


@pytest.mark.parametrize(("loss", "reached"), ((0.0049, True), (0.0051, False)))
def test_goals_are_judged(rows, loss, reached):
    goals = {goal["goal"]: goal["reached"] for goal in summary.goals(
        rows, [photo("fern", 1, loss), photo("fern", 4, loss)], [])}
    assert goals["bytes of a frame, times fewer"] and goals["LPDDR3 cycles of a frame, times fewer"]
    assert goals["share of garden_large's chunks that is read"]
    assert goals["dB lost against photographs, 1 level"] is reached
    assert goals["dB lost against photographs, 4 levels"]
    slower = [r | {"cycles": 8_000} if r["machine"] == V3_RECORDS.name else r for r in rows]
    assert not {g["goal"]: g["reached"] for g in summary.goals(slower, [], [])}["LPDDR3 cycles of a frame, times fewer"]


def test_the_page_shows_lpddr3_first_and_every_goal(rows):
    lost = [photo("fern", 1, 0.006)]
    content = {"missing": ["rock_sh3"], "missing_runs": ["bonsai"], "ordered": [], "goals": summary.goals(rows, lost, []),
               "steps": summary.steps(rows, [], [over(0.25, None)]), "frames": rows, "photographs": lost, "orders": []}
    text = page(content)
    assert text.index("4 x LPDDR3-1600") < text.index("ideal, 25.6 B a cycle")
    assert "missed" in text and "Missing: rock_sh3." in text and "No finished run in build/train: bonsai." in text
    assert "| truck | 8,000 | 8,000 | 8,000 | 4,000 | 2,000 | 4.000 |" in text
    assert "| truck | 4 | cut | 1,000 | 4 | 5,000 | 0.2500 |" in text


def test_a_small_frame_is_measured_on_every_machine(tmp_path):
    study.main([EMBEDDED, "--size", "96x64", "--orders", "0", "--photographs", "0", "--out", str(tmp_path)])
    content = json.loads((tmp_path / "v3.json").read_text())
    found = {(r["machine"], r["memory"]): r for r in content["frames"]}
    assert len(found) == (len(frames.MACHINES) + 3) * len(frames.MEMORIES)
    paper, spatial, wide, records = (found[name, LPDDR3] for name in frames.MACHINES)
    assert paper["total_bytes"] > records["total_bytes"] and paper["points_read"] == paper["points"] >= records["points_read"]
    assert spatial["bytes"]["read"]["geometry"] == paper["bytes"]["read"]["geometry"] >= wide["bytes"]["read"]["geometry"]
    assert records["bytes"]["read"]["chunks"] == 32 * records["chunks"] and "chunks" not in paper["bytes"]["read"]
    assert records["bytes"]["read"]["geometry"] < 0.6 * wide["bytes"]["read"]["geometry"]
    supers = found[V3.name, LPDDR3]
    assert supers["total_bytes"] < records["total_bytes"] and supers["energy_mj"]["dram"] < records["energy_mj"]["dram"]
    assert supers["bytes"]["read"]["geometry"] == records["bytes"]["read"]["geometry"]
    assert supers["entries"] == records["entries"] and supers["survivors"] == records["survivors"] <= supers["pairs"]
    assert "views" not in supers["bytes"]["read"] and content["steps"]["supertiles"]["overflow"] == []
    packed = found[V3_PACKED.name, LPDDR3]
    assert packed["bytes"]["read"] == supers["bytes"]["read"]
    assert packed["bytes"]["write"]["frame"] < 0.9 * supers["bytes"]["write"]["frame"] == 0.9 * 4 * 96 * 64
    assert PAPER.name in (tmp_path / "v3.md").read_text()


def test_photographs_whose_run_is_missing_stay_as_they_were():
    old = {"photographs": [photo("fern", 4, 0.004), photo("bonsai", 1, 0.001)]}
    assert study._kept(old, ["fern"]) == old["photographs"][:1] and study._kept({}, ["fern"]) == study._kept(old, []) == []


def test_bounds_of_a_frame_keep_the_next_one_from_overflowing(monkeypatch):
    """With lists above 1,024 pairs counted as too long, and a bound after every 512."""
    monkeypatch.setattr(supertiles, "V3", V3.with_(sort_buffer_bytes=1 << 14))
    monkeypatch.setattr(supertiles, "next_bounds", lambda config, start, key: next_bounds(config, start, key, 512))
    rows = supertiles.overflow_rows(frames.Subject(EMBEDDED, "128x96"))
    assert [(r["foveated"], r["degrees"]) for r in rows] == [
        (foveated, degrees) for foveated in (True, False) for degrees in (*supertiles.TURNS, None)]
    for small, large, cut in (rows[:3], rows[3:]):
        assert small["pairs"] == cut["pairs"] and small["lists"] > cut["lists"]
        assert max(small["overflow"], large["overflow"]) < 0.2 * cut["overflow"] and cut["largest"] > 1024


def test_a_turned_camera_sees_the_scene_from_the_side():
    camera = resolve(request(EMBEDDED, "64x48")).camera
    same = supertiles.turned(camera, 0, 0)
    assert (same.rotation == camera.rotation).all() and (same.translation == camera.translation).all()
    other = supertiles.turned(camera, 2, 0.005)
    angle = np.degrees(np.arccos(np.clip(other.rotation[2] @ camera.rotation[2], -1, 1)))
    assert angle == pytest.approx(2, abs=1e-3)
    moved = np.linalg.norm(other.rotation.T @ other.translation - camera.rotation.T @ camera.translation)
    assert moved == pytest.approx(0.005, rel=1e-6)


def test_a_kept_report_is_summarised_anew(rows, tmp_path):
    """Its rows stay, and nothing is measured; without a kept report of all frames there is nothing to summarise."""
    kept = {"frames": rows, "photographs": [photo("fern", 1, 0.006)], "order_frames": [], "goals": [], "steps": {},
            "orders": [], "missing": []}
    found = study.summarised(kept, [over(0.002, 2.0)])
    assert {key for key in kept if found[key] != kept[key]} == {"goals", "steps"}
    assert found["goals"] == summary.goals(rows, kept["photographs"], [over(0.002, 2.0)])
    assert found["steps"]["supertiles"]["overflow_share"] == 0.002
    with pytest.raises(InputError, match="--anew is not accepted"):
        study.main([EMBEDDED, "--anew", "--out", str(tmp_path)])


def test_parts_that_are_not_asked_for_stay_as_they_were_kept(monkeypatch):
    monkeypatch.setattr(frames, "chosen", lambda args: ([], []))
    old = {"photographs": [photo("fern", 1, 0.006)], "ordered": ["a"], "order_frames": [],
           "steps": {"supertiles": {"overflow": [over(0.002, 2.0)]}}}
    parts = ["--orders", "0", "--turns", "0", "--photographs", "0"]
    found = study.measure(study._arguments(parts), old)
    assert (found["photographs"], found["ordered"]) == (old["photographs"], ["a"])
    assert found["steps"]["supertiles"]["overflow"] == old["steps"]["supertiles"]["overflow"]
    bare = study.measure(study._arguments(parts), {})
    assert bare["photographs"] == bare["ordered"] == bare["steps"]["supertiles"]["overflow"] == []
