"""What a mapped module does at its ports: when outputs arrive, when inputs are needed, and how long ways through it take.

    interface_of("msv2_top__geometry", design, parts, TYPICAL, folder)

These are the numbers of a unit that the budget rule adds up (`synth.budget`). OpenSTA finds them for one module at a time,
without the units inside it: their pins become ports of the module around them. So a frame, which holds little but units and the
nets between them, is a module like any other, and what it connects is in its ways through.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

from synth import timing
from synth.corners import INPUT_SLEW_PS, Corner
from synth.design import Design
from synth.linked import memory_cells, with_memories
from synth.machine import UNIT_GROUPS, UNTIMED, label
from synth.macro_timing import liberty
from synth.netlist import Instance, Netlist, parse
from synth.once import run_once
from synth.report import write_text

IDEAL = ("clk", "rst")
"""Ports of which nothing is timed: the clock, and the reset, which is no path (`synth.timing`)."""

ESCAPE = "\\"
"""The character before a name that is not a plain one."""

_LONG_PS = 1e5
"""The clock during the measurement, far longer than any way."""


@dataclass(frozen=True)
class Interface:
    """The timing of a module at its ports, in whole ps. A port `inner.port` is the pin of the module `inner` inside it.

    Attributes:
        source: a hash of the RTL that it was measured on (`source_hash`).
        inside: the longest time between its own registers and memories.
        below: the modules inside it that have interfaces of their own: their kinds by instance.
        arrives: by output, the time from the clock to the output.
        needed: by input, the time from the input to the next edge, with setup.
        through: by input and output, the time from one to the other.
    """

    source: str
    inside: int = 0
    below: dict[str, str] = field(default_factory=dict)
    arrives: dict[str, int] = field(default_factory=dict)
    needed: dict[str, int] = field(default_factory=dict)
    through: dict[str, dict[str, int]] = field(default_factory=dict)

    def as_json(self) -> dict[str, object]:
        """The interface as a dictionary, with its keys in order."""
        return asdict(self)


def source_hash(design: Design, name: str) -> str:
    """16 hexadecimal digits of the RTL that an interface is measured on: the module, and all modules inside it down to those
    that have interfaces of their own, of which the ports count alone."""
    return hashlib.sha256("\n".join(design.source(module) for module in measured(design, name)).encode()).hexdigest()[:16]


def interfaced(design: Design) -> dict[str, list[str]]:
    """The modules that have interfaces, lower ones first, with the kinds inside each that have interfaces, too.

    They are the units, and whatever stands directly in a unit that is too large to be timed whole (the rows of the array).
    """
    units = {label(unit) for unit in UNIT_GROUPS}
    large = {label(unit) for unit in UNTIMED}
    wanted = (units & set(design.texts)) | {kind for name in large & set(design.texts) for kind in design.below[name]}
    return {name: [kind for kind in design.below[name] if kind in wanted] for name in design.texts if name in wanted}


def without(netlist: Netlist, ports: Mapping[str, Mapping[str, tuple[str, int]]]) -> tuple[str, dict[str, str], dict[str, str]]:
    """The netlist without the instances of some modules, whose pins become ports.

    Args:
        netlist: the module.
        ports: the ports of these modules, by kind.

    Returns:
        the netlist as text; the instances' names and kinds; and for each new port what it is called in an `Interface`.
    """
    inner = [instance for instance in netlist.instances if instance.kind in ports]
    names: dict[str, str] = {}
    declared: list[str] = [_declared(direction, name, width) for name, (direction, width) in netlist.ports.items()]
    assigns = [f"  assign {left} = {_bit(right)};\n" for left, right in netlist.assigns]
    for k, instance in enumerate(inner):
        for pin, bits in instance.pins.items():
            if pin in IDEAL or not bits:
                continue
            plain = pin.lstrip(ESCAPE)
            direction, width = ports[instance.kind][plain]
            port = f"inner{k}_{re.sub(r'[^A-Za-z0-9_]', '_', plain)}"
            names[port] = f"{instance.name.lstrip(ESCAPE)}.{plain}"
            declared.append(_declared({"input": "output", "output": "input"}[direction], port, width))
            for i, bit in enumerate(bits):
                place = f"{port}[{i}]" if width > 1 else port
                if direction == "input" and bit != "x":
                    assigns.append(f"  assign {place} = {_bit(bit)};\n")
                elif direction == "output":
                    assigns.append(f"  assign {bit} = {place};\n")
    wires = [f"  wire [{width - 1}:0] {name};\n" for name, width in netlist.widths.items() if name not in netlist.ports]
    listed = ", ".join([*netlist.ports, *names])
    cells = [_written(instance) for instance in netlist.instances if instance.kind not in ports]
    text = "".join([f"module {netlist.name}({listed});\n", *declared, *wires, *assigns, *cells, "endmodule\n"])
    return text, {instance.name.lstrip(ESCAPE): instance.kind for instance in inner}, names


def _bit(bit: str) -> str:
    return {"0": "1'b0", "1": "1'b1", "x": "1'b0"}.get(bit, bit)


def _declared(direction: str, name: str, width: int) -> str:
    return f"  {direction} {f'[{width - 1}:0] ' if width > 1 else ''}{name};\n"


def _written(instance: Instance) -> str:
    pins = ", ".join(f".{pin}({_joined(bits)})" for pin, bits in instance.pins.items())
    name = f"{instance.name} " if instance.name.startswith("\\") else instance.name
    return f"  {instance.kind} {name} ({pins});\n"


def _joined(bits: tuple[str, ...]) -> str:
    named = [_bit(bit) for bit in reversed(bits)]
    return named[0] if len(named) == 1 else f"{{{', '.join(named)}}}"


MEASURE = """\
proc report_to {label paths} {
  foreach path $paths {
    set end [get_property [get_property $path endpoint] full_name]
    puts "ARC $label $end [get_property $path slack]"
  }
}
"""


def script(
    verilog: list[Path], top: str, inputs: list[str], corner: Corner, liberties: list[Path],
) -> str:
    """Commands that print `ARC from to slack` for the module's ways from the clock, to the clock, and from port to port.

    `from` is `-` for the clock. An end that is no port is a register or a memory.
    """
    unit, cell = corner.technology.time_unit_ps, corner.technology.driver
    clock, slew = _LONG_PS / unit, INPUT_SLEW_PS / unit
    ports = " ".join(port if re.fullmatch(r"\w+", port) else f"{{{port}}}" for port in inputs)
    return "\n".join([
        *(f"read_liberty {path}" for path in liberties), *(f"read_verilog {path}" for path in verilog), f"link_design {top}",
        "if {[llength [get_ports -quiet clk]]} { " f"create_clock -name clk -period {clock} [get_ports clk]; "
        f"set_clock_transition {timing.CLOCK_TRANSITION * 1000.0 / unit} [get_clocks clk] }} "
        f"else {{ create_clock -name clk -period {clock} }}",
        f"create_clock -name before -period {clock}", f"create_clock -name after -period {clock}",
        f"foreach p {{{ports}}} {{ set_input_delay 0 -clock before [get_ports $p]; set_driving_cell -lib_cell {cell[0]} "
        f"-pin {cell[1]} -input_transition_rise {slew} -input_transition_fall {slew} [get_ports $p] }}",
        "set_output_delay 0 -clock after [all_outputs]", f"set_load {corner.technology.load} [all_outputs]",
        MEASURE,
        "report_to - [find_timing_paths -from [get_clocks clk] -to [get_clocks clk] -group_count 1]",
        "report_to - [find_timing_paths -from [get_clocks clk] -to [get_clocks after] -group_count 100000]",
        f"foreach p {{{ports}}} {{",
        "  report_to $p [find_timing_paths -from [get_ports $p] -to [get_clocks clk] -group_count 1]",
        "  report_to $p [find_timing_paths -from [get_ports $p] -to [get_clocks after] -group_count 100000]",
        "}",
    ]) + "\n"


def arcs(
    output: str, names: Mapping[str, str], ports: Mapping[str, tuple[str, int]], unit_ps: float,
) -> Iterator[tuple[str, str, int]]:
    """The ways in what `script` prints, as start, end and ps; the clock is "" as a start or an end.

    `names`: what new ports are called; `ports`: the ports of the netlist that was measured.
    """
    for start, end, slack in re.findall(r"(?m)^ARC (\S+) (\S+) (\S+)$", output):
        port = re.sub(r"\[\d+\]$", "", end)
        finish = names.get(port, port) if "/" not in end and port in ports else ""
        yield "" if start == "-" else names.get(start, start), finish, round(_LONG_PS - float(slack) * unit_ps)


def interface_of(
    name: str, design: Design, parts: Mapping[str, dict], corner: Corner, folder: Path,
) -> Interface:
    """The interface of a module of the design, measured by OpenSTA; what it reads and says stays in `folder`.

    `parts`: the `module_result` of each module that is measured with it (`measured`).
    """
    folder.mkdir(parents=True, exist_ok=True)
    kinds, cells, texts = interfaced(design)[name], {}, {}
    for module in measured(design, name):
        text = Path(parts[module]["netlist"]).read_text()
        memories = memory_cells(parts[module]["stores"], text)
        cells |= {cell.name: cell for cell in memories.values()}
        texts[module] = with_memories(text, memories)
    outer = {kind: rtl_ports(design.texts[kind], kind) for kind in kinds}
    texts[name], below, names = without(parse(texts[name]), outer)
    for module, text in texts.items():
        write_text(folder / f"{module}.v", text)
    library = folder / f"{name}.lib"
    write_text(library, liberty(list(cells.values()), corner.memory_factor))
    ports = ports_of(texts[name])
    inputs = [port for port, (direction, _) in ports.items() if direction == "input" and port not in IDEAL]
    netlists, liberties = [folder / f"{module}.v" for module in texts], [corner.liberty(folder.parent), library]
    output = run_once(script(netlists, name, inputs, corner, liberties), [*liberties, *netlists], folder, name)
    return collect(source_hash(design, name), below, arcs(output, names, ports, corner.technology.time_unit_ps))


def collect(source: str, below: dict[str, str], found: Iterable[tuple[str, str, int]]) -> Interface:
    """The interface with these ways (`arcs`); of several between the same ports, the longest counts."""
    inside, arrives, needed, through = 0, {}, {}, {}
    for start, end, time in found:
        if start and end:
            into = through.setdefault(start, {})
            into[end] = max(time, into.get(end, 0))
        elif end:
            arrives[end] = max(time, arrives.get(end, 0))
        elif start:
            needed[start] = max(time, needed.get(start, 0))
        else:
            inside = max(inside, time)
    return Interface(source, inside, below, arrives, needed, through)


def measured(design: Design, name: str) -> list[str]:
    """A module that has an interface, and the modules inside it at any depth, except those that have interfaces of their own,
    lower ones first."""
    cut, wanted = set(interfaced(design)[name]), {name}
    for module in reversed(design.texts):
        if module in wanted:
            wanted |= {kind for kind in design.below[module] if module != name or kind not in cut}
    return [module for module in design.texts if module in wanted]


def rtl_ports(text: str, name: str) -> dict[str, tuple[str, int]]:
    """Direction and width of the ports of module `name` in RTLIL, by their names without escapes."""
    body = text[text.index(f"module \\{name}\n"):]
    found = re.findall(r"(?m)^\s*wire (?:width (\d+) )?(?:signed )?(input|output) \d+\s+(?:signed )?\\(\S+)$",
                       body[:body.index("\nend\n")])
    return {port: (direction, int(width or 1)) for width, direction, port in found}


def ports_of(text: str) -> dict[str, tuple[str, int]]:
    """Direction and width of the ports of a netlist's module, by their names without escapes."""
    found = re.findall(r"(?m)^  (input|output) (?:\[(\d+):0\] )?(\\\S+ |[A-Za-z_][\w$]*) ?;$", text)
    return {name.strip().lstrip(ESCAPE): (direction, int(high or 0) + 1) for direction, high, name in found}
