"""The fuzzer: what it makes of good and bad files and readers, and two thousand cases, none of which may fail."""

from __future__ import annotations

import json
import time
from collections.abc import Callable

import numpy as np
import pytest

from msv2.cases.command import main
from msv2.cases.fuzz import runs, samples, spoil, worker
from msv2.cases.fuzz.samples import FORMATS, Format
from spec.errors import InputError

HERE = [name for name in FORMATS if not runs.missing(name)]


@pytest.mark.parametrize("name", HERE)
def test_the_good_sample_of_every_format_is_accepted(name):
    assert worker.run_case(name, 1, 0) == {"outcome": worker.ACCEPTED}


@pytest.mark.parametrize("name", HERE)
def test_a_case_is_always_the_same_and_is_no_other(name):
    cases = [worker.case_files(name, 1, index) for index in (0, 5, 5, 6)]
    assert cases[1] == cases[2] and cases[1] != cases[0] and worker.case_files(name, 2, 5) != cases[1]


def read_badly(error: Callable[[], object]) -> Format:
    return Format(lambda: {"a.bin": bytes(64)}, lambda folder: (folder / "a.bin").read_bytes() == bytes(64) or error())


def fails() -> None:
    raise KeyError("spoilt")


def takes_memory() -> int:
    return len(bytearray(1 << 46))


def refuses() -> None:
    raise InputError("no")


def test_any_other_exception_than_an_input_error_is_a_failure(monkeypatch):
    for error, outcome, what in (
            (fails, worker.FAILED, "KeyError: 'spoilt'"), (takes_memory, worker.FAILED, "MemoryError"),
            (refuses, worker.REFUSED, None)):
        monkeypatch.setitem(FORMATS, "bad", read_badly(error))
        worker.good_files.cache_clear()
        found = [worker.run_case("bad", 1, index) for index in range(30)]
        assert found[0] == {"outcome": worker.ACCEPTED}
        others = [answer for answer in found if answer["outcome"] != worker.ACCEPTED]
        assert len(others) > 20 and {answer["outcome"] for answer in others} == {outcome}
        assert all(answer.get("what", "").startswith(what) if what else "trace" not in answer for answer in others)


def test_a_worker_that_hangs_or_dies_is_replaced(monkeypatch):
    """The worker is a process of its own, so a stand-in for it is started."""
    stand_in = ("import json, os, sys, time\nfor line in sys.stdin:\n    index = json.loads(line)['index']\n"
                "    time.sleep(99 if index == 1 else 0)\n    os._exit(3) if index == 2 else None\n"
                "    print(json.dumps({'outcome': 'accepted'}), flush=True)\n")
    start = runs.subprocess.Popen
    monkeypatch.setattr(runs.subprocess, "Popen", lambda command, **options: start([command[0], "-c", stand_in], **options))
    begin = time.monotonic()
    ((name, tally),) = runs.run_cases({"ply": 4}, 1, seconds=0.5)
    assert name == "ply" and tally.outcomes == {"accepted": 2, "refused": 0, "failed": 2} and time.monotonic() - begin < 60
    assert [failure["what"] for failure in tally.failures] == ["took more than 0.5 s", "the process died (status 3)"]


def test_containers_are_spoilt_inside():
    rng = np.random.default_rng(0)
    data = samples._sog_bundle()
    whole = sum(spoil.spoil_zip(data, rng)[:4] == b"PK\x03\x04" for _ in range(50))
    assert whole > 40
    texts = [spoil.spoil_json(b'{"a": [1, 2], "b": {"c": "d"}}', rng) for _ in range(200)]
    assert len(set(texts)) > 60 and sum(_is_json(text) for text in texts) > 150


def test_what_is_put_in_is_not_spoilt_for_later_cases():
    rng, before = np.random.default_rng(1), json.dumps(spoil.VALUES)
    for _ in range(30_000):
        spoil.spoil_json(b'{"a": [1, 2], "b": {"c": "d"}}', rng)
    assert json.dumps(spoil.VALUES) == before


def _is_json(text: bytes) -> bool:
    try:
        json.loads(text)
    except ValueError:
        return False
    return True


def test_formats_without_their_package_are_named(monkeypatch, tmp_path):
    monkeypatch.setitem(FORMATS, "none", Format(dict, fails, needs=("no_such_package",)))
    assert runs.missing("none") == ["no_such_package"]
    assert main(["fuzz", "--format", "none", "--format", "splat", "--cases", "3", "--out", str(tmp_path)]) == 0
    record = json.loads((tmp_path / "fuzz.json").read_text())
    assert record["not_installed"] == {"none": ["no_such_package"]} and list(record["formats"]) == ["splat"]


def test_a_run_goes_on_where_an_earlier_one_ended(monkeypatch, tmp_path):
    asked = []
    run = runs.Worker.run
    monkeypatch.setattr(runs.Worker, "run", lambda worker, *case: asked.append(case[2]) or run(worker, *case))
    monkeypatch.setattr(runs, "STEP", 4)

    def record(*argv: str) -> dict[str, object]:
        assert main(["fuzz", "--format", "splat", "--out", str(tmp_path), *argv]) == 0
        found = json.loads((tmp_path / "fuzz.json").read_text())
        return {key: found[key] for key in ("cases", "accepted", "refused", "failures")}

    at_once = record("--cases", "10")
    monkeypatch.setattr(runs.Worker, "run", lambda worker, *case: 1 / 0 if case[2] == 6 else run(worker, *case))
    with pytest.raises(ZeroDivisionError):
        record("--cases", "10")
    assert json.loads((tmp_path / "fuzz.json").read_text())["cases"] == 4
    monkeypatch.setattr(runs.Worker, "run", lambda worker, *case: asked.append(case[2]) or run(worker, *case))
    assert record("--cases", "10", "--resume") == at_once and asked == [*range(10), *range(4, 10)]
    with pytest.raises(InputError, match="of seed 1, not 2"):
        record("--seed", "2", "--resume")
    for text in ("{}", '{"seed": 1, "formats": [3]}', '{"seed": 1, "formats": {"splat": {"cases": 3}}}'):
        (tmp_path / "fuzz.json").write_text(text)
        with pytest.raises(InputError, match=r"fuzz\.json is no record of a run of the fuzzer"):
            record("--resume")


def test_one_case_leaves_its_files(tmp_path, capsys):
    assert main(["fuzz", "--format", "splat", "--case", "0", "--out", str(tmp_path)]) == 0
    assert (tmp_path / "splat-1-0" / "a.splat").read_bytes() == worker.good_files("splat")["a.splat"]
    assert "accepted" in capsys.readouterr().out


@pytest.mark.parametrize("argv", [
    ("--cases", "0"), ("--seed", "-1"), ("--seconds", "nan"), ("--case", "3"), ("--format", "word"),
    ("--format", "spz", "--format", "ply", "--case", "3")])
def test_bad_options(argv):
    with pytest.raises(InputError, match="not accepted"):
        main(["fuzz", *argv])


def test_two_thousand_cases(tmp_path, capfd):
    """Which formats take part depends on the installed packages."""
    assert main(["fuzz", "--cases", "2000", "--out", str(tmp_path)]) == 0, capfd.readouterr().out
    record = json.loads((tmp_path / "fuzz.json").read_text())
    assert record["cases"] >= 1900 and record["failures"] == 0
    assert all(row["accepted"] > 1 or row["cases"] < 10 for row in record["formats"].values())
