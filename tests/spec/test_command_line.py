"""The form that all commands share: names in help texts, refusals that name the nearest."""

import pytest

from spec.command_line import add_out_argument, called_as, choice, command_parser, nearest
from spec.errors import InputError


def help_of():
    described = "`python -m some.room`: draws, 2 % of it."
    return command_parser("python -m some.room", described, "examples:\n  %(prog)s --x  5 %").format_help()


def test_the_help_bears_the_own_name_unless_it_was_called_as_another():
    own = help_of()
    assert own.startswith("usage: python -m some.room [-h]") and "\n  python -m some.room --x  5 %\n" in own
    with called_as("msv2 draw"):
        called = help_of()
        assert called.startswith("usage: msv2 draw [-h]") and "\n  msv2 draw --x  5 %\n" in called
        assert help_of() == own  # a parser that the command makes besides is not the command's
    assert help_of() == own


def test_the_description_begins_behind_the_name():
    assert "\nDraws, 2 % of it.\n" in help_of()


def test_a_misspelt_option_names_the_nearest(capsys):
    parser = command_parser("python -m some.room", "Draws.")
    add_out_argument(parser, "build/room")
    parser.add_argument("--size")
    for argv, says in (["--sise=3"], "did you mean '--size'?"), (["extra"], "argument 'extra' is not accepted\n"):
        with pytest.raises(SystemExit) as left:
            parser.parse_args(argv)
        assert left.value.code == 2 and says in capsys.readouterr().err
    assert parser.parse_args(["--size", "3"]).out is None and "(default: build/room)" in parser.format_help()


@pytest.mark.parametrize(("name", "hint"), [
    ("rendr", "; did you mean 'render'?"), ("tum", "; did you mean 'tmu'?"), ("merge", "; did you mean 'tile_merge'?"),
    ("xyz", ""), ("", ""),
])
def test_nearest(name, hint):
    assert nearest(name, ("render", "tmu", "tile_merge")) == hint


def test_choice():
    assert choice("unit", "tmu", ("render", "tmu")) == "tmu"
    with pytest.raises(InputError, match="unit 'tum' is not accepted: choose one of render, tmu; did you mean 'tmu'"):
        choice("unit", "tum", ("render", "tmu"))
