"""Converts components to Verilog, with one module per distinct component, however often it is instantiated.

Amaranth emits a module for every instance of a submodule, so an array of 256 equal cores would become 256 modules. `add_shared`
adds a submodule that is emitted once and instantiated by name. In Amaranth's own simulator it is an ordinary submodule.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Hashable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from typing import Any

from amaranth._toolchain.yosys import find_yosys
from amaranth.back import rtlil
from amaranth.hdl import ClockSignal, Instance, Module, ResetSignal, Value
from amaranth.lib import wiring

_kept: ContextVar[dict[str, str] | None] = ContextVar("kept", default=None)
_in_verilog: ContextVar[bool] = ContextVar("in_verilog", default=False)


@contextmanager
def keeping_sources(*, in_verilog: bool = False) -> Iterator[dict[str, str]]:
    """While it is open, RTLIL names in its attributes `src` the lines of Python that made it. Every text of `to_rtlil` is put
    into the dictionary, by the name of the top module. Verilog stays as it is, without attributes, unless `in_verilog`."""
    texts: dict[str, str] = {}
    tokens = _kept.set(texts), _in_verilog.set(in_verilog)
    try:
        yield texts
    finally:
        _kept.reset(tokens[0])
        _in_verilog.reset(tokens[1])


def sources_are_kept() -> bool:
    """Whether `keeping_sources` is open."""
    return _kept.get() is not None


class Emission:
    """The `platform` argument of elaboration during one emission. It collects the RTLIL of shared modules by name."""

    def __init__(self) -> None:
        self.modules: dict[str, str] = {}
        self._made_by: dict[str, tuple[object, ...]] = {}
        self._signatures: dict[str, wiring.Signature] = {}

    def instance(self, name: str, make: Callable[..., wiring.Component], *args: Hashable) -> tuple[Any, Instance]:
        """An interface object, and the Instance of module `name` that is wired to it. The first call for a name emits the
        module.

        Raises ValueError where one name is used with two different components.
        """
        if self._made_by.setdefault(name, (make, *args)) != (make, *args):
            raise ValueError(f"{name} must be one module in an emission, {self._made_by[name]!r}, not {(make, *args)!r}")
        if name not in self.modules:
            component = make(*args)
            self.modules[name] = rtlil.convert(component, name=name, platform=self, emit_src=sources_are_kept())
            self._signatures[name] = component.signature
        interface = self._signatures[name].create()
        wires = {
            f"{'i' if member.flow == wiring.In else 'o'}_{'__'.join(map(str, path))}": Value.cast(value)
            for path, member, value in self._signatures[name].flatten(interface)
        }
        return interface, Instance(name, i_clk=ClockSignal(), i_rst=ResetSignal(), **wires)


def add_shared(
    m: Module, platform: object, label: str, name: str, make: Callable[..., wiring.Component], *args: Hashable,
) -> Any:
    """Adds the clocked submodule `label` = make(*args) to `m`; it is emitted once, as module `name`. Returns an object with its
    ports.

    Raises ValueError where one name is used with two sets of arguments in one emission.
    """
    if isinstance(platform, Emission):
        interface, m.submodules[label] = platform.instance(name, make, *args)
        return interface
    m.submodules[label] = component = make(*args)
    return component


def to_rtlil(component: wiring.Component, name: str) -> str:
    """RTLIL of a component, as module `name`, and of the shared modules below it. The text is deterministic."""
    emission, kept = Emission(), _kept.get()
    top = rtlil.convert(component, name=name, platform=emission, emit_src=kept is not None)
    text = "\n".join([*emission.modules.values(), top])
    if kept is not None:
        kept[name] = text
    return text


def to_verilog(component: wiring.Component, name: str) -> str:
    """Verilog-2001 of a component, as module `name`, and of the shared modules below it. The text is deterministic."""
    return verilog_of(to_rtlil(component, name))


def verilog_of(text: str, clean: str = "opt_clean") -> str:
    """Verilog-2001 of RTLIL, written by Yosys after `proc` and the pass `clean`.

    `proc` comes first because Amaranth's own `always @*` blocks leave signals X at time 0 in some simulators. Names of Yosys'
    own are written as `_12_`: as `\\$12` they would need an escape, and Icarus takes the name of a function that begins with
    a dollar sign for a system function even so.
    """
    plain = "" if _in_verilog.get() else " -noattr"
    script = f"read_rtlil <<rtlil\n{text}\nrtlil\nproc\n{clean}\nwrite_verilog{plain}\n"
    found = find_yosys(lambda version: version >= (0, 40)).run(["-q", "-"], script)
    return re.split(r"(?m)^(?=module |\(\*)", found, maxsplit=1)[1]  # without Yosys' version line
