"""Writes the generated pages of docs/ (formats, effects, registers, stages, streams), and the site of pages and docstrings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from msv2.document import effects, formats, registers, site, stages, streams
from msv2.document.files import write_whole
from spec.command_line import command_parser
from spec.errors import InputError, run_command_line
from spec.paths import IN_CHECKOUT, ROOT

EXAMPLES = """\
examples:
  %(prog)s            the generated pages
  %(prog)s --check    write nothing; exit status 2 if one is stale
  %(prog)s --site     the pages, and build/docs/site/index.html, which needs the extra `docs`
"""

PAGES: dict[Path, Callable[[], str]] = formats.PAGES | effects.PAGES | registers.PAGES | stages.PAGES | streams.PAGES
"""What is generated, by path."""


def write(path: Path, make: Callable[[], str]) -> None:
    """Writes the text that `make` returns, whole or not at all."""
    write_whole(path, make())


def check(path: Path, make: Callable[[], str]) -> None:
    """Raises InputError unless `path` holds the text that `make` returns."""
    if not path.is_file() or path.read_text(encoding="utf-8") != make():
        raise InputError(f"{path} is stale: run `python -m msv2.document`")


def main(argv: Sequence[str] | None = None) -> None:
    """The command line."""
    parser = command_parser("python -m msv2.document", __doc__, EXAMPLES)
    parser.add_argument("--check", action="store_true", help="write nothing; exit status 2 if a page is stale")
    parser.add_argument("--site", action="store_true", help="build the site, too")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "docs", metavar="DIR",
                        help="folder of the site (default: build/docs)")
    args = parser.parse_args(argv)
    if not IN_CHECKOUT:
        raise InputError(f"{ROOT} is not accepted: the pages are written in a checkout, and an installed msv2 has none")
    act = check if args.check else write
    for path, make in PAGES.items():
        act(path, make)
    if args.site:
        print(site.build(args.out))


if __name__ == "__main__":
    run_command_line(main)
