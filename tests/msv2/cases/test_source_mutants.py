"""Mutants of Python: what is drawn, what is left out, and that a fault in a small project is noticed by what looks at it."""

from __future__ import annotations

import ast
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from msv2.cases.source_mutants import draw, play, worker
from msv2.cases.source_mutants.draw import SourceMutant, mutated, sites
from msv2.cases.source_mutants.equal import EQUAL, changed_line
from msv2.cases.source_mutants.play import PARTS
from msv2.cli import check
from msv2.studies.source_mutants import study
from spec.errors import InputError
from spec.paths import ROOT

MODULE = '''"""A module with 3 and x < 4 in its docstring."""
SIZE: int = 12
SCALE = 0.5


@decorated(7)
def clipped(x: int, most: int = SIZE) -> int:
    """Clips 5."""
    if x < 0:
        raise ValueError(f"x must not be {x + 1}")
    assert x != 9
    return min(x << 1, most) if not x > 3 and True else -x
'''


def changes() -> list[str]:
    return [f"{node.lineno}: {words}" for node, words, _ in sites(ast.parse(MODULE))]


def test_every_kind_of_change_is_found_and_nothing_that_only_refuses():
    assert changes() == [
        "2: 12 to 13", "3: 0.5 to 0.505", "12: And to Or", "12: no Not", "12: Gt to GtE", "12: 3 to 4", "12: True to False",
        "12: min to max", "12: LShift to RShift", "12: 1 to 2", "12: no USub"]


@pytest.mark.parametrize(("number", "line"), [
    (0, "SIZE: int = 13"), (1, "SCALE = 0.505"), (2, "return min(x << 1, most) if not x > 3 or True else -x"),
    (3, "return min(x << 1, most) if +(x > 3) and True else -x"), (7, "return max(x << 1, most) if not x > 3 and True else -x"),
    (10, "return min(x << 1, most) if not x > 3 and True else +x")])
def test_a_mutant_changes_one_place(number: int, line: str):
    sound, text = ast.unparse(ast.parse(MODULE)), mutated(MODULE, SourceMutant("module.py", 1, "", number))
    (changed,) = [b for a, b in zip(sound.splitlines(), text.splitlines(), strict=True) if a != b]
    assert changed.strip() == line


def test_draws_are_repeatable_and_bounded(tmp_path: Path):
    (tmp_path / "module.py").write_text(MODULE)
    found = draw.draw(["module.py"], 5, 1, tmp_path)
    assert found == draw.draw(["module.py"], 5, 1, tmp_path) != draw.draw(["module.py"], 5, 2, tmp_path)
    assert len({mutant.number for mutant in found}) == 5 and found == sorted(found, key=lambda mutant: mutant.number)
    with pytest.raises(InputError, match="12 mutants are not accepted: 1 to 11 are"):
        draw.draw(["module.py"], 12, 1, tmp_path)


def test_every_module_of_a_part_can_be_mutated():
    for part in PARTS.values():
        for mutant in draw.draw(part.paths, 25, 3, ROOT):
            compile(mutated((ROOT / mutant.path).read_text(), mutant), mutant.path, "exec")
        assert all((ROOT / tests).is_dir() for tests in (*part.tests, *part.first))


def test_tests_that_import_the_module_come_first(tmp_path: Path):
    (tmp_path / "tests").mkdir()
    imports = {"a": "import golden.sort", "b": "from golden import tiles, sort", "c": "from golden.sort import by"}
    for name, line in imports.items():
        (tmp_path / "tests" / f"test_{name}.py").write_text(line + "\n")
    for path, order in (("golden/sort.py", "abc"), ("golden/tiles.py", "bac"), ("golden/other.py", "abc")):
        assert play.importing_first(path, ["tests"], tmp_path) == [f"tests/test_{name}.py" for name in order]


def test_the_worker_runs_tests_until_one_fails(tmp_path: Path):
    for name, body in (("good", "assert 2 > 1"), ("bad", "assert 1 > 2")):
        (tmp_path / f"test_{name}.py").write_text(f"def test_it():\n    {body}\n")
    code = "import sys; from msv2.cases.source_mutants import worker; print('found:' + worker._tests(sys.argv[1:]))"
    for names, found in ((["test_good.py"], ""), (["test_good.py", "test_bad.py"], "test_bad.py::test_it")):
        run = subprocess.run([sys.executable, "-c", code, *names], cwd=tmp_path, capture_output=True, text=True, check=True,
                             env=os.environ | {"PYTHONPATH": str(ROOT)})
        assert run.stdout.splitlines()[-1] == f"found:{found}", run.stdout


def test_the_workers_quick_tests_are_those_of_make_check():
    assert worker.QUICK == check.QUICK


def test_the_worker_goes_on_until_something_notices(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(worker, "_tests", lambda paths: f"{paths[0]}::test_bad" if paths else "")
    monkeypatch.setattr(worker, "_cases", lambda: "")
    for steps, verdict in (
            (["a", "cases"], {"by": "test", "words": "a::test_bad"}), (["cases"], {"by": "", "words": ""})):
        monkeypatch.setattr(sys, "argv", ["worker", str(tmp_path / "result.json"), *steps])
        worker.main()
        assert json.loads((tmp_path / "result.json").read_text()) == verdict
    monkeypatch.setattr(worker, "_cases", lambda: 1 // 0)
    worker.main()
    found = json.loads((tmp_path / "result.json").read_text())
    assert found == {"by": "case", "words": "ZeroDivisionError: integer division or modulo by zero"}


@pytest.mark.long
def test_a_fault_in_a_table_is_noticed_and_the_copy_is_sound_again(tmp_path: Path):
    """Some minutes: kernels are compiled anew."""
    judge = play.Judge(PARTS["spec"], tmp_path)
    every = draw.draw(["spec/formats.py"], len(sites(ast.parse((ROOT / "spec/formats.py").read_text()))), 1, ROOT)
    mutant = next(each for each in every if each.words == "Sub to Add")
    assert judge.judge(mutant)["by"]
    assert (tmp_path / "copy" / mutant.path).read_text() == (ROOT / mutant.path).read_text()


def test_the_page_counts_by_module_and_lists_what_nothing_notices():
    rows = [{"path": "spec/a.py", "line": 3, "what": "1 to 2", "by": "case", "words": "x", "equal": ""},
            {"path": "spec/a.py", "line": 4, "what": "Add to Sub", "by": "", "words": "", "equal": ""},
            {"path": "spec/a.py", "line": 9, "what": "2 to 3", "by": "", "words": "", "equal": "nothing reads it"},
            {"path": "spec/b.py", "line": 5, "what": "no Not", "by": "test", "words": "y", "equal": ""},
            {"path": "spec/b.py", "line": 6, "what": "Eq to NotEq", "by": "hang", "words": "z", "equal": ""}]
    assert study.total(rows) == {"mutants": 5, "equal": 1, "judged": 4, "by_cases": 1, "by_tests": 1, "no_end": 1, "noticed": 3,
                                 "share": 0.75}
    text = study.pages({"spec": rows}, 1)
    assert "| **spec** | 5 | 1 | 1 | 1 | 1 | 75.0 % |" in text and "| `spec/a.py` | 3 | 1 | 1 | 0 | 0 | 50.0 % |" in text
    assert "| spec/a.py:4 | Add to Sub |" in text and "| spec/a.py:9 | 2 to 3 | nothing reads it |" in text
    assert study.contradictions(rows) == []
    (words,) = study.contradictions([rows[3] | {"equal": "sure"}])
    assert "spec/b.py:5: no Not is said to compute the same (sure), and a test notices it: y" in words


def test_what_computes_the_same_is_a_mutant_of_today_and_has_a_reason():
    paths = {one.path for one in EQUAL}
    texts = {path: (ROOT / path).read_text() for path in paths}
    assert paths <= {path for part in PARTS.values() for path in part.paths}
    lines = {path: [changed_line(text, SourceMutant(path, node.lineno, words, number))
                    for number, (node, words, _) in enumerate(sites(ast.parse(text)))] for path, text in texts.items()}
    for one in EQUAL:
        assert any(one.text in new and one.text not in old for old, new in lines[one.path]), one.text
        assert one.why


def test_counts_are_of_one_part_or_of_each():
    assert study.chosen_counts(["7", "golden=150"]) == {"spec": 7, "golden": 150}
    assert study.chosen_counts(["spec=40"]) == {"spec": 40} and study.chosen_counts([]) == {}


@pytest.mark.parametrize(("argv", "says"), [
    (["--part", "golde"], "golde"), (["--seed", "-1"], "--seed -1"), (["--part", "spec", "--count", "0"], "0 mutants"),
    (["--count", "many"], "--count many"), (["--count", "tests=3"], "tests")])
def test_bad_requests_name_what_is_accepted(argv: list[str], says: str):
    with pytest.raises(InputError, match=says):
        study.main(argv)
