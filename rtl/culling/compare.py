"""Compares one projection unit at full rate with several slower units that have the same throughput together.

    python -m rtl.culling.compare --points-per-cycle 1

`k` units that each take a Gaussian every `n` cycles process k / n Gaussians per cycle. All rows of the table have the same
throughput and do the same arithmetic. They differ in how many operations an operator serves. With more units, operators are
shared by more operations, which needs multiplexers; every unit holds the values of its own Gaussians; and operators of a kind
that is needed only once are idle most of the time.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from fractions import Fraction

from amaranth.hdl import Shape
from amaranth.lib import data

from rtl.culling.near import near_graph
from rtl.culling.projection import projection_graph
from rtl.culling.schedule import Cost, cost, schedule
from rtl.shapes import layout
from spec.command_line import command_parser
from spec.config import PAPER, AcceleratorConfig
from spec.errors import InputError, run_command_line
from spec.records import gaussian_point, projected_splat

INTERVALS = (1, 2, 4, 8)
"""The intervals, in cycles per Gaussian, that are compared."""


def unit_cost(config: AcceleratorConfig, interval: int) -> Cost:
    """Cost of one unit, near test and projection, that takes a Gaussian every `interval` cycles."""
    point, splat = layout(gaussian_point(config)), layout(projected_splat(config))
    near = cost(schedule(near_graph(config), interval), _bits(point) - _bits(point["mean"].shape))
    carried = sum(_bits(splat[name].shape) for name in ("index", "bound", "log2_opacity", "offset", "depth", "end"))
    projection = cost(schedule(projection_graph(config), interval), carried)
    operators = Counter(near.operators) + Counter(projection.operators)
    numbers = {name: getattr(near, name) + getattr(projection, name)
               for name in ("register_bits", "mux_bits", "queue_bits", "latency")}
    return Cost(dict(sorted(operators.items())), **numbers)


def _bits(shape: object) -> int:
    return Shape.cast(shape.as_shape() if isinstance(shape, data.Layout) else shape).width


def comparison(config: AcceleratorConfig, points_per_cycle: Fraction = Fraction(1)) -> dict[tuple[int, int], Cost]:
    """Costs of all units together, by (units, interval). Intervals at which no whole number of units has the throughput are
    left out."""
    found = {}
    for interval in INTERVALS:
        units = points_per_cycle * interval
        if units.denominator == 1 and units >= 1:
            c, k = unit_cost(config, interval), int(units)
            operators = {kind: k * count for kind, count in c.operators.items()}
            found[k, interval] = Cost(operators, k * c.register_bits, k * c.mux_bits, k * c.queue_bits, c.latency)
    return found


def table(costs: dict[tuple[int, int], Cost]) -> str:
    """The comparison in Markdown."""
    kinds = sorted({kind for c in costs.values() for kind in c.operators})
    head = ["units", "cycles a point", *kinds, "register bits", "2:1 mux bits", "queue bits", "latency"]
    rows = [
        [units, interval, *(c.operators.get(kind, 0) for kind in kinds), c.register_bits, c.mux_bits, c.queue_bits, c.latency]
        for (units, interval), c in costs.items()]
    lines = [head, ["---:"] * len(head), *([f"{cell:,}" for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line and returns the exit status."""
    parser = command_parser("python -m rtl.culling.compare", __doc__.splitlines()[0])
    parser.add_argument("--points-per-cycle", default="1", help="throughput, such as 1 (default), 1/2 or 2")
    args = parser.parse_args(argv)
    try:
        throughput = Fraction(args.points_per_cycle)
    except (ValueError, ZeroDivisionError):
        throughput = Fraction(0)
    costs = comparison(PAPER, throughput) if throughput > 0 else {}
    if not costs:
        raise InputError(f"throughput {args.points_per_cycle!r} is not accepted: give 1/8, 1/4, 1/2 or a whole number")
    print(table(costs))
    return 0


if __name__ == "__main__":
    run_command_line(main)
