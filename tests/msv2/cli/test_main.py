"""`msv2` as a user meets it: help at once, the functions of the rooms, clear refusals."""

import resource
import tomllib
from importlib import import_module
from importlib.util import find_spec

import pytest

from msv2.cli import main as cli
from msv2.cli.commands import COMMANDS, Command
from msv2.cli.main import main
from spec.errors import InputError
from spec.paths import ROOT
from tests.helpers.processes import python

EXPECTED = ("render", "look", "frame", "video", "view", "sim", "synth", "perf", "sweep", "train", "cases", "study", "verilog",
            "doctor")


def test_help_names_every_command_with_examples(capsys):
    assert main(["--help"]) == main([]) == main(["help"]) == 0
    text = capsys.readouterr().out
    for name in EXPECTED:
        assert f"\n  {name} " in text
    assert "examples:" in text and "msv2 COMMAND --help" in text


def test_help_appears_at_once():
    """Nothing but the standard library and the table of commands is imported, which takes far less than 0.3 s."""
    spent = []
    for _ in range(3):
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = python("-m", "msv2", "--help")
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        spent.append(after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime)
        assert done.returncode == 0 and done.stdout.startswith("usage: msv2")
    assert min(spent) < 0.3
    code = "import sys\nfrom msv2.cli.main import main\nmain(['--help'])\nprint(sorted(sys.modules), file=sys.stderr)"
    done = python("-c", code)
    assert done.returncode == 0
    for name in ("numpy", "numba", "amaranth", "torch", "golden", "rtl", "tb"):
        assert f"'{name}'" not in done.stderr


def test_an_unknown_command_names_the_nearest():
    done = python("-m", "msv2", "rendr")
    assert done.returncode == 2 and done.stdout == ""
    assert done.stderr.startswith("error: command 'rendr' is not accepted: choose one of render, look,")
    assert "did you mean 'render'?" in done.stderr and "Traceback" not in done.stderr


@pytest.mark.parametrize("command", COMMANDS.values(), ids=lambda command: command.name)
def test_each_command_is_a_module_that_is_there(command):
    assert find_spec(command.module) is not None


@pytest.mark.parametrize("command", COMMANDS.values(), ids=lambda command: command.name)
def test_every_command_calls_the_function_of_its_room(command, monkeypatch):
    seen = []

    class Room:
        @staticmethod
        def main(argv):
            seen.append(argv)
            return 7

    monkeypatch.setattr(cli, "import_module", {command.module: Room}.__getitem__)
    assert main([command.name, "--size", "3x4", "scene"]) == 7
    assert seen == [["--size", "3x4", "scene"]]


@pytest.mark.parametrize(("name", "started_as"), [
    ("train", "golden/train.py"), ("render", "golden/render.py"), ("frame", "python -m tb.frame"), ("sim", "python -m tb.sim"),
    ("synth", "python -m synth"), ("perf", "python -m perf"), ("cases", "python -m msv2.cases"),
    ("docs", "python -m msv2.document")])
def test_help_shows_the_name_that_was_typed(name, started_as, capsys):
    shown = []
    for call in (lambda: main([name, "--help"]), lambda: import_module(COMMANDS[name].module).main(["--help"])):
        with pytest.raises(SystemExit) as left:
            call()
        assert left.value.code == 0
        shown.append(capsys.readouterr().out)
    assert shown[0].startswith(f"usage: msv2 {name} ") and f"msv2 {name}" in shown[0].partition("\n")[2]
    own = started_as if started_as.startswith("python") else f"python {started_as}"
    assert shown[1].startswith(f"usage: {own} ") and f"msv2 {name}" not in shown[1]


@pytest.mark.parametrize("script", ["golden/render.py", "golden/train.py"])
def test_the_scripts_still_start(script):
    done = python(script, "--no-such-option")
    assert done.returncode == 2 and "--no-such-option" in done.stderr and "Traceback" not in done.stderr


def test_a_missing_package_is_named_with_the_smallest_extra(monkeypatch):
    class Room:
        @staticmethod
        def main(argv):
            raise ModuleNotFoundError("No module named 'torch.nn'", name="torch.nn")

    monkeypatch.setattr(cli, "import_module", lambda name: Room)
    says = r"msv2 render needs torch, which is not installed; the extra 'train' has it: make setup EXTRAS=train"
    with pytest.raises(InputError, match=says):
        main(["render"])


def test_a_missing_module_of_ours_is_a_defect_and_shows(monkeypatch):
    monkeypatch.setitem(COMMANDS, "broken", Command("broken", "for this test", "golden.no_such_module"))
    with pytest.raises(ModuleNotFoundError):
        main(["broken"])


def test_the_script_is_that_of_the_project():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["scripts"] == {"msv2": "msv2.cli.main:run"}


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("msv2 ")
