"""The dataflow engine: the same graph at several intervals, in Amaranth's simulator, against numpy and spec's rounding."""

from __future__ import annotations

import random
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from amaranth.hdl import Mux, unsigned

from rtl.culling import compare
from rtl.culling.dataflow import Dataflow
from rtl.culling.datapath import Datapath
from rtl.culling.schedule import cost, schedule
from spec.config import PAPER, NumberFormats
from spec.errors import InputError
from spec.formats import SQ, Rounding, SmallFloat
from tests.helpers.rtl_streams import assert_rejected, exchange

N = NumberFormats()
V, W = N.view, N.work
TINY = SmallFloat(4, 4, 7)
WHOLE = SQ(6, 3)
INTERVALS = (1, 2, 3, 4, 8)


def every_operation(**options: bool) -> Dataflow:
    """A graph with each operation, views, logic, settings, constants and a value that waits long."""
    g = Dataflow(**options)
    x, y, n = g.input("x", V), g.input("y", V), g.input("n", SQ(5, 4))
    scale, (low, high) = g.setting("scale", W), g.settings("limits", V, 2)
    total, product = g.add(x, y, V), g.mul(x, scale, W)
    difference = g.sub(total, g.constant(0.75, V), V)
    quotient = g.divide(product, g.to_float(n, W), W)
    absolute = g.view("absolute", V, lambda a: a[:-1], difference)
    root, inverse = g.sqrt(absolute, W), g.rsqrt(absolute, W)
    g.output("sum", total)
    g.output("slope", g.mul(g.negative(quotient), g.reciprocal(y, W), W))
    g.output("whole", g.to_fixed(g.add(root, inverse, W), WHOLE))
    g.output("floor", g.to_fixed(quotient, WHOLE, Rounding.FLOOR))
    inside = g.logic("inside", unsigned(1), lambda a, low, high: (a != low) & (a != high), difference, low, high)
    g.output("sides", g.logic("sides", unsigned(2), lambda i, n: Mux(i, n[:2], 3), inside, n))
    g.output("direct", x)
    return g


def expected(x: float, y: float, n: float, scale: float, limits: tuple[float, float], raw_n: int) -> dict[str, int]:
    """What the graph gives, in float64 and roundings."""
    def rnd(f: SmallFloat, value: float) -> float:
        return float(f.round(np.clip(value, -1e300, 1e300)))

    total, product = rnd(V, x + y), rnd(W, x * scale)
    difference = rnd(V, total - 0.75)
    quotient = rnd(W, product / n if n else np.sign(product) * np.inf)
    root = rnd(W, np.sqrt(abs(difference)))
    inverse = rnd(W, 1 / np.sqrt(abs(difference)) if difference else np.inf)
    slope = rnd(W, -quotient * rnd(W, 1 / y if y else np.inf))
    return {
        "sum": int(V.quantise(total)), "slope": int(W.quantise(slope)),
        "whole": int(WHOLE.quantise(rnd(W, root + inverse))), "floor": int(WHOLE.quantise(quotient, Rounding.FLOOR)),
        "sides": raw_n & 3 if difference not in limits else 3, "direct": int(V.quantise(x))}


def operands(rng: random.Random, count: int) -> list[tuple[float, float, int]]:
    def number() -> float:
        return rng.choice([0.0, 0.75, 1.0, rng.uniform(-2, 2), rng.uniform(-1, 1) * 2.0 ** rng.randint(-30, 30)])

    return [(float(V.round(number())), float(V.round(number())), rng.randrange(-512, 512)) for _ in range(count)]


def run(graph: Dataflow, interval: int, rows: list[tuple[float, float, int]], **options) -> list[int]:
    """Plays the rows, compares, and returns the cycles in which they left."""
    unit, scale, limits = Datapath(graph, interval=interval, carried=unsigned(10)), float(W.round(1.7)), (0.25, -0.75)
    sink, source = unit.sink.payload.shape(), unit.source.payload.shape()
    words, wanted = [], []
    for i, (x, y, raw) in enumerate(rows):
        words.append(sink.const(
            {"x": int(V.quantise(x)), "y": int(V.quantise(y)), "n": raw, "carried": i % 1024}).as_bits())
        wanted.append(source.const({
            **expected(x, y, raw / 16, scale, limits, raw), "carried": i % 1024}).as_bits())

    def setup(ctx) -> None:
        ctx.set(unit.scale, int(W.quantise(scale)))
        for i, limit in enumerate(limits):
            ctx.set(unit.limits[i], int(V.quantise(limit)))

    got, cycles = exchange(unit, {unit.sink: words}, unit.source, len(words), setup=setup, **options)
    for row, g, w in zip(rows, got, wanted, strict=True):
        assert g == w, (row, source.from_bits(g), source.from_bits(w))
    return cycles


@pytest.mark.parametrize("pauses", [0, 0.6])
@pytest.mark.parametrize("interval", INTERVALS)
def test_every_operation_at_every_interval(interval, pauses):
    run(every_operation(), interval, operands(random.Random(interval), 200), pauses=pauses, seed=interval)


@pytest.mark.parametrize("interval", INTERVALS)
def test_rate_and_latency(interval):
    graph = every_operation()
    cycles = run(graph, interval, operands(random.Random(9), 100))
    assert {b - a for a, b in pairwise(cycles)} == {interval}
    assert cycles[0] in range(schedule(graph, interval).length + 2, schedule(graph, interval).length + 2 + interval + 1)


@pytest.mark.parametrize("interval", [1, 4])
def test_operands_in_registers_only_cost_time(interval):
    plain, graph = every_operation(), every_operation(registered=True)
    run(graph, interval, operands(random.Random(3), 60), pauses=0.3, seed=interval)
    assert schedule(graph, interval).length > schedule(plain, interval).length


def random_graph(rng: random.Random) -> Dataflow:
    """Sums, products and logic of anything that came before."""
    g = Dataflow()
    nodes = [g.input(f"x{i}", TINY) for i in range(4)]
    for i in range(rng.randint(1, 25)):
        a, b = rng.choice(nodes), rng.choice(nodes)
        nodes.append(rng.choice([
            lambda a=a, b=b: g.add(a, b, TINY), lambda a=a, b=b: g.mul(a, b, TINY), lambda a=a, b=b: g.sub(a, b, TINY),
            lambda a=a: g.negative(a),
            lambda a=a, b=b, i=i: g.logic(f"or_{i}", TINY, lambda a, b: a | b, a, b)])())
    for i in range(3):
        g.output(f"y{i}", rng.choice(nodes))
    return g


@pytest.mark.parametrize("seed", range(6))
def test_random_graphs_agree_at_all_intervals(seed):
    graph, found = random_graph(random.Random(seed)), set()
    words = [random.Random(f"{seed} words").getrandbits(32) for _ in range(60)]
    for interval in (1, 2, 5):
        unit = Datapath(graph, interval=interval)
        got, _ = exchange(unit, {unit.sink: words}, unit.source, len(words), pauses=0.3, seed=seed)
        found.add(tuple(got))
    assert len(found) == 1


def test_operators_are_shared_and_registers_saved():
    costs = {interval: cost(schedule(every_operation(), interval), 10) for interval in INTERVALS}
    assert costs[1].operators == {
        "FixedToFloat": 1, "FloatAdd": 3, "FloatDivide": 1, "FloatMul": 2, "FloatReciprocal": 1, "FloatRsqrt": 1,
        "FloatSqrt": 1, "FloatToFixed": 2}
    assert costs[1].mux_bits == 0 and costs[2].mux_bits > 0
    assert costs[8].operators["FloatAdd"] == 2  # two formats
    assert costs[8].register_bits < costs[4].register_bits < costs[2].register_bits < costs[1].register_bits
    assert costs[8].queue_bits < costs[1].queue_bits


def test_no_two_operations_meet():
    for interval in INTERVALS:
        plan = schedule(every_operation(), interval)
        for users in plan.instances.values():
            for nodes in users:
                assert len({plan.start[node] % interval for node in nodes}) == len(nodes) <= interval


def fewest_by_trial(graph: Dataflow, plan) -> int:
    """Register bits of the best of all start times of the same length."""
    nodes = [node for node in graph.nodes if node in plan.start]
    best, start = 1 << 30, {}

    def bits() -> int:
        return cost(replace(plan, start=dict(start))).register_bits

    def assign(rest: list) -> None:
        nonlocal best
        if not rest:
            best = min(best, bits())
            return
        node = rest[0]
        first = 1
        for operand in (o.stored for o in node.operands if not o.stored.steady):
            latency = operand.operator.latency if operand.operator else 0
            first = max(first, start.get(operand, 0) + latency + (operand.operator is None))
        for cycle in range(first, plan.length - (node.operator.latency if node.operator else 0) + 1):
            start[node] = cycle
            assign(rest[1:])
        start.pop(node, None)

    assign(nodes)
    return best


def small_graph(rng: random.Random) -> Dataflow:
    """A few sums and logic beside a chain that gives them slack."""
    g = Dataflow()
    nodes = [g.input(f"x{i}", TINY) for i in range(2)]
    chain = g.mul(g.mul(nodes[0], nodes[1], TINY), nodes[0], TINY)
    for i in range(3):
        a, b = rng.choice(nodes), rng.choice(nodes)
        wide = rng.choice([unsigned(3), unsigned(8), unsigned(20)])
        nodes.append(g.mul(a, b, TINY) if rng.random() < 0.4 and TINY in (a.to, b.to) and a.to == b.to else
                     g.logic(f"l{i}", wide, lambda a, b: a ^ b, a, b))
    g.output("y", g.logic("y", unsigned(8), lambda *x: x[0] ^ x[-1], chain, *nodes[2:]))
    return g


@pytest.mark.parametrize("seed", range(8))
def test_no_schedule_of_one_slot_a_cycle_has_fewer_registers(seed):
    graph = small_graph(random.Random(seed))
    plan = schedule(graph, 1)
    assert cost(plan).register_bits == fewest_by_trial(graph, plan)


def test_one_unit_for_every_cycle_needs_less_than_eight_that_take_turns(capsys):
    """The reason for the projection unit's shape."""
    assert compare.main([]) == 0
    printed = capsys.readouterr().out
    costs = compare.comparison(PAPER)
    assert list(costs) == [(1, 1), (2, 2), (4, 4), (8, 8)] and len(printed.splitlines()) == 2 + 4
    one, eight = costs[1, 1], costs[8, 8]
    assert f"{eight.register_bits:,}" in printed
    assert one.register_bits < eight.register_bits and one.mux_bits == 0 < eight.mux_bits
    assert one.queue_bits < eight.queue_bits
    assert all(count <= eight.operators[kind] for kind, count in one.operators.items())
    assert one == compare.unit_cost(PAPER, 1)
    for wrong in ("1/3", "0", "much"):
        with pytest.raises(InputError, match=f"'{wrong}' is not accepted"):
            compare.main(["--points-per-cycle", wrong])


def test_bad_parameters_are_rejected():
    g = every_operation()
    for interval, error in ((0, ValueError), (True, TypeError), ("4", TypeError)):
        assert_rejected(lambda interval=interval: Datapath(g, interval=interval), error, interval)
    assert_rejected(lambda: Datapath("graph", interval=1), TypeError, "graph")
    assert_rejected(lambda: g.input("x", V), ValueError, "x")
    assert_rejected(lambda: g.constant(0.3, V), ValueError, 0.3)
    assert_rejected(lambda: g.add(g.inputs["x"], g.inputs["x"], W), ValueError, V)
    assert_rejected(lambda: g.mul(g.inputs["n"], g.inputs["x"], W), TypeError, SQ(5, 4))
    assert_rejected(lambda: g.mul(1.5, g.inputs["x"], W), TypeError, 1.5)
    assert_rejected(lambda: schedule(Dataflow(), 1), ValueError, {})
