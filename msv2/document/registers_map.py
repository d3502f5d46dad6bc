"""What all documents of the registers share: the machine that they describe, groups of registers, what enumerations mean."""

from __future__ import annotations

import inspect
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise

from msv2.document.text import attribute_docs
from spec import register_fields, registers
from spec.codes import Code
from spec.config import PAPER, AcceleratorConfig
from spec.host_settings import with_every_register
from spec.register_fields import Register

EVERY_MACHINE, SUPERTILE_MACHINE, JOINT_MACHINE, WARP_MACHINE = with_every_register(PAPER)
"""The machines of the documents in docs/, which describe the first and what the others have besides. Together they have all
registers; those that not all machines have are marked."""

GROUPS = {
    "Identity": 0, "Control": register_fields.CONTROL_BASE, "Settings": registers.SETTINGS_BASE,
    "Counters": registers.COUNTERS_BASE, "": 1 << registers.REGISTER_ADDRESS_BITS}
"""Headings and the first address of each."""

_SUPERTILE = {register.name: register for machine in (WARP_MACHINE, JOINT_MACHINE, SUPERTILE_MACHINE)
              for register in registers.register_map(machine)}

_ADDED = {
    register.name: f" (only with {what})"
    for what, machine in (("joint frames with a warped eye", WARP_MACHINE), ("joint frames", JOINT_MACHINE),
                          ("overlapped phases", SUPERTILE_MACHINE),
                          ("packed frames", SUPERTILE_MACHINE.with_(overlap=False)),
                          ("super-tiles", JOINT_MACHINE.with_(joint=False)),
                          ("chunks", PAPER.with_(order="spatial", chunks=True)), ("stereo", PAPER.with_(stereo=True)))
    for register in registers.register_map(machine)} | {
        register.name: " (only with stereo or joint frames)" for register in registers.register_map(JOINT_MACHINE)
        if register.name.startswith("target_")} | {
        register.name: "" if register.name in _SUPERTILE else " (not with super-tiles)"
        for register in registers.register_map(PAPER)}
"""What the documents say behind a register, by its name."""


def register_list(config: AcceleratorConfig) -> tuple[Register, ...]:
    """Every register of a machine, by ascending address; EVERY_MACHINE's say which machines have them if not all do."""
    everything = registers.register_map(config)
    if config != EVERY_MACHINE:
        return everything
    every = _SUPERTILE | {r.name: r for r in everything}
    return tuple(replace(r, doc=r.doc + _ADDED[r.name]) for r in sorted(every.values(), key=lambda r: r.offset))


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
