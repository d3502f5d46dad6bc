"""Rules of the warp side by side; needs torch for HVSQ."""

from __future__ import annotations

import json

import pytest

pytest.importorskip("torch", reason="PyTorch is not installed")

from msv2.studies.stereo_rules import study as stereo_rules
from spec.config import PAPER


def test_the_report_of_rules(tmp_path, monkeypatch):
    monkeypatch.setenv("MSV2_DATA", str(tmp_path))
    monkeypatch.setattr(stereo_rules, "TRAINED", ())
    stereo_rules.main(["--size", "128x72", "--views", "3", "--out", str(tmp_path)])
    rows = json.loads((tmp_path / "stereo_rules.json").read_text())["rows"]
    assert [r["levels"] for r in rows] == [1, 4]
    for r in rows:
        again, rules = r["shares"]["tiles_rerendered"], r["rules"]
        built = rules[PAPER.warp_fill]
        assert built["rerendered"] == again <= rules["interior"]["rerendered"]
        assert rules["majority, veiled"]["rerendered"] <= again and built["filled"] == pytest.approx(r["shares"]["filled"])
        assert (built["psnr_warped_db"] is None) == (again + r["shares"]["tiles_foveal"] == 1)
        for shares in r["causes"].values():
            assert all(0 <= cause["alone"] <= cause["any"] <= 1 for cause in shares.values())
            assert sum(cause["any"] for cause in shares.values()) >= 1 >= sum(cause["alone"] for cause in shares.values())
    whole = rows[0]["rules"]
    assert whole["majority"]["rerendered"] < whole["interior"]["rerendered"]
    assert whole["rendered"]["hvsq_level_1"] == 0 < whole["majority"]["hvsq_pair"] == whole["majority"]["hvsq_level_1"]
    assert whole["majority"]["psnr_target_db"] > whole["majority"]["psnr_warped_db"] > 20
    assert rows[1]["rules"]["majority"]["hvsq_pair"] < rows[1]["rules"]["rendered"]["hvsq_level_1"]
    assert (tmp_path / "stereo_rules.md").read_text().count("| embedded, embedded_03 |") == 6
