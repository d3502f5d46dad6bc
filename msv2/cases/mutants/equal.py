"""Whether a mutant computes the same as the sound circuit, by SAT.

Both circuits are cut at the ports of their memories, those in Verilog included: what comes out of a memory may be anything, and
what goes into it is compared, as are the outputs. At first they are cut at their registers, too; only registers that are known
to keep their initial values for ever, whatever comes in, have these. Where that finds a difference, a second question keeps
the registers and begins with their initial values, so that only states count that can be reached. What is called equal is
equal. A question that stays open counts as not equal.

All mutants are in one circuit with a number at its inputs. `Circuit.differs` builds it twice from AND gates, with 0 and with
the mutant's number in place of those inputs, shares what is the same, and gives the rest to ABC.
"""

from __future__ import annotations

import re
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from msv2.cases.formal.circuit import TO_GATES, find_abc
from msv2.cases.mutants.mutate import SELECT, Mutant, applied, yosys

SECONDS = 20
"""Limit of one question."""

_CUT: dict[str, tuple[dict[str, int | str], dict[str, int | str]]] = {
    "$memrd_v2": ({"EN": 1, "ARST": 1, "SRST": 1, "ADDR": "ABITS"}, {"DATA": "WIDTH"}),
    "$memwr_v2": ({"EN": "WIDTH", "ADDR": "ABITS", "DATA": "WIDTH"}, {})}
"""What goes into the port of a memory and what comes out of it, with the width or the parameter that has it."""

_FIRST_PORT = 1_000_000

_PASSES = f"delete t:$scopeinfo{TO_GATES}"


def without_memories(text: str) -> str:
    """RTLIL of one module whose memories are cut: what goes into their ports are outputs, what comes out are inputs."""
    wires: list[str] = []
    cells = re.compile(r"(?ms)^  cell (\$mem\w+) [^\n]*\n(.*?)^  end\n")

    def cut(cell: re.Match[str]) -> str:
        if cell[1].startswith("$meminit"):
            return ""
        parameters = {name: int(value) for name, value in re.findall(r"parameter \\(\w+) (\d+)\n", cell[2])}
        signals = dict(re.findall(r"connect \\(\w+) (.*)\n", cell[2]))
        found = []
        for way, ports in zip(("output", "input"), _CUT[cell[1]], strict=True):
            for port, width in ports.items():
                name = f"\\cut_{len(wires)}"
                bits = parameters[width] if isinstance(width, str) else width
                wires.append(f"  wire width {bits} {way} {_FIRST_PORT + len(wires)} {name}\n")
                ends = (name, signals[port]) if way == "output" else (signals[port], name)
                found.append(f"  connect {ends[0]} {ends[1]}\n")
        return "".join(found)

    head, body = re.split(r"(?m)(?<=^)(?=module )", text, maxsplit=1)
    first, rest = body.split("\n", 1)
    rest = cells.sub(cut, re.sub(r"(?m)^ *attribute (?!\\init )[^\n]*\n", "", rest))
    rest = re.sub(r"(?m)^  memory [^\n]*\n", "", rest)
    return f"{head}{first}\n{''.join(wires)}{rest}"


@dataclass(frozen=True)
class Circuit:
    """A circuit with mutants as AND gates over free inputs and registers.

    Attributes:
        inputs: number of free variables, which are 1 to `inputs`; a literal is twice a variable, plus 1 for its inverse.
        registers: how many of them are registers, the last ones; the first so many `outputs` are their next values. All of
            them begin with 0; where Yosys knows no initial value, as behind a mutant, it adds an input for it.
        select: the variables of the mutant's number, the lowest bit first.
        gates: the two literals of each AND gate; gate n is variable `inputs` + 1 + n.
        outputs: the literals that are compared.
        folder: for files.
    """

    inputs: int
    registers: int
    select: tuple[int, ...]
    gates: Sequence[tuple[int, int]]
    outputs: Sequence[int]
    folder: Path

    def differs(self, number: int) -> bool:
        """Whether the mutant of this number may differ from the sound circuit."""
        made, still = _Gates(self.inputs), dict.fromkeys(self.still, 0)
        sound, faulty = (self._build(made, still | self._chosen(value)) for value in (0, number))
        different = {made.exclusive(a, b) for a, b in zip(sound, faulty, strict=True) if a != b}
        if not different or _never(made, different, {}, self.folder / "question.aig"):
            return False
        return not self._never_seen(number)

    def _never_seen(self, number: int) -> bool:
        """Whether ABC proves that no output of the mutant ever differs, from the initial values on. A register that the fault
        does not reach is there once, and the others twice. What comes out of memories is the same for both, because what goes
        into them is compared."""
        begin = self.inputs - self.registers + 1
        made, still = _Gates(self.inputs + self.registers), dict.fromkeys(self.still, 0)
        sound = self._build(made, still | self._chosen(0))
        faulty = self._build(made, still | self._chosen(number))
        first = {begin + n for n in range(self.registers) if sound[n] != faulty[n]}
        reached = {each: 2 * (each - begin + 1 + self.inputs) for each in self._behind(first)}  # literals of the second copies
        faulty = self._build(made, still | self._chosen(number) | reached)
        registers = {begin + n: sound[n] for n in range(self.registers)}
        registers |= {literal >> 1: faulty[variable - begin] for variable, literal in reached.items()}
        seen = {made.exclusive(a, b) for a, b in zip(sound[self.registers :], faulty[self.registers :], strict=True) if a != b}
        return _never(made, seen, registers, self.folder / "question.aig")

    def _behind(self, first: set[int]) -> set[int]:
        """These registers, and all that depend on them."""
        begin, seen = self.inputs - self.registers + 1, set(first)
        waiting = list(first)
        while waiting:
            for user in self._users.get(waiting.pop(), ()):
                if user not in seen:
                    seen.add(user)
                    waiting.append(user)
        return {each for each in seen if begin <= each <= self.inputs}

    @cached_property
    def _users(self) -> dict[int, list[int]]:
        """The gates that read a variable, and the registers whose next value it is."""
        found: dict[int, list[int]] = {}
        for gate, pair in enumerate(self.gates, self.inputs + 1):
            for literal in pair:
                found.setdefault(literal >> 1, []).append(gate)
        for n, literal in enumerate(self.outputs[: self.registers]):
            found.setdefault(literal >> 1, []).append(self.inputs - self.registers + 1 + n)
        return found

    def _chosen(self, number: int) -> dict[int, int]:
        return {variable: number >> bit & 1 for bit, variable in enumerate(self.select)}

    @cached_property
    def still(self) -> frozenset[int]:
        """The registers that are 0 for ever in the sound circuit, found by simulation with unknown inputs. While both circuits
        have been in the same states so far, they are 0 in the mutant as well."""
        begin = self.inputs - self.registers + 1
        moving: set[int] = set()
        while True:
            # Of each literal whether it may be 0 and may be 1
            known = [(True, False), *((True, True) for _ in range(self.inputs))]
            for variable in self._chosen(0):
                known[variable] = (True, False)
            for variable in range(begin, self.inputs + 1):
                known[variable] = (True, variable in moving)
            for a, b in self.gates:
                x, y = (known[each >> 1][:: -1 if each & 1 else 1] for each in (a, b))
                known.append((x[0] or y[0], x[1] and y[1]))
            found = {begin + n for n, literal in enumerate(self.outputs[: self.registers])
                     if known[literal >> 1][0 if literal & 1 else 1]}
            if found <= moving:
                return frozenset(range(begin, self.inputs + 1)) - moving
            moving |= found

    def _build(self, made: _Gates, constants: dict[int, int]) -> list[int]:
        literals = [0, *(constants.get(variable, 2 * variable) for variable in range(1, self.inputs + 1))]
        for a, b in self.gates:
            literals.append(made.both(literals[a >> 1] ^ a & 1, literals[b >> 1] ^ b & 1))
        return [literals[output >> 1] ^ output & 1 for output in self.outputs]


class _Gates:
    """AND gates, each pair of literals once. Constants are the literals 0 and 1."""

    def __init__(self, inputs: int):
        self.inputs = inputs
        self.pairs: list[tuple[int, int]] = []
        self._known: dict[tuple[int, int], int] = {}

    def both(self, a: int, b: int) -> int:
        """The literal of a AND b."""
        a, b = min(a, b), max(a, b)
        if a == 0 or a ^ b == 1:
            return 0
        if a == 1 or a == b:
            return b
        if (a, b) not in self._known:
            self.pairs.append((a, b))
            self._known[a, b] = 2 * (self.inputs + len(self.pairs))
        return self._known[a, b]

    def exclusive(self, a: int, b: int) -> int:
        """The literal of a XOR b."""
        return self.both(self.both(a, b) ^ 1, self.both(a ^ 1, b ^ 1) ^ 1)


def _never(made: _Gates, literals: Iterable[int], registers: Mapping[int, int], path: Path) -> bool:
    """Whether ABC proves that none of the literals is ever 1. `registers`: variables that begin with 0, and their next
    values; all other variables are free."""
    any_of = 0
    for literal in sorted(literals):
        any_of = made.both(any_of ^ 1, literal ^ 1) ^ 1
    cone = _cone(made, any_of >> 1, registers)
    latches = sorted(cone & registers.keys())
    free = sorted(variable for variable in cone - registers.keys() if variable <= made.inputs)
    gates = sorted(variable for variable in cone if variable > made.inputs)
    place = {variable: n + 1 for n, variable in enumerate((*free, *latches, *gates))}

    def written(literal: int) -> int:
        return 2 * place[literal >> 1] + (literal & 1) if literal > 1 else literal

    coded = b""
    for variable in gates:
        low, high = sorted(map(written, made.pairs[variable - made.inputs - 1]))
        coded += _delta(2 * place[variable] - high) + _delta(high - low)
    head = [f"aig {len(cone)} {len(free)} {len(latches)} 1 {len(gates)}", *(str(written(registers[each])) for each in latches),
            str(written(any_of))]
    path.write_bytes("".join(f"{line}\n" for line in head).encode() + coded)
    prove = "dprove" if latches else "iprove"
    try:
        run = subprocess.run(
            [str(find_abc()), "-c", f"read_aiger {path.name}; strash; {prove}"], capture_output=True, text=True,
            cwd=path.parent, timeout=SECONDS, check=False)
    except subprocess.TimeoutExpired:
        return False
    return any(words in run.stdout for words in ("UNSATISFIABLE", "Networks are equivalent"))


def _cone(made: _Gates, top: int, registers: Mapping[int, int]) -> set[int]:
    """The variables on which a variable depends, with itself, and those on which the registers among them do."""
    seen, waiting = set(), [top]
    while waiting:
        variable = waiting.pop()
        if variable and variable not in seen:
            seen.add(variable)
            if variable > made.inputs:
                waiting += [literal >> 1 for literal in made.pairs[variable - made.inputs - 1]]
            elif variable in registers:
                waiting.append(registers[variable] >> 1)
    return seen


def _delta(number: int) -> bytes:
    """A number as AIGER writes it: seven bits in a byte, the lowest first."""
    found = bytearray()
    while number >= 128:
        found.append(number & 127 | 128)
        number >>= 7
    return bytes([*found, number])


def circuit_of(mutants: Sequence[Mutant], module: str, folder: Path, verilog: str = "") -> Circuit:
    """The circuit with these mutants, of which `msv2.cases.mutants.mutate.draw` left `flat.il` in the folder. `verilog` has the
    modules that the circuit does not, whose instances are cut."""
    aiger, names = folder / "cut.aig", folder / "cut.map"
    boxes = sorted(set(re.findall(r"(?m)^  cell \\(\S+) ", (folder / "flat.il").read_text())))
    (folder / "boxes.v").write_text("".join(_module(verilog, box) for box in boxes))
    cut = "".join(f"expose -evert t:{box}\ndelete ={box}\n" for box in boxes)
    yosys(f"read_rtlil flat.il\nread_verilog -lib boxes.v\nhierarchy -top {module}\n{applied(mutants)}opt_clean\n{cut}"
          f"write_rtlil mutants.il\n", folder)
    (folder / "cut.il").write_text(without_memories((folder / "mutants.il").read_text()))
    yosys(f"read_rtlil cut.il\nhierarchy -top {module}\n{_PASSES}"
          f"write_aiger -zinit -no-sort -symbols -map {names.name} {aiger.name}\n", folder)
    select = {}
    for kind, place, *rest in map(str.split, names.read_text().splitlines()):
        if kind == "input" and rest[1].lstrip("\\") == SELECT:
            select[int(rest[0])] = int(place) + 1
    return _read(aiger, tuple(select[bit] for bit in sorted(select)), folder)


def _read(path: Path, select: tuple[int, ...], folder: Path) -> Circuit:
    """A binary AIGER file, with its latches cut."""
    data, at = path.read_bytes(), 0

    def line() -> str:
        nonlocal at
        end = data.index(b"\n", at)
        text, at = data[at:end].decode(), end + 1
        return text

    _, inputs, latches, outputs, ands = map(int, line().split()[1:6])
    lines = [int(line().split()[0]) for _ in range(latches + outputs)]

    def number() -> int:
        nonlocal at
        value = shift = 0
        while True:
            byte = data[at]
            at, value, shift = at + 1, value | (byte & 127) << shift, shift + 7
            if byte < 128:
                return value

    gates, first = [], inputs + latches
    for n in range(ands):
        high = 2 * (first + 1 + n) - number()
        gates.append((high, high - number()))
    return Circuit(first, latches, select, gates, lines, folder)


def _module(verilog: str, name: str) -> str:
    """A module of Verilog, by its name; ValueError where there is none."""
    found = re.search(rf"(?ms)^module {re.escape(name)}\b.*?^endmodule\n", verilog)
    if not found:
        raise ValueError(f"the module {name} is in the circuit, but not in the testbench's Verilog")
    return found[0]


def equal(mutants: Sequence[Mutant], module: str, folder: Path, verilog: str = "") -> set[int]:
    """The numbers of those of the mutants that compute what the sound circuit does; for the arguments see `circuit_of`."""
    if not mutants:
        return set()
    circuit = circuit_of(mutants, module, folder, verilog)
    return {mutant.number for mutant in mutants if not circuit.differs(mutant.number)}
