"""Names that need no escape in Verilog, the same in every run.

Amaranth calls a submodule `msv2_top.render.fetch`, a field of a record `row.pixels[0]`, and two signals of one name `beta`
and `beta$34`. In the export these become `PREFIXmsv2_top_render_fetch`, `row_pixels_0` and `beta_34`.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

from msv2.verilog.rtlil import Cell, Module, renamed

KEYWORDS = frozenset("""
    accept_on alias always always_comb always_ff always_latch and assert assign assume automatic before begin bind bins
    binsof bit break buf bufif0 bufif1 byte case casex casez cell chandle checker class clocking cmos config const
    constraint context continue cover covergroup coverpoint cross deassign default defparam design disable dist do edge
    else end endcase endchecker endclass endclocking endconfig endfunction endgenerate endgroup endinterface endmodule
    endpackage endprimitive endprogram endproperty endsequence endspecify endtable endtask enum event eventually expect
    export extends extern final first_match for force foreach forever fork forkjoin function generate genvar global
    highz0 highz1 if iff ifnone ignore_bins illegal_bins implements implies import incdir include initial inout input
    inside instance int integer interconnect interface intersect join join_any join_none large let liblist library local
    localparam logic longint macromodule matches medium modport module nand negedge nettype new nexttime nmos nor
    noshowcancelled not notif0 notif1 null or output package packed parameter pmos posedge primitive priority program
    property protected pull0 pull1 pulldown pullup pulsestyle_ondetect pulsestyle_onevent pure rand randc randcase
    randsequence rcmos real realtime ref reg reject_on release repeat restrict return rnmos rpmos rtran rtranif0
    rtranif1 s_always s_eventually s_nexttime s_until s_until_with scalared sequence shortint shortreal showcancelled
    signed small soft solve specify specparam static string strong strong0 strong1 struct super supply0 supply1
    sync_accept_on sync_reject_on table tagged task this throughout time timeprecision timeunit tran tranif0 tranif1 tri
    tri0 tri1 triand trior trireg type typedef union unique unique0 unsigned until until_with untyped use uwire var
    vectored virtual void wait wait_order wand weak weak0 weak1 while wildcard wire with within wor xnor xor
""".split())
"""Words of SystemVerilog (IEEE 1800-2017), which no name may be."""

_CELL_NUMBERS = re.compile(r"port\$\d+\$\d+")


def plain(name: str) -> str:
    """A public RTLIL name as a Verilog identifier, not yet unique."""
    if _CELL_NUMBERS.fullmatch(name[1:]):  # numbered over the whole design: any change of it would rename the port
        return "port"
    text = re.sub(r"[^A-Za-z0-9_]+", "_", name[1:]).strip("_") or "unnamed"
    return f"n{text}" if text[0].isdigit() else f"{text}_" if text in KEYWORDS else text


def unique(names: Iterable[str], taken: Iterable[str] = ()) -> dict[str, str]:
    """An identifier for every RTLIL name, in order; those that are identifiers already keep their names."""
    names, used = list(names), set(taken)
    found = {name: name[1:] for name in names if plain(name) == name[1:] and name[1:] not in used}
    used |= set(found.values())
    for name in names:
        if name in found:
            continue
        wanted, number = plain(name), 2
        candidate = wanted
        while candidate in used:
            candidate, number = f"{wanted}_{number}", number + 1
        found[name] = candidate
        used.add(candidate)
    return {name: f"\\{identifier}" for name, identifier in found.items()}


def public_names(module: Module) -> list[str]:
    """Wires, memories and instances of a module, in order."""
    found = []
    for item in module.items:
        if isinstance(item, Cell):
            found.append(item.name)
        elif isinstance(item, str) and item.startswith(("  wire ", "  memory ")):
            found.append(item.split()[-1])
    return [name for name in found if name.startswith("\\")]


def rename(modules: list[Module], prefix: str) -> tuple[dict[str, str], dict[str, dict[str, str]]]:
    """Gives every module, in place, a prefixed name and all that is in it identifiers.

    Returns the new names of modules by their old ones, and by module the new names of what is in it.

    """
    of_modules = {old: f"\\{prefix}{new[1:]}" for old, new in unique(module.name for module in modules).items()}
    inside = {module.name: unique([name for name, *_ in module.ports()] + public_names(module)) for module in modules}
    for module in modules:
        names = inside[module.name]
        for place, item in enumerate(module.items):
            if isinstance(item, Cell):
                module.items[place] = _renamed_cell(item, names, inside.get(item.kind), of_modules)
            elif isinstance(item, str):
                module.items[place] = _renamed_line(item, names)
            else:
                module.items[place] = [_renamed_line(line, names) for line in item]
    for module in modules:
        module.name = of_modules[module.name]
    return of_modules, inside


def _renamed_line(line: str, names: dict[str, str]) -> str:
    return line if line.lstrip().startswith("attribute ") else renamed(line, names)


def _renamed_cell(cell: Cell, names: dict[str, str], ports: dict[str, str] | None, of_modules: dict[str, str]) -> Cell:
    lines = []
    for line in cell.lines:
        if not line.startswith("    connect "):
            lines.append(line)
            continue
        _, pin, signal = line.strip().split(" ", 2)
        lines.append(f"    connect {ports[pin] if ports else pin} {renamed(signal, names)}")
    return Cell(of_modules.get(cell.kind, cell.kind), names.get(cell.name, cell.name), lines)
