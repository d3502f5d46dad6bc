"""One set of options: the same names with the same meaning in every command that has them."""

import re
from dataclasses import replace
from importlib import import_module

import pytest

from golden.host.run_options import RunOptions, add_run_arguments, run_options
from golden.scenes.load import EMBEDDED, TRAINED
from golden.scenes.request import add_request_arguments
from msv2.cli.main import main
from spec.command_line import CommandParser, command_parser
from spec.errors import InputError

REQUEST = ("--scene", "--size", "--camera", "--gaze", "--levels", "--levels-from", "--background", "--seed", "--effects",
           "--depth", "--stereo", "--ecc-thresh", "--ipd", "--units-per-metre", "--source", "--gaze-right", "--config", "--set",
           "--out")
RUN = ("--machine", "--pixels", "--merge", "--pipeline", "--beta", "--memory", "--bandwidth", "--latency")
DRAWING = ("render", "frame", "perf")


class Reached(Exception):
    """A command's parser, at the moment at which it would read its arguments."""


@pytest.fixture
def options_of(monkeypatch):
    """Metavariable and help of a command's options, without the defaults, which may differ."""
    def stop(parser, *_):
        raise Reached(parser)

    def found(name: str) -> dict[str, tuple[object, str]]:
        with pytest.raises(Reached) as reached:
            main([name])
        return {option: (action.metavar, re.sub(r"[(]default.*", "", action.help or ""))
                for action in reached.value.args[0]._actions for option in action.option_strings}

    monkeypatch.setattr(CommandParser, "parse_args", stop)
    return found


def test_commands_share_their_options(options_of):
    found = {name: options_of(name) for name in DRAWING}
    for option in REQUEST:
        assert all(option in found[name] for name in DRAWING), option
        assert len({found[name][option] for name in DRAWING}) == 1, option
    for option in RUN:
        assert found["frame"][option] == found["perf"][option], option


@pytest.mark.parametrize("name", ["train", "synth", "verilog", "cases", "demo"])
def test_every_command_that_writes_has_out(name, options_of):
    assert "--out" in options_of(name)


@pytest.mark.parametrize("name", DRAWING)
def test_a_scene_is_an_argument_or_an_option(name, tmp_path):
    for argv in (["no/such.ply"], ["--scene", "no/such.ply"]):
        with pytest.raises(InputError, match=r"no/such\.ply"):
            main([name, *argv, "--out", str(tmp_path)])


def test_the_scene_that_is_given_counts():
    parser = command_parser("python -m some.room", "")
    add_request_arguments(parser)
    assert parser.parse_args([]).scene == EMBEDDED
    shown = command_parser("python -m some.room", "")
    add_request_arguments(shown, scene=TRAINED)
    assert shown.parse_args([]).scene == TRAINED
    assert parser.parse_args(["a.ply"]).scene == parser.parse_args(["--scene", "a.ply"]).scene == "a.ply"
    assert parser.parse_args(["--scene", "a.ply", "--size", "3x3"]).scene == "a.ply"


@pytest.mark.parametrize(("module", "scene"), [
    ("golden.render", TRAINED), ("tb.frame.__main__", TRAINED), ("perf.__main__", TRAINED),
    ("msv2.studies.accuracy.study", EMBEDDED), ("msv2.cases.inversions", EMBEDDED), ("golden.train", EMBEDDED),
])
def test_commands_that_show_a_scene_take_the_trained_one(module, scene, monkeypatch):
    """Studies, benchmarks and training keep the procedural model, so that their numbers stay."""
    def stop(parser, *_):
        raise Reached(parser.get_default("scene"))

    monkeypatch.setattr(CommandParser, "parse_args", stop)
    with pytest.raises(Reached) as reached:
        import_module(module).main([])
    assert reached.value.args[0] == scene


def parsed(*argv: str, stereo: bool = False, memory: str | None = "ideal") -> RunOptions:
    parser = command_parser("python -m some.room", "")
    add_run_arguments(parser, memory=memory)
    parser.set_defaults(stereo=stereo)
    return run_options(parser.parse_args(argv))


def test_run_options():
    assert parsed() == RunOptions(False, True, None, None, False, 100, 25.6)
    assert parsed(stereo=True).display and not parsed("--pixels", "wide", stereo=True).display
    packed = parsed("--pixels", "packed")
    assert (packed.display, packed.packed) == (True, True) and not parsed("--pixels", "display").packed
    assert parsed("--pixels", "packed", stereo=True) == packed
    assert parsed("--merge", "0", "--beta", "9").beta == 0 and parsed("--beta", "9").beta == 9
    assert parsed("--pipeline", "0").incremental is False and parsed("--machine", "full").full
    assert parsed("--memory", "lpddr3") == replace(parsed(), memory="lpddr3") and parsed().memory == "ideal"
    assert parsed("--bandwidth", "unlimited").bytes_per_cycle is None and parsed("--latency", "7").latency == 7


def test_the_memory_is_lpddr3_unless_the_ideal_one_is_described():
    assert parsed(memory=None) == parsed("--memory", "lpddr3") and parsed(memory=None).memory == "lpddr3"
    for option in ("--bandwidth", "25.6"), ("--latency", "100"), ("--memory", "ideal"):
        assert parsed(*option, memory=None) == parsed(), option
    with pytest.raises(InputError, match="latency is not accepted with memory 'lpddr3'"):
        parsed("--memory", "lpddr3", "--latency", "100", memory=None)


@pytest.mark.parametrize(("argv", "says"), [
    (["--machine", "half"], "machine 'half' is not accepted: choose one of scene, full"),
    (["--pixels", "tall"], "pixels 'tall'"), (["--merge", "2"], "merge '2' is not accepted: 0 or 1 is"),
    (["--pipeline", "yes"], "pipeline 'yes'"), (["--beta", "-1"], "beta '-1' is not accepted: 0..16777215 or 'auto' are"),
    (["--bandwidth", "65"], "bandwidth '65' is not accepted: 0.01..64 bytes a cycle are, which is what the bus moves at most"),
    (["--bandwidth", "fast"], "bandwidth 'fast'"), (["--bandwidth", "0"], "bandwidth '0'"),
    (["--bandwidth", "nan"], "bandwidth 'nan'"), (["--latency", "0"], "latency 0"),
    (["--memory", "ddr5"], "memory 'ddr5' is not accepted: choose one of ideal, lpddr3"),
    (["--memory", "lpddr3", "--bandwidth", "25.6"], "bandwidth is not accepted with memory 'lpddr3'"),
    (["--memory", "lpddr3", "--latency", "100"], "latency is not accepted with memory 'lpddr3'"),
])
def test_bad_run_options_are_named(argv, says):
    argv = [f"{name}={value}" for name, value in zip(argv[::2], argv[1::2], strict=True)]
    with pytest.raises(InputError, match=re.escape(says)):
        parsed(*argv)
