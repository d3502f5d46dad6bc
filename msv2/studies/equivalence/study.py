"""Compares the hardware of two commits. Every unit's RTLIL is compared as text; where that differs, equivalence is proven in
Yosys."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from golden.scenes.request import make_folder
from msv2.studies.equivalence.emit import canonical, checked_out, emitted
from msv2.studies.equivalence.prove import differences
from msv2.studies.record import write_report
from spec.command_line import command_parser
from spec.config import CONFIGS
from spec.errors import InputError
from spec.paths import ROOT

EXAMPLES = """examples:
  msv2 study run equivalence --against v0.2.0                 TINY and PAPER as they are here, against a tag
  msv2 study run equivalence --against HEAD~3 --configs tiny  one configuration, three commits back

Exit status 1 where a unit is not the same.
"""

SAME, PROVEN, DIFFERENT, MISSING = "same text", "proven equivalent", "NOT EQUIVALENT", "in one of the two only"


def verdicts(before: dict[str, Path], after: dict[str, Path], folder: Path) -> dict[str, str]:
    """The verdict on each unit, by `CONFIG.UNIT`.

    Args:
        before, after: RTLIL files by `CONFIG.UNIT`.
        folder: the folder for Yosys' files.
    """
    found = {}
    for name in tqdm(sorted({*before, *after}), desc="units", unit="unit"):
        if name not in before or name not in after:
            found[name] = MISSING
        elif canonical(before[name].read_text()) == canonical(after[name].read_text()):
            found[name] = SAME
        else:
            wrong = differences(before[name], after[name], folder / name)
            found[name] = f"{DIFFERENT}: {', '.join(wrong)}" if wrong else PROVEN
    return found


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line; returns 1 where a unit is not the same."""
    parser = command_parser("msv2 study run equivalence", __doc__, EXAMPLES)
    parser.add_argument("--against", required=True, metavar="COMMIT", help="the commit to compare the present sources with")
    parser.add_argument("--configs", default="tiny,paper", metavar="NAME,...", help="configurations (default: tiny,paper)")
    parser.add_argument("--out", type=Path, default=ROOT / "build" / "equivalence", metavar="DIR",
                        help="output folder (default: build/equivalence)")
    args = parser.parse_args(argv)
    configs = tuple(args.configs.split(","))
    for name in configs:
        if name not in CONFIGS:
            raise InputError(f"configuration {name!r} is not accepted: choose from {', '.join(CONFIGS)}")
    out = make_folder(args.out)
    with checked_out(args.against) as sources:
        before = emitted(sources, configs, out / "before")
    found = verdicts(before, emitted(ROOT, configs, out / "after"), out / "proofs")
    write_report(out / "equivalence.json", {"against": args.against, "units": found}, [__name__], {"arguments": args})
    for verdict in (SAME, PROVEN, MISSING, DIFFERENT):
        names = [name for name, value in found.items() if value.startswith(verdict)]
        print(f"{verdict}: {len(names)}" + (f" ({', '.join(names)})" if names and verdict != SAME else ""))
    return int(any(verdict not in (SAME, PROVEN) for verdict in found.values()))
