"""What Verilator's -Wall is told not to warn of in exported Verilog, and why each rule does not apply there."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Waiver:
    """A rule of Verilator that the exported logic does not follow.

    Attributes:
        rule: its name.
        reason: why what it warns of is right.
        only: messages that are meant, a pattern with `*`; empty for all of the rule.
    """

    rule: str
    reason: str
    only: str = ""


WAIVERS = (
    Waiver("PROCASSINIT", "Registers have initial values, which simulators and FPGAs load. They are those of the reset; data "
           "registers without a reset hold what counts only beside a valid bit, which has one."),
    Waiver("UNUSEDSIGNAL", "Carries that are cut off, and fields of a record that a unit passes by, have no reader; synthesis "
           "drops them."),
    Waiver("WIDTHEXPAND", "Yosys writes operands with their own widths and leaves it to Verilog's rules to extend them, "
           "with the sign where they are $signed."),
    Waiver("WIDTHTRUNC", "A comparison with 0 is written as a logical negation of all bits.",
           "Logical operator LOGNOT expects 1 bit*"),
    Waiver("WIDTHTRUNC", "A selection of one of several fields is written as a shift whose upper bits are dropped.",
           "*ASSIGNW expects * bits on the Assign RHS, but Assign RHS's SHIFTR generates *"),
    Waiver("CASEOVERLAP", "A selection by one-hot signals is written as a casez with parallel_case: its conditions overlap "
           "only where two of these signals are high, which they never are."),
    Waiver("VARHIDDEN", "The functions of such selections name their arguments a, b and s, as ports may be named."),
    Waiver("UNOPTFLAT", "Bits of a vector are assigned from other bits of the same vector; no bit depends on itself, as "
           "Amaranth checks bit by bit when it makes the netlist."),
    Waiver("UNSIGNED", "A row of comparisons with 0, 1, 2 and so on has one that is constant at its begin."),
    Waiver("CMPCONST", "A row of comparisons with 0, 1, 2 and so on has one that is constant at its end."),
    Waiver("SYMRSVDWORD", "Ports may have names that are words of C++; Verilator renames them in its own code."),
)
"""All that is waived. Memories, which are not written by Yosys, need no waiver."""


def control_file(modules: list[str]) -> str:
    """Verilator's control file (`.vlt`) for the files of these modules."""
    lines = ["// Waivers for Verilator's -Wall in logic that Yosys has written, each with its reason.", "`verilator_config"]
    for waiver in WAIVERS:
        only = f' -match "{waiver.only}"' if waiver.only else ""
        lines += ["", f"// {waiver.reason}", *(f'lint_off -rule {waiver.rule} -file "*{name}.v"{only}' for name in modules)]
    return "\n".join(lines) + "\n"
