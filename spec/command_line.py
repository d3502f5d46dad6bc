"""How the project's commands read their command lines: one form of help, one way to refuse a name.

A command can be started in two ways, such as `python -m tb.frame` and `msv2 frame`. Its help shows the name that the user
typed: descriptions and examples write `%(prog)s` where the name belongs.
"""

from __future__ import annotations

import argparse
import difflib
import re
from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

from spec.errors import InputError

_called: ContextVar[str | None] = ContextVar("called", default=None)


@contextmanager
def called_as(name: str) -> Iterator[None]:
    """Within it, the first parser that is made bears this name instead of its own, as in "msv2 frame"."""
    token = _called.set(name)
    try:
        yield
    finally:
        _called.reset(token)


def nearest(name: str, accepted: Collection[str]) -> str:
    """`; did you mean ...?` for a wrong name that resembles an accepted one, otherwise nothing."""
    inside = [other for other in accepted if min(len(name), len(other)) > 2 and (name in other or other in name)]
    found = inside or difflib.get_close_matches(name, accepted, n=1)
    return f"; did you mean {found[0]!r}?" if found else ""


def choice(kind: str, name: str, accepted: Collection[str]) -> str:
    """`name` where it is accepted.

    Raises:
        InputError: it is not; the message lists what is accepted and the nearest of it.
    """
    if name not in accepted:
        raise InputError(f"{kind} {name!r} is not accepted: choose one of {', '.join(accepted)}{nearest(name, accepted)}")
    return name


class CommandParser(argparse.ArgumentParser):
    """A parser that names the nearest option when one is misspelt."""

    def parse_args(  # type: ignore[override]  # the other overloads are for namespaces of other types
        self, args: Sequence[str] | None = None, namespace: argparse.Namespace | None = None,
    ) -> argparse.Namespace:
        found, rest = self.parse_known_args(args, namespace)
        if rest:
            option = rest[0].partition("=")[0]
            hint = nearest(option, self._option_string_actions) if option.startswith("-") else ""
            self.error(f"argument {rest[0]!r} is not accepted{hint}")
        return found


def command_parser(prog: str, description: str | None, examples: str = "") -> CommandParser:
    """A parser in the project's form.

    Args:
        prog: how the command is started where nothing else is known, such as "python -m tb.frame".
        description: what the command does, usually the module's docstring; the command's own name in front of it, as in
            "`python -m tb.frame`: ...", is left out, for the usage line shows it.
        examples: the text behind the options, as it stands; `%(prog)s` becomes the command's name.
    """
    text = re.sub(r"\A`[^`]*`:\s+", "", description or "")
    name = _called.get() or prog
    _called.set(None)
    description, examples = (words.replace("%(prog)s", name) for words in (text[:1].upper() + text[1:], examples))
    return CommandParser(
        prog=name, description=description, epilog=examples or None, formatter_class=argparse.RawDescriptionHelpFormatter)


def add_out_argument(parser: argparse.ArgumentParser, default: str, what: str = "output folder") -> None:
    """Adds `--out DIR`; without it the parsed value is None, and the command takes the default that the help names."""
    parser.add_argument("--out", metavar="DIR", help=f"{what} (default: {default})")
