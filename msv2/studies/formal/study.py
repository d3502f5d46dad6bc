"""`msv2 study run formal`: proves claims of the machine's units, for all inputs and for ever, or up to a number of cycles.

What a claim, a canary and a bench are is told in docs/formal.md. Verdicts are kept in build/formal under what they are about,
so that an interrupted study continues and only what has changed is proven again. The study needs the extra `synth`. The exit
status is 1 if a claim fails, or if a claim is proven of something that was never seen to happen.
"""

from __future__ import annotations

import argparse
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from tqdm import tqdm

from msv2.cases.formal import circuit, engine
from msv2.cases.formal.proof import CANARY_SECONDS, Judged, Proof, judge, posed
from msv2.cases.formal.registry import PROOFS, UNPROVEN, components, named
from msv2.studies import page
from msv2.studies.kept import fingerprint, kept
from msv2.studies.record import write_report
from spec.command_line import command_parser
from spec.paths import BUILD, REPORTS
from synth.flow import version

FOLDER = BUILD / "formal"

RESULTS = ("proven", "open", "fails", "empty")

HEAD = """# Claims of units, proven for all inputs

Written by `msv2 study run formal`. A claim is proven for every sender, receiver, memory and setting at once, from registers
that hold anything when the power comes on, and one cycle of reset. "Proven" means for ever; "to N" means that no violation
exists within N cycles and the proof did not end in its time. The canary of a claim is the cycle in which what it speaks of was
seen to happen first; a claim without one would be worth nothing, and is called empty. docs/formal.md tells how to add one.
"""


def row(proof: Proof) -> dict[str, object]:
    """The verdicts of a proof, from an earlier run if nothing has changed."""
    question = posed(proof)
    key = fingerprint([circuit.__name__, engine.__name__], question.text, question.claims, proof.seconds, CANARY_SECONDS,
                      version())
    return kept(FOLDER / "kept", f"{proof.folder_name}-{key}", lambda: _judged(proof, list(judge(proof, FOLDER, question))))


def _judged(proof: Proof, found: Sequence[Judged]) -> dict[str, object]:
    return {
        "unit": proof.unit.__name__, "at": proof.at, "latches": found[0].latches, "ands": found[0].ands,
        "claims": [{
            "claim": each.claim, "result": each.result, "depth": each.verdict.depth, "seconds": round(each.verdict.seconds, 1),
            "canary": each.canary.depth if each.canary.kind == "fails" else None,
            "canary_seconds": round(each.canary.seconds, 1)} for each in found]}


def _name(row: Mapping[str, object]) -> str:
    return f"{row['unit']} ({row['at']})" if row["at"] else str(row["unit"])


def shown(claim: Mapping[str, object]) -> str:
    """A verdict in a word."""
    result = claim["result"]
    return f"to {claim['depth']}" if result == "open" else f"fails at {claim['depth']}" if result == "fails" else str(result)


def pages(rows: Sequence[Mapping[str, object]], counts: Mapping[str, int]) -> str:
    """The page of the report."""
    units = {row["unit"] for row in rows}
    summary = (f"{counts['proven']} claims of {len(units)} units are proven, {counts['open']} are open to the depth that is "
               f"given, {counts['fails']} fail, {counts['empty']} are empty.")
    table = page.table(
        ["unit", "claim", "result", "canary", "seconds"],
        [[_name(row), claim["claim"], shown(claim),
          "-" if claim["canary"] is None else claim["canary"], f"{claim['seconds'] + claim['canary_seconds']:.1f}"]
         for row in rows for claim in row["claims"]], left=3)
    sizes = page.table(
        ["unit", "flip-flops", "AND gates"],
        [[_name(row), f"{row['latches']:,}", f"{row['ands']:,}"] for row in rows], left=1)
    without = page.table(["component", "module", "why"], [
        [name, f"`{kind.__module__}`", UNPROVEN[name]] for name, kind in components().items() if name in UNPROVEN])
    return (f"{HEAD}\n{summary}\n\n{table}\n\n## Components without a proof\n\n{without}\n\n"
            f"## Sizes\n\nOf a unit with its bench, in the machine that is proven.\n\n{sizes}")


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = command_parser("msv2 study run formal", __doc__.split(": ", 1)[1])
    parser.add_argument("--unit", default="", metavar="CLASS", help="prove only this component, and write nothing")
    parser.add_argument("--out", type=Path, default=REPORTS / "formal.md", metavar="FILE",
                        help="the page; the JSON is beside it (default: build/reports; --keep: reports)")
    return parser.parse_args(argv)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line: writes formal.json and the page formal.md."""
    args = _arguments(argv)
    circuit.find_abc()
    proofs = named(args.unit) if args.unit else PROOFS
    rows = []
    for proof in tqdm(proofs, desc="proofs", disable=not sys.stderr.isatty()):
        rows.append(row(proof))
        for claim in rows[-1]["claims"]:
            if args.unit or claim["result"] in ("fails", "empty"):
                tqdm.write(f"{proof.name}: {claim['claim']}: {shown(claim)}, canary {claim['canary']}, {claim['seconds']} s")
    counts = Counter(claim["result"] for each in rows for claim in each["claims"])
    found = {result: counts[result] for result in RESULTS}
    if not args.unit:
        write_report(args.out.with_suffix(".json"), {**found, "units": len({each["unit"] for each in rows}),
                                                     "unproven": UNPROVEN, "rows": rows}, [__name__])
        page.write_page(args.out, pages(rows, found))
    print(", ".join(f"{number} {result}" for result, number in found.items()))
    return int(bool(found["fails"] or found["empty"]))
