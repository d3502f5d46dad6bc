"""Measures the errors of colours and the work and the gates of the colour unit: reports/colour.json and docs/colour.md's
tables.

    msv2 study run colour            measures everything (minutes if nothing is cached) and writes the tables
    msv2 study run colour --check    the exit status is 1 if the page differs from the report

The errors are those of the golden renderer's colours, for several numbers of fraction bits of `sh_basis`, against float64
spherical harmonics of the same offsets and coefficients. Gates are generic and are counted as msv2/studies/area/culling.py
counts them, with every memory in bits. Both studies use the same cache, so that a unit which both measure is synthesised once.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from amaranth.lib import wiring

from golden.msv2_ref.colour import survivor_records
from msv2.studies import page
from msv2.studies.area.culling import CLOCK_PS
from msv2.studies.destination import newest
from msv2.studies.record import write_report
from rtl.culling.colour import ColourUnit, carried_layout, splat_interval
from rtl.culling.colour_sum import ColourSum
from rtl.culling.datapath import Datapath
from rtl.culling.harmonics import harmonics_graph
from rtl.culling.schedule import Cost, cost, schedule
from rtl.culling.views import RecordWriter
from spec import harmonics
from spec.command_line import command_parser
from spec.config import PAPER, PAPER_SMALL, TINY, AcceleratorConfig
from spec.formats import SQ
from spec.harmonics import basis_beyond_dc, terms
from spec.memory import colour_beats
from spec.paths import DOCS, REPORTS, ROOT
from spec.records import gaussian_colour, surviving_splat
from synth.report import Settings, synthesise

PAGE, REPORT = DOCS / "colour.md", REPORTS / "colour.json"

FRACTIONS = (12, 13, 14, 15, 16)
"""The numbers of fraction bits of `sh_basis` that are compared."""

SPLATS, COEFFICIENT_RMS, SEED = 60_000, 0.2, 0
SH_DEGREE = 3
MACHINES = (PAPER, PAPER_SMALL, TINY)


def lanes(config: AcceleratorConfig) -> int:
    """Number of basis functions that the unit multiplies with their coefficients in a cycle."""
    return -(-terms(SH_DEGREE) // splat_interval(config))


PARTS: dict[str, Callable[[AcceleratorConfig], wiring.Component]] = {
    "colour_unit": ColourUnit,
    "datapath": lambda c: Datapath(harmonics_graph(c, SH_DEGREE), interval=splat_interval(c), carried=carried_layout(c)),
    "colour_sum": lambda c: ColourSum(c, sh_degree=SH_DEGREE, lanes=lanes(c), carried=carried_layout(c)),
    "view_writer": lambda c: RecordWriter(c, carried=carried_layout(c)),
}
"""The colour unit and its parts. The queue of survivors and the reads belong to the unit itself."""

TITLES = {
    "colour_unit": "`ColourUnit`, all of it", "datapath": "`Datapath`: the functions", "colour_sum": "`ColourSum`: their sums",
    "view_writer": "`RecordWriter`"}


def random_splats(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """SPLATS SurvivingSplat and GaussianColour records with offsets of all directions and distances, and base colours of 1."""
    rng, n = np.random.default_rng(seed), PAPER.formats
    survivors = np.zeros(SPLATS, surviving_splat(PAPER).dtype)
    distances = 2.0 ** rng.uniform(-4, 6, (SPLATS, 1))
    survivors["offset"], survivors["levels"] = n.view.quantise(rng.normal(size=(SPLATS, 3)) * distances), 1
    records = np.zeros(SPLATS, gaussian_colour(PAPER).dtype)
    records["dc"] = 1 << n.sh_dc.frac_bits
    records["rest"] = n.sh_rest.quantise(rng.normal(0, COEFFICIENT_RMS, (SPLATS, 3 * terms(SH_DEGREE))))
    return survivors, records


def exact_colours(survivors: np.ndarray, records: np.ndarray) -> np.ndarray:
    """(SPLATS, 3) float64 colours in ulps of `colour`, clamped to its range but not rounded."""
    n = PAPER.formats
    offset = n.view.to_float(survivors["offset"])
    basis = basis_beyond_dc(offset / np.linalg.norm(offset, axis=1, keepdims=True), terms(SH_DEGREE))
    rest = n.sh_rest.to_float(records["rest"]).reshape(SPLATS, -1, 3)
    colour = n.sh_dc.to_float(records["dc"][:, :3]) + np.einsum("nk,nkc->nc", basis, rest)
    return np.clip(np.ldexp(colour, n.colour.frac_bits), 0, n.colour.raw_max)


def error_rows() -> list[dict[str, object]]:
    """Errors in ulps of `colour`, by the fraction bits of `sh_basis`. For null the functions are exact and only `colour` is
    rounded."""
    survivors, records = random_splats(SEED)
    exact, rows = exact_colours(survivors, records), []
    for fraction in (*FRACTIONS, None):
        if fraction is None:
            found = np.floor(exact + 0.5)
        else:
            config = PAPER.with_(formats=replace(PAPER.formats, sh_basis=SQ(0, fraction)))
            found = survivor_records(config, survivors, records, SH_DEGREE, 0)[0]["colour"][:, :3]
        error = found - exact
        rows.append({"fraction": fraction, "rms": round(float(np.sqrt(np.mean(error**2))), 4),
                     "largest": round(float(np.abs(error).max()), 4)})
    return rows


def function_rows() -> list[dict[str, int]]:
    """For each degree, the basis functions beyond the first, the products that compute them, and the beats of a colour
    record."""
    products = [sum(node.kind == "operation" for node in harmonics_graph(PAPER, d).nodes) for d in range(1, SH_DEGREE + 1)]
    return [{"degree": degree, "functions": terms(degree), "products": count, "beats": colour_beats(PAPER, degree)}
            for degree, count in enumerate([0, *products])]


def operand_bits() -> list[int]:
    """Widths of the two operands of every product."""
    return [harmonics.polynomial_format(PAPER.formats).width, harmonics.direction_format(PAPER.formats).width]


def counts(config: AcceleratorConfig) -> Cost:
    """The cost of the schedule of the basis functions."""
    return cost(schedule(harmonics_graph(config, SH_DEGREE), splat_interval(config)))


def multipliers(config: AcceleratorConfig) -> dict[str, int]:
    """The products per cycle of each part."""
    functions, sums = sum(counts(config).operators.values()), 3 * lanes(config)
    return {"colour_unit": functions + sums, "datapath": functions, "colour_sum": sums, "view_writer": 0}


def cost_rows(folder: Path) -> list[dict[str, object]]:
    """The rows of every part in every configuration; `folder` keeps netlists and results."""
    rows = []
    for name, make in PARTS.items():
        for config in MACHINES:
            gates = synthesise(make(config), name, Settings("generic", CLOCK_PS, folder, memory_limit=0))
            waiting = counts(config).register_bits if name in ("colour_unit", "datapath") else None
            rows.append({
                "part": name, "config": config.name, "interval": splat_interval(config),
                "multipliers": multipliers(config)[name], "register_bits": waiting,
                **{key: gates[key] for key in ("flip_flops", "memory_bits", "nand2_equivalents")}})
            print(rows[-1], flush=True)
    return rows


def functions_table(report: dict) -> str:
    """The table of products and beats by degree."""
    rows = [[f"{row[key]}" for key in ("degree", "functions", "products", "beats")] for row in report["functions"]]
    first, second = report["operand_bits"]
    table = page.table(["degree", "functions beyond the first", "products", "beats of a colour record"], rows)
    return f"{table}\n\nEvery product is of one kind, {first} x {second} bits."


def errors_table(report: dict) -> str:
    """The table of errors by fraction bits."""
    splats, rows = report["splats"], report["errors"]
    names = ["exact functions" if row["fraction"] is None else f"{row['fraction']}" for row in rows]
    lines = [[key, *(f"{row[key]:.4f}" for row in rows)] for key in ("rms", "largest")]
    return (f"{splats['count']:,} random splats of degree {splats['sh_degree']}, coefficients of "
            f"{splats['coefficient_rms']} rms:\n\n{page.table(['fraction of `sh_basis`', *names], lines)}")


def cost_table(report: dict) -> str:
    """The table of gates by part and configuration."""
    header = ["part", "machine", "cycles a splat", "multipliers", "waiting register bits", "flip-flops in all", "memory bits",
              "NAND2"]
    keys = ("interval", "multipliers", "register_bits", "flip_flops", "memory_bits", "nand2_equivalents")
    return page.table(header, [
        [TITLES[row["part"]], row["config"].upper(), *("-" if row[key] is None else f"{row[key]:,}" for key in keys)]
        for row in report["cost"]])


TABLES: dict[str, Callable[[dict], str]] = {
    "colour_functions": functions_table, "colour_errors": errors_table, "colour_cost": cost_table}
"""The tables by the names in the page's markers."""


def fill(path: Path, report: Path, *, check: bool = False) -> int:
    """Writes the tables into a page, each between `<!-- table:NAME -->` and `<!-- end -->`. With `check` it changes nothing and
    returns 1 where the page would change. Raises InputError where the page lacks a marker."""
    numbers = json.loads(report.read_text())
    return page.fill(path, {name: partial(table, numbers) for name, table in TABLES.items()}, check=check, complete=True)


def measure(folder: Path) -> dict[str, object]:
    """The content of the report."""
    return {
        "splats": {"count": SPLATS, "sh_degree": SH_DEGREE, "coefficient_rms": COEFFICIENT_RMS, "seed": SEED},
        "operand_bits": operand_bits(), "functions": function_rows(), "errors": error_rows(), "cost": cost_rows(folder)}


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line."""
    parser = command_parser("msv2 study run colour", "Errors and gates of colours.")
    parser.add_argument("--check", action="store_true", help="change nothing; exit 1 where the page is stale")
    args = parser.parse_args(argv)
    if not args.check:
        write_report(REPORT, measure(ROOT / "build" / "results" / "synth"), [__name__], {"machines": MACHINES})
    return fill(PAGE, newest(REPORT), check=args.check)
