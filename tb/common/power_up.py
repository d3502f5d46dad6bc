"""Verilog as a chip sees it when its power comes on: registers and memories hold anything.

Yosys writes the initial values that Amaranth gives to every register, and a simulation would begin with them. A chip does not.
"""

from __future__ import annotations

import re

_REGISTER = re.compile(r"(?m)^(\s*(?:output\s+)?reg\b[^=;\n]*?)\s*=\s*[^;\n]+;")
"""A blank stays before the semicolon, which would otherwise belong to a name with a backslash."""

_INITIAL = re.compile(r"(?m)^  initial begin\n(?P<body>(?:    .*\n)*?)  end\n")
_WORD = re.compile(r"^\s*(\S+?)\s*\[")


def without_initial_values(verilog: str) -> str:
    """Verilog, as Yosys writes it, without initial values of registers, nor of memories that are written. Memories that are
    only read are tables and keep their contents."""
    modules = re.split(r"(?m)^(?=module )", verilog)
    return "".join(_forget(module) for module in modules)


def _forget(module: str) -> str:
    def kept(block: re.Match[str]) -> str:
        name = _WORD.match(block["body"])
        written = name is None or re.search(rf"(?m)^\s*(?:if .*\n?\s*)?{re.escape(name[1])}\s*\[.*<=", module)
        return "" if written else block[0]

    return _INITIAL.sub(kept, _REGISTER.sub(r"\1 ;", module))


def arguments(seed: int) -> tuple[str, ...]:
    """Arguments of a simulation in which registers begin with random values of this seed, 1 or more; its design must be built
    with `power_up`."""
    if seed < 1:
        raise ValueError(f"seed must be 1 or more, not {seed!r}: 0 is Verilator's word for another seed in every run")
    return "+verilator+rand+reset+2", f"+verilator+seed+{seed}"
