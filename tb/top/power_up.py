"""Machines whose registers and memories begin with random bits, as those of a chip do.

Verilog says what a register begins with, and simulators obey. A chip has only its reset. So initial values are removed here,
and a frame that depends on one fails. The watchdog of these machines is short, so that a simulation can wait for it.
"""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache

from rtl.emit import to_rtlil, verilog_of
from rtl.top import machine as rtl_machine
from spec.config import AcceleratorConfig
from tb.common.emission import emitted
from tb.top.device import MODULE, Machine, machine

WATCHDOG = 14
"""log2 of the cycles for which the watchdog waits."""

_VALUES = re.compile(r"^\s*attribute \\init [^\n]*\n|^\s*cell \$meminit(?:_v2)? .*?^\s*end\n", re.MULTILINE | re.DOTALL)
"""Statements of RTLIL that say what a register or a memory begins with."""


def without_initial_values(rtlil: str) -> str:
    """Verilog in which no register and no memory that can be written has an initial value."""
    return verilog_of(_VALUES.sub("", rtlil))


def _emit(config: AcceleratorConfig) -> str:
    return without_initial_values(to_rtlil(rtl_machine.Machine(config, watchdog_bits=WATCHDOG), MODULE))


@cache
def powered_up(config: AcceleratorConfig) -> Machine:
    """The machine of a configuration without initial values, and with a short watchdog. `play_frames(..., start=seed)` chooses
    its random bits."""
    usual, name = machine(config), f"{MODULE}-power-up-{WATCHDOG}"
    return replace(usual, name=f"{usual.name}-power-up", verilog=emitted(name, config, _emit), unknown=True)
