"""Cells that have much to drive get a larger size, by netlists of a few cells."""

from __future__ import annotations

from synth.loads import Pins
from synth.sizing import resize, sizes

INVERTER = Pins({"A": 0.5}, {"Y": 46.0})
CELLS = {
    "INVx1_R": INVERTER, "INVx2_R": INVERTER, "INVx4_R": INVERTER, "NAND2x1_R": Pins({"A": 1.0, "B": 1.0}, {"Y": 46.0}),
    "NAND2x1p5_R": Pins({"A": 1.5, "B": 1.5}, {"Y": 70.0}), "FLOP_R": Pins({"D": 6.0}, {"Q": 46.0})}


def _cell(kind: str, inputs: dict[str, list[int]], outputs: dict[str, list[int]]) -> dict:
    directions = dict.fromkeys(inputs, "input") | dict.fromkeys(outputs, "output")
    return {"type": kind, "port_directions": directions, "connections": inputs | outputs}


def _module(flops: int, boxes: int = 0, kind: str = "INVx1_R") -> dict:
    """An inverter that drives flip-flops and black boxes, and an output of the module behind another one."""
    cells = {"driver": _cell(kind, {"A": [2]}, {"Y": [3]}), "last": _cell("INVx1_R", {"A": [3]}, {"Y": [4]})}
    cells |= {f"flop{i}": _cell("FLOP_R", {"D": [3]}, {"Q": [10 + i]}) for i in range(flops)}
    cells |= {f"box{i}": _cell("core", {"x": [3]}, {}) for i in range(boxes)}
    return {"ports": {"a": {"direction": "input", "bits": [2]}, "y": {"direction": "output", "bits": [4]}}, "cells": cells}


def test_sizes_are_of_one_function() -> None:
    assert sizes(CELLS) == {
        **{key: [(1.0, "INVx1_R"), (2.0, "INVx2_R"), (4.0, "INVx4_R")] for key in ("INVx1_R", "INVx2_R", "INVx4_R")},
        **{key: [(1.0, "NAND2x1_R"), (1.5, "NAND2x1p5_R")] for key in ("NAND2x1_R", "NAND2x1p5_R")}}


def test_the_smallest_size_that_is_large_enough_is_taken() -> None:
    """Two flip-flops and an inverter load with 12.5 fF, which size 2 may drive at 8 fF for each unit of drive."""
    module = _module(2)
    assert resize(module, CELLS, 8.0, 2.0) == 1
    assert [module["cells"][name]["type"] for name in ("driver", "last", "flop0")] == ["INVx2_R", "INVx1_R", "FLOP_R"]
    assert resize(module, CELLS, 8.0, 2.0) == 0


def test_the_largest_size_is_taken_where_none_is_large_enough() -> None:
    module = _module(20)
    assert resize(module, CELLS, 8.0, 2.0) == 1 and module["cells"]["driver"]["type"] == "INVx4_R"
    assert resize(module, CELLS, 8.0, 2.0) == 0


def test_black_boxes_and_outputs_load_as_well() -> None:
    module = _module(0, boxes=4)
    assert resize(module, CELLS, 8.0, 2.0) == 1 and module["cells"]["driver"]["type"] == "INVx2_R"
    assert resize(module, CELLS, 8.0, 20.0) == 2 and module["cells"]["last"]["type"] == "INVx4_R"


def test_a_larger_cell_is_never_made_smaller() -> None:
    module = _module(0, kind="INVx4_R")
    assert resize(module, CELLS, 8.0, 2.0) == 0 and module["cells"]["driver"]["type"] == "INVx4_R"
