"""Sums and products of a Yosys netlist (JSON) rebuilt from full adders: `$macc_v2` and adding `$alu` cells."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from synth.heap import Adder, Bit, choose_flips, reduce

Net = int | str  # a wire bit's number, or the constant "0" or "1"


@dataclass
class Counts:
    """What was built."""

    cells: int = 0
    adders: int = 0
    inverters: int = 0


@dataclass
class Builder:
    """Adds cells to one module of a JSON netlist."""

    module: dict
    full_adder: str
    next_net: int = 0
    complements: dict[int, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        nets = [bit for cell in self.module["cells"].values() for bits in cell["connections"].values() for bit in bits]
        nets += [bit for port in self.module["ports"].values() for bit in port["bits"]]
        nets += [bit for name in self.module["netnames"].values() for bit in name["bits"]]
        self.next_net = 1 + max((bit for bit in nets if isinstance(bit, int)), default=1)

    def net(self) -> int:
        self.next_net += 1
        return self.next_net - 1

    def cell(self, kind: str, inputs: dict[str, Net], outputs: dict[str, int]) -> None:
        self.module["cells"][f"$heap${len(self.module['cells'])}_{self.next_net}"] = {
            "hide_name": 1, "type": kind, "parameters": {}, "attributes": {},
            "port_directions": {**dict.fromkeys(inputs, "input"), **dict.fromkeys(outputs, "output")},
            "connections": {pin: [net] for pin, net in {**inputs, **outputs}.items()},
        }

    def gate(self, kind: str, a: Net, b: Net) -> int:
        y = self.net()
        self.cell(f"$_{kind}_", {"A": a, "B": b}, {"Y": y})
        return y

    def complement(self, net: Net) -> Net:
        if isinstance(net, str):
            return {"0": "1", "1": "0", "x": "x"}[net]
        if net not in self.complements:
            self.complements[net] = self.net()
            self.cell("$_NOT_", {"A": net}, {"Y": self.complements[net]})
        return self.complements[net]


def map_adders(module: dict, full_adder: str) -> Counts:
    """Replace, in place, the sums of one module by full adders of type `full_adder` (pins A, B, CI, CON, SN)."""
    used = Counter(bit for cell in module["cells"].values() for pin, bits in cell["connections"].items()
                   if cell["port_directions"][pin] == "input" for bit in set(bits))
    used.update(bit for port in module["ports"].values() if port["direction"] == "output" for bit in set(port["bits"]))
    builder, counts = Builder(module, full_adder), Counts()
    for name, cell in list(module["cells"].items()):
        columns = _columns(cell, used)
        if columns is not None:
            del module["cells"][name]
            _build(builder, columns, cell["connections"]["Y"], used, counts)
    return counts


def _columns(cell: dict, used: Counter) -> list[list[Bit]] | None:
    """The bit heap of a cell; None for what is left to Yosys."""
    if cell["type"] not in ("$alu", "$macc_v2"):
        return None
    parameter = {key: int(value, 2) for key, value in cell["parameters"].items() if set(value) <= set("01")}
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
    if parameter.get("PRODUCT_NEGATED") or parameter.get("A_SIGNED") or parameter.get("B_SIGNED"):
        return None
    a, b, c = (iter(pins[pin]) for pin in "ABC")
    for a_width, b_width in zip(_widths(cell, "A", "NPRODUCTS"), _widths(cell, "B", "NPRODUCTS"), strict=True):
        x, y = [next(a) for _ in range(a_width)], [next(b) for _ in range(b_width)]
        for i, x_bit in enumerate(x):
            for j, y_bit in enumerate(y):
                if i + j < len(columns) and "0" not in (x_bit, y_bit):
                    columns[i + j].append(Bit(product=(x_bit, y_bit)))
    for k, width in enumerate(_widths(cell, "C", "NADDENDS")):
        negated = parameter["ADDEND_NEGATED"] >> k & 1
        _add(columns, [next(c) for _ in range(width)], parameter["C_SIGNED"] >> k & 1, bool(negated))
        columns[0] += [Bit(net="1")] if negated else []
    return columns


def _widths(cell: dict, operand: str, count: str) -> list[int]:
    packed = cell["parameters"][f"{operand}_WIDTHS"]
    number = int(cell["parameters"][count], 2)
    return [int(packed, 2) >> 16 * k & 0xFFFF for k in range(number)]


def _add(columns: list[list[Bit]], bits: list[Net], signed: bool, inverted: bool) -> None:
    """Add an operand, extended to the heap's width."""
    top = bits[-1] if signed else "0"
    for column, bit in zip(columns, [*bits, *[top] * len(columns)], strict=False):
        if isinstance(bit, str):
            column.extend([Bit(net="1")] if (bit == "1") != inverted else [])
        else:
            column.append(Bit(net=bit, inverted=inverted))


def _build(builder: Builder, columns: list[list[Bit]], result: list[int], used: Counter, counts: Counts) -> None:
    results, adders = reduce(columns)
    wanted = {id(bit) for bit, net in zip(results, result, strict=True) if used[net]}
    wanted |= {id(bit) for adder in adders for bit in adder.inputs}
    full = [adder for adder in adders if id(adder.sum) in wanted]
    counts.inverters += choose_flips(full)
    counts.cells += 1
    counts.adders += len(full)
    native: dict[int, tuple[int, bool]] = {}  # adder output -> (net, the net holds the complement)
    for adder in adders:
        if id(adder.sum) in wanted:
            pins = [_in_polarity(builder, bit, adder.flipped, native) for bit in adder.inputs]
            pins += [_constant("0", adder.flipped)] * (3 - len(pins))
            outputs = {}
            for pin, bit in (("SN", adder.sum), ("CON", adder.carry)):
                native[id(bit)] = builder.net(), not adder.flipped
                outputs[pin] = native[id(bit)][0]
            builder.cell(builder.full_adder, dict(zip(("A", "B", "CI"), pins, strict=True)), outputs)
        elif id(adder.carry) in wanted:
            pins = [_in_polarity(builder, bit, False, native) for bit in adder.inputs]
            both = builder.gate("AND", *pins[:2])
            if len(pins) == 3:
                both = builder.gate("OR", both, builder.gate("AND", pins[2], builder.gate("OR", *pins[:2])))
            native[id(adder.carry)] = both, False
    for bit, net in zip(results, result, strict=True):
        if used[net]:
            value: Net = "0" if bit is None else _in_polarity(builder, bit, False, native)
            builder.cell("$_BUF_", {"A": value}, {"Y": net})


def _constant(value: str, complemented: bool) -> str:
    return str(int(value) ^ complemented)


def _in_polarity(builder: Builder, bit: Bit, complemented: bool, native: dict[int, tuple[int, bool]]) -> Net:
    """A net that holds the bit, or its complement."""
    if bit.product is not None:
        return builder.gate("NAND" if complemented else "AND", *bit.product)
    net, inverted = native[id(bit)] if bit.source is not None else (bit.net, bit.inverted)
    return net if inverted == complemented else builder.complement(net)


__all__ = ["Adder", "Counts", "map_adders"]
