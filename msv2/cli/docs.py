"""`msv2 docs`: writes the generated pages of docs/, and the site that is made of all pages and docstrings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from spec import document, document_effects, document_registers
from spec.command_line import command_parser
from spec.paths import ROOT

EXAMPLES = """\
examples:
  %(prog)s            docs/formats.md, docs/registers.md, docs/effects.md and the C header
  %(prog)s --check    write nothing; exit status 2 where a page is stale
  %(prog)s --site     the pages, and build/docs/site/index.html, which needs the extra `docs`
"""


def pages() -> dict[Path, Callable[[], str]]:
    """Every generated page, and what makes its text."""
    return {document.PAGE: document.page, **document_registers.PAGES, **document_effects.PAGES}


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work."""
    parser = command_parser("python -m msv2.cli.docs", __doc__, EXAMPLES)
    parser.add_argument("--check", action="store_true", help="write nothing; exit status 2 where a page is stale")
    parser.add_argument("--site", action="store_true", help="build the site, too")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "docs", metavar="DIR",
                        help="folder of the site (default: build/docs)")
    args = parser.parse_args(argv)
    act = document.check if args.check else document.write
    for path, make in pages().items():
        act(path, make)
    if args.site:
        from msv2.document.site import build

        print(build(args.out))
    return 0
