"""The Makefile: its targets call `msv2`, its variables become options, and misspelt variables are errors."""

import contextlib
import re
import shlex
import shutil
import subprocess

import pytest

from msv2.cli import make_help, make_variables, setup_environment
from msv2.cli.commands import COMMANDS
from msv2.cli.main import main
from spec.errors import InputError
from spec.paths import ROOT
from tests.helpers.processes import PYTHON, run

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="no make: apt-get install make")

TEXT = (ROOT / "Makefile").read_text(encoding="utf-8")
TARGETS = make_variables.targets(TEXT)
SHOWN = dict(make_help.described(TEXT))
OLD = ("help", "setup", "demo", "render", "frame", "sim", "synth", "report-area", "perf", "report-energy",
       "report-performance", "report", "train", "tables-training", "table-ecc", "table-effects", "tradeoff", "bench", "results",
       "stability", "docs", "test", "test-long", "lint", "base", "tested")
NEW = ("verilog", "fpga", "doctor", "study", "check")


def make(*argv: str) -> subprocess.CompletedProcess:
    return run("make", "-n", f"PYTHON={PYTHON}", *argv)


def commands(*argv: str) -> list[list[str]]:
    """What make would run, as words; arguments of `msv2` for those that call it."""
    done = make(*argv)
    assert done.returncode == 0, done.stderr
    lines = [shlex.split(line) for line in done.stdout.replace("\\\n", " ").splitlines()]
    return [line[3:] if line[1:3] == ["-m", "msv2"] else line for line in lines]


def test_every_target_is_there():
    assert set(OLD) | set(NEW) <= set(TARGETS)


@pytest.mark.parametrize("target", sorted(TARGETS))
def test_targets_dispatch(target):
    """One call of a command behind the set-up; `test`, `lint` and `check` start pytest and ruff."""
    last = commands(target)[-1]
    assert last[0] in COMMANDS or target in ("help", "setup", "base", "tested", "documented", "viewable", "mappable", "test",
                                             "test-long", "lint", "check")


@pytest.mark.parametrize("target", sorted(SHOWN))
def test_the_help_names_variables_that_the_target_takes(target):
    named = set(re.findall(r'(?<![\w"=])([A-Z][A-Z0-9_]+)=', SHOWN[target]))
    known = {*make_variables.accepted(TEXT, [target]), *make_variables.ALWAYS}
    assert named <= known, named - known


@pytest.mark.parametrize("target", ["render", "frame", "sim", "synth", "train", "stability"])
def test_variables_become_options_that_the_command_has(target, capsys):
    values = [f"{name}=1" for name in make_variables.accepted(TEXT, [target]) if name not in ("EXTRAS",)]
    words = commands(target, *values)[-1]
    cut = next(i for i, word in enumerate(words) if word.startswith("--"))
    name, argv = [word for word in words[:cut] if word != "1"], words[cut:]
    with contextlib.suppress(SystemExit):
        main([*name, "--help"])
    known = set(re.findall(r"(?<![\w-])--[a-z][a-z0-9-]*", capsys.readouterr().out))
    given = {word for word in argv if word.startswith("--")}
    assert given <= known, given - known
    assert len(given) >= len(values) - 2  # a scene has no option; a switch may be off


@pytest.mark.parametrize(("argv", "wanted"), [
    (["render", "SCENE=a b.ply", "SIZE=8x8"], ["render", "a b.ply", "--size", "8x8"]),
    (["frame", "SET=sh_degree=1 levels=2", "STEREO=0"], ["frame", "--set", "sh_degree=1", "--set", "levels=2"]),
    (["sim", "TEST=tmu", "SEED=3", "WAVES=1"], ["sim", "--test", "tmu", "--seed", "3", "--waves"]),
    (["study", "NAME=speed", "ARGS=--size 8x8"], ["study", "speed", "--size", "8x8"]),
    (["study"], ["study", "list"]),
    (["tables-training", "SCENE=a b@4x4", "RTL=0"], ["study", "training", "a", "b@4x4", "--no-rtl"]),
    (["docs", "SITE=0"], ["docs"]), (["docs"], ["docs", "--site"]),
])
def test_values_arrive(argv, wanted):
    assert commands(*argv)[-1] == wanted


@pytest.mark.parametrize(("argv", "says"), [
    (["render", "SZIE=8x8"], "variable SZIE is not accepted by make render; did you mean SIZE? It takes BACKGROUND, CAMERA,"),
    (["sim", "TESTS_=tmu"], "variable TESTS_ is not accepted by make sim; did you mean"),
    (["demo", "SCENE=x"], "variable SCENE is not accepted by make demo. It takes OUT"),
    (["foo=1"], "variable foo is not accepted by make help"),
])
def test_a_misspelt_variable_is_an_error(argv, says):
    done = make(*argv)
    assert done.returncode == 2 and says in done.stderr and done.stdout == ""


def test_variables_of_any_goal_are_accepted():
    assert make("setup", "demo", "EXTRAS=none", "OUT=build/x", "MSV2_DATA=data").returncode == 0


def test_the_environment_is_not_judged(monkeypatch):
    monkeypatch.setenv("SZIE", "1")
    assert make("render").returncode == 0


@pytest.mark.parametrize(("argv", "says"), [
    (["sim", "--test", "tum"], "choose one of all, float, chunk_test, chunk_reader, culling,"),
    (["sim", "--test", "tum"], "did you mean 'tmu'?"),
    (["synth", "--unit", "pixel_cor"], "did you mean 'pixel_core'?"), (["synth", "--unit", "nothing"], "pixel_core"),
])
def test_an_unknown_test_or_unit_lists_those_that_are_there(argv, says):
    with pytest.raises(InputError, match=re.escape(says)):
        main(argv)


def test_an_unknown_extra_is_an_error():
    with pytest.raises(SystemExit, match=r"extra 'viewr' is not accepted: choose of .*did you mean 'viewer'"):
        setup_environment.main(["--extras", "models,viewr"])
