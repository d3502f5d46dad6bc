"""Rows of what training reaches: means over seeds, of runs that differ in nothing else."""

import json

import pytest

pytest.importorskip("numpy")

from msv2.studies.destination import tell
from msv2.studies.training import headline
from spec.errors import InputError


def report(seed=0, l1=29.7, variant="H", points=(40_000, 10_000, 5000, 2500, 1000), scene="bonsai"):
    excess = [{"excess_percent": above, "excess_test_percent": above + 3} for above in (0.0, 1.0, 2.0, 4.0)]
    return {
        "scene": scene, "size": [200, 100], "psnr_dense": 30.0, "psnr_dense_all": 28.0, "psnr_l1": l1,
        "entries_per_frame": {"dense": 9000.0, "l1": 3000.0, "foveated": 1500.0}, "levels": excess,
        "storage": {"overhead_percent": 5.5}, "points": {"dense": points[0], "levels": list(points[1:])},
        "options": {"seed": seed, "variant": variant, "gate": "psnr", "pooling": "blocks", "iterations": 100}}


def test_seeds_share_a_row_and_variants_do_not():
    rows = headline.rows([report(), report(variant="M"), report(seed=1, l1=30.3)])
    assert [(row["scene"], row["variant"], row["seeds"]) for row in rows] == [("bonsai", "H", [0, 1]), ("bonsai", "M", [0])]
    first = rows[0]
    assert first["l1_psnr_share"] == pytest.approx(1.0) and rows[1]["l1_psnr_share"] == pytest.approx(0.99)
    assert (first["dense_psnr_db"], first["dense_psnr_all_db"], first["cut"], first["cut_foveated"]) == (30.0, 28.0, 3.0, 6.0)
    assert first["points_share"] == [1.0, 0.5, 0.25, 0.1] and first["storage_over_l1"] == pytest.approx(0.055)
    assert first["points_per_pixel"] == 2.0 and first["l1_points_per_pixel"] == 0.5
    assert first["hvsq_over_l1_test"] == pytest.approx([0.03, 0.04, 0.05, 0.07])


def test_the_table_says_what_the_rows_hold():
    one_level = report(scene="fern") | {"entries_per_frame": {"dense": 9000.0, "l1": 3000.0}}
    lines = headline.text(headline.rows([report(), one_level])).splitlines()
    assert lines[2] == ("| bonsai, 200x100 | H | 1 | 2.00, 0.50 | 30.00 | 99.00 % | 3.00 | 6.00 | 50 %, 25 %, 10 % | +5.5 % | "
                        "+1 %, +2 %, +4 % | +4 %, +5 %, +7 % |")
    assert "| 3.00 |  | 50 %" in lines[3]


def test_runs_that_cannot_share_a_row_are_refused():
    with pytest.raises(InputError, match=r"seed \[0, 0\] of bonsai"):
        headline.rows([report(), report()])
    with pytest.raises(InputError, match="earlier version"):
        headline.rows([{"scene": "bonsai"}])


def test_the_command_writes_the_report(tmp_path, monkeypatch, capsys):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "report.json").write_text(json.dumps(report()))
    monkeypatch.setattr(headline, "REPORTS", tmp_path)
    tell(keep=False, named=False)
    assert headline.main([str(tmp_path / "run")]) == 0
    assert "bonsai, 200x100" in capsys.readouterr().out
    written = json.loads((tmp_path / "training_headline.json").read_text())
    assert written["rows"] == headline.rows([report()]) and written["provenance"]["sources"]


def test_added_rows_replace_only_their_own(tmp_path, monkeypatch):
    monkeypatch.setattr(headline, "REPORTS", tmp_path)
    tell(keep=False, named=False)

    def wrote(*runs, added):
        for number, run in enumerate(runs):
            (tmp_path / str(number)).mkdir(exist_ok=True)
            (tmp_path / str(number) / "report.json").write_text(json.dumps(run))
        folders = [str(tmp_path / str(number)) for number in range(len(runs))]
        assert headline.main([*folders, *(["--add"] if added else [])]) == 0
        rows = json.loads((tmp_path / "training_headline.json").read_text())["rows"]
        return [(row["scene"], row["variant"], row["seeds"]) for row in rows]

    both = [("bonsai", "H", [0]), ("fern", "H", [0])]
    assert wrote(report(scene="fern"), report(), added=True) == both[::-1]  # nothing is kept yet
    assert wrote(report(variant="M"), added=True) == [both[0], ("bonsai", "M", [0]), both[1]]
    assert wrote(report(seed=4), added=True) == [("bonsai", "H", [4]), ("bonsai", "M", [0]), both[1]]
    longer = report(seed=5)
    longer["options"]["iterations"] *= 2  # a row of fewer iterations is not kept beside it
    assert wrote(longer, added=True) == [("bonsai", "H", [5]), ("bonsai", "M", [0]), both[1]]
    assert wrote(report(), added=False) == both[:1]
