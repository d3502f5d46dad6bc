"""What all documents of the registers share: the machine that they describe, groups of registers, what enumerations mean."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

from msv2.document.text import attribute_docs
from spec import registers
from spec.config import PAPER, AcceleratorConfig
from spec.registers import Code, Register

EVERY_MACHINE = PAPER.with_(stereo=True)
"""The machine of the documents in docs/: it has all registers, and those that not all machines have are marked."""

GROUPS = {
    "Identity": 0, "Control": registers.CONTROL_BASE, "Settings": registers.SETTINGS_BASE,
    "Counters": registers.COUNTERS_BASE, "": 1 << registers.REGISTER_ADDRESS_BITS}
"""Headings and the first address of each."""

_COMMON = {register.name for register in registers.register_map(PAPER)}


def register_list(config: AcceleratorConfig) -> tuple[Register, ...]:
    """Every register of a machine, by ascending address; EVERY_MACHINE's say where only machines with stereo have them."""
    everything = registers.register_map(config)
    if config != EVERY_MACHINE:
        return everything
    return tuple(r if r.name in _COMMON else replace(r, doc=f"{r.doc} (only with stereo)") for r in everything)


def grouped(config: AcceleratorConfig) -> Iterator[tuple[str, list[Register]]]:
    """Registers under their headings."""
    everything = register_list(config)
    for (name, low), (_, high) in pairwise(GROUPS.items()):
        yield name, [register for register in everything if low <= register.offset < high]


def enum_docs(values: type[Code]) -> list[tuple[Code, str]]:
    """The values of an enumeration and what each means."""
    docs = attribute_docs(inspect.getsource(values))
    return [(value, docs[value.name]) for value in values]


def words_of(register: Register) -> str:
    """What a register holds, on one line, with how the host turns its value into a number."""
    scale = f": {registers.scale_words(register.format)}" if register.format else ""
    return " ".join(f"{register.doc}{scale}".split())
