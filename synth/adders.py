"""Rebuilds the sums and products of a Yosys netlist (JSON), its `$macc_v2` and adding `$alu` cells, from full adders."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import reduce
from math import inf

from synth.heap import Adder, Bit, Cut, Gate, Node, add_up, choose_blocks, choose_flips
from synth.liberty import Technology

Net = int | str  # a wire bit's number, or the constant "0" or "1"


@dataclass
class Builder:
    """Adds cells to one module of a JSON netlist."""

    module: dict
    technology: Technology
    sum_name: str = ""
    next_net: int = 0
    cells: int = 0
    complements: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        nets = [bit for cell in self.module["cells"].values() for bits in cell["connections"].values() for bit in bits]
        nets += [bit for port in self.module["ports"].values() for bit in port["bits"]]
        nets += [bit for name in self.module["netnames"].values() for bit in name["bits"]]
        self.next_net = 1 + max((bit for bit in nets if isinstance(bit, int)), default=1)

    def net(self) -> int:
        """A new net."""
        self.next_net += 1
        return self.next_net - 1

    def cell(self, kind: str, inputs: dict[str, Net], outputs: dict[str, int]) -> None:
        """Add a cell; `inputs` and `outputs` give the net of each pin."""
        self.cells += 1
        self.module["cells"][f"{self.sum_name}_fa{self.cells}"] = {
            "hide_name": 0, "type": kind, "parameters": {}, "attributes": {},
            "port_directions": {**dict.fromkeys(inputs, "input"), **dict.fromkeys(outputs, "output")},
            "connections": {pin: [net] for pin, net in {**inputs, **outputs}.items()},
        }

    def gate(self, kind: str, a: Net, b: Net) -> int:
        """Add a gate of two inputs; returns its output."""
        y = self.net()
        self.cell(f"$_{kind}_", {"A": a, "B": b}, {"Y": y})
        return y

    def complement(self, net: Net) -> Net:
        """The complement of a net, from an inverter that is added once."""
        if isinstance(net, str):
            return {"0": "1", "1": "0", "x": "x"}[net]
        if net not in self.complements:
            self.complements[net] = self.net()
            self.cell("$_NOT_", {"A": net}, {"Y": self.complements[net]})
        return self.complements[net]


def map_adders(
    module: dict, technology: Technology, blocks: Mapping[str, Sequence[int]], budgets: Mapping[str, float] | None = None,
) -> dict[str, Cut]:
    """Replace the sums of one module, in place, by the library's full adders.

    `blocks`: for a sum, by the name of its result, the incremented blocks of its carry chain. Any other sum gets blocks if it
    would otherwise take longer than its budget. `budgets` has that budget in ps under the sum's name, or else under "".

    Returns how each of those other sums is built, by name.
    """
    chosen: dict[str, Cut] = {}
    budgets = budgets or {}
    used = Counter(bit for cell in module["cells"].values() for pin, bits in cell["connections"].items()
                   if cell["port_directions"][pin] == "input" for bit in set(bits))
    used.update(bit for port in module["ports"].values() if port["direction"] == "output" for bit in set(port["bits"]))
    builder, names = Builder(module, technology), Counter()
    for name, cell in list(module["cells"].items()):
        columns = _columns(cell, used)
        if columns is not None:
            del module["cells"][name]
            result = cell["connections"]["Y"]
            while result and not used[result[-1]]:
                result.pop()
            builder.sum_name = _result_name(module, result)
            columns = columns[:len(result)]
            hint = blocks.get(builder.sum_name)
            names[builder.sum_name] += 1
            if hint is None and names[builder.sum_name] > 1:
                builder.sum_name += f"_{names[builder.sum_name]}"
            if hint is None and columns:
                cut = choose_blocks(columns, budgets.get(builder.sum_name, budgets.get("", inf)))
                chosen[builder.sum_name] = cut
            else:
                cut = Cut(0.0, tuple(hint or ()))
            _build(builder, add_up(columns, *cut[1:]), result, used)
    return chosen


def _columns(cell: dict, used: Counter) -> list[list[Bit]] | None:
    """The bit heap of a cell; None for a cell that is left to Yosys."""
    if cell["type"] not in ("$alu", "$macc_v2"):
        return None
    parameter = {key: int(value, 2) for key, value in cell["parameters"].items() if value and set(value) <= set("01")}
    pins = cell["connections"]
    columns: list[list[Bit]] = [[] for _ in pins["Y"]]
    if cell["type"] == "$alu":
        constant = {"0", "1"}
        if any(used[bit] for pin in ("X", "CO") for bit in pins[pin]) or not {pins["CI"][0], pins["BI"][0]} <= constant:
            return None
        _add(columns, pins["A"], parameter["A_SIGNED"], False)
        _add(columns, pins["B"], parameter["B_SIGNED"], pins["BI"] == ["1"])
        columns[0] += [Bit(net="1")] if pins["CI"] == ["1"] else []
        return columns
    a, b, c = (iter(pins[pin]) for pin in "ABC")
    below_zero = 0
    for k, (a_width, b_width) in enumerate(zip(_widths(cell, "A", "NPRODUCTS"), _widths(cell, "B", "NPRODUCTS"), strict=True)):
        x, y = [next(a) for _ in range(a_width)], [next(b) for _ in range(b_width)]
        signs = [bool(parameter.get(key, 0) >> k & 1) for key in ("PRODUCT_NEGATED", "A_SIGNED", "B_SIGNED")]
        below_zero += _multiply(columns, x, y, *signs)
    columns_set = -below_zero % (1 << len(columns))
    for place, column in enumerate(columns):
        column.extend([Bit(net="1")] if columns_set >> place & 1 else [])
    for k, width in enumerate(_widths(cell, "C", "NADDENDS")):
        negated = parameter["ADDEND_NEGATED"] >> k & 1
        _add(columns, [next(c) for _ in range(width)], parameter["C_SIGNED"] >> k & 1, bool(negated))
        columns[0] += [Bit(net="1")] if negated else []
    return columns


def _multiply(columns: list[list[Bit]], x: list[Net], y: list[Net], negated: bool, x_signed: bool, y_signed: bool) -> int:
    """Add a product to the heap.

    A bit with negative weight is complemented, which adds its weight to the result; returns the sum of these excess weights.
    """
    excess = 0
    for i, x_bit in enumerate(x):
        for j, y_bit in enumerate(y):
            if i + j < len(columns) and "0" not in (x_bit, y_bit):
                negative = negated ^ (x_signed and i == len(x) - 1) ^ (y_signed and j == len(y) - 1)
                columns[i + j].append(Bit(product=(x_bit, y_bit), inverted=negative))
                excess += negative << (i + j)
    return excess


def _result_name(module: dict, result: list[Net]) -> str:
    """The name of a wire that the sum's top bit belongs to."""
    names = [name for name, wire in module["netnames"].items() if result[-1] in wire["bits"] and not wire["hide_name"]]
    return min(names, key=lambda name: (len(name), name), default="sum").replace("$", "_")


def _widths(cell: dict, operand: str, count: str) -> list[int]:
    packed = cell["parameters"][f"{operand}_WIDTHS"]
    number = int(cell["parameters"][count], 2)
    return [int(packed, 2) >> 16 * k & 0xFFFF for k in range(number)]


def _add(columns: list[list[Bit]], bits: list[Net], signed: bool, inverted: bool) -> None:
    """Add an operand, extended to the width of the heap."""
    top = bits[-1] if signed else "0"
    for column, bit in zip(columns, [*bits, *[top] * len(columns)], strict=False):
        if isinstance(bit, str):
            column.extend([Bit(net="1")] if (bit == "1") != inverted else [])
        else:
            column.append(Bit(net=bit, inverted=inverted))


def _build(builder: Builder, added: tuple[list[Bit | None], list[Node]], result: list[int], used: Counter) -> None:
    results, nodes = added
    wanted = {id(bit) for bit, net in zip(results, result, strict=True) if used[net]}
    for node in reversed(nodes):
        if any(id(bit) in wanted for bit in _outputs(node)):
            wanted |= {id(bit) for bit in node.inputs}
    full = [node for node in nodes if isinstance(node, Adder) and id(node.sum) in wanted]
    if builder.technology.adder_inverts:
        choose_flips(full, [node for node in nodes if isinstance(node, Gate)])
    native: dict[int, tuple[Net, bool]] = {}  # the output of a node -> (net, whether the net holds the complement)
    for node in nodes:
        if not any(id(bit) in wanted for bit in _outputs(node)):
            continue
        if isinstance(node, Gate):
            native[id(node.output)] = _add_gate(builder, node, native), False
        elif id(node.sum) in wanted:
            _add_full_adder(builder, node, native)
        else:
            native[id(node.carry)] = _add_majority(builder, node, native), False
    for bit, net in zip(results, result, strict=True):
        if used[net]:
            builder.cell("$_BUF_", {"A": "0" if bit is None else _in_polarity(builder, bit, False, native)}, {"Y": net})


def _outputs(node: Node) -> tuple[Bit, ...]:
    return (node.output,) if isinstance(node, Gate) else (node.sum, node.carry)


def _add_full_adder(builder: Builder, adder: Adder, native: dict[int, tuple[Net, bool]]) -> None:
    cell, names = builder.technology.full_adder
    pins = [_in_polarity(builder, bit, adder.flipped, native) for bit in adder.inputs]
    pins += [str(int(adder.flipped))] * (3 - len(pins))
    sum_net, carry_net = builder.net(), builder.net()
    complemented = adder.flipped != builder.technology.adder_inverts
    native[id(adder.sum)], native[id(adder.carry)] = (sum_net, complemented), (carry_net, complemented)
    builder.cell(cell, dict(zip(names, pins, strict=False)), {names[4]: sum_net, names[3]: carry_net})


def _add_majority(builder: Builder, adder: Adder, native: dict[int, tuple[Net, bool]]) -> Net:
    """Add the carry alone, for an adder whose sum is not used."""
    pins = [_in_polarity(builder, bit, False, native) for bit in adder.inputs]
    both = builder.gate("AND", *pins[:2])
    if len(pins) == 2:
        return both
    return builder.gate("OR", both, builder.gate("AND", pins[2], builder.gate("OR", *pins[:2])))


def _add_gate(builder: Builder, gate: Gate, native: dict[int, tuple[Net, bool]]) -> Net:
    inputs = [_in_polarity(builder, bit, False, native) for bit in gate.inputs]
    if gate.kind not in builder.technology.gates:
        return _plain_gate(builder, gate.kind, inputs)
    cell, pins = builder.technology.gates[gate.kind]
    net = builder.net()
    builder.cell(cell, dict(zip(pins, inputs, strict=True)), {"Y": net})
    return net


def _plain_gate(builder: Builder, kind: str, inputs: list[Net]) -> Net:
    """Add the same gate from Yosys' own cells."""
    if kind == "XOR2":
        return builder.gate("XOR", *inputs)
    if kind == "AO21":
        return builder.gate("OR", builder.gate("AND", *inputs[:2]), inputs[2])
    return reduce(lambda a, b: builder.gate("AND", a, b), inputs)


def _in_polarity(builder: Builder, bit: Bit, complemented: bool, native: dict[int, tuple[int, bool]]) -> Net:
    """A net that holds the bit, or its complement if `complemented` is set."""
    if bit.product is not None:
        return builder.gate("NAND" if complemented != bit.inverted else "AND", *bit.product)
    net, inverted = native[id(bit)] if bit.source is not None else (bit.net, bit.inverted)
    return net if inverted == complemented else builder.complement(net)
