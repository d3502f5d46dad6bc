"""Capacitance limits through several modules: loads and drivers of ports, assignments, clocks."""

from __future__ import annotations

from pathlib import Path

from synth.loads import Overload, overloads, pins_of
from synth.netlist import Instance, Netlist
from tests.helpers.small_machine import LIBERTY

INNER = Netlist(
    "inner", {"clk": ("input", 1), "a": ("input", 2), "y": ("output", 2)}, {"a": 2, "y": 2},
    [Instance("g0", "BUF", {"A": ("a[0]",), "Y": ("n",)}), Instance("g1", "BUF", {"A": ("a[0]",), "Y": ("y[1]",)}),
     Instance("f", "DFF", {"CLK": ("clk",), "D": ("n",), "Q": ("q",)})],
    [("y[0]", "n")])


def _top(sinks: int) -> Netlist:
    cells = [Instance(f"s{i}", "INV", {"A": ("w",), "Y": (f"v{i}",)}) for i in range(sinks)]
    return Netlist("top", {"clk": ("input", 1), "go": ("input", 1)}, {"m": 2}, [
        Instance("u", "inner", {"clk": ("clk",), "a": ("go", "0"), "y": ("m[0]", "m[1]")}),
        Instance("v", "inner", {"clk": ("clk",), "a": ("w", "w"), "y": ()}), *cells], [("w", "m[0]")])


def test_loads_are_counted_through_modules(tmp_path: Path) -> None:
    """The buffer g0 of `u` drives the register inside (1 fF), both buffers behind `a` of `v` (2 fF), and the inverters."""
    path = tmp_path / "small.lib"
    path.write_text(LIBERTY)
    cells = pins_of(path)
    assert cells["DFF"].inputs == {"D": 1.0} and cells["BUF"].outputs == {"Y": 100.0}
    assert overloads([INNER, _top(97)], cells) == []
    assert overloads([INNER, _top(98)], cells) == [Overload("top", "m[0]", 101.0, 100.0)]


def test_a_net_that_stays_inside_is_named_there(tmp_path: Path) -> None:
    path = tmp_path / "small.lib"
    path.write_text(LIBERTY.replace("max_capacitance : 100", "max_capacitance : 0.5"))
    alone = Netlist("alone", {"clk": ("input", 1)}, {}, [
        Instance("f", "DFF", {"CLK": ("clk",), "D": ("y",), "Q": ("q",)}), Instance("g", "BUF", {"A": ("q",), "Y": ("y",)})])
    assert [(one.module, one.net) for one in overloads([alone], pins_of(path))] == [("alone", "q"), ("alone", "y")]
