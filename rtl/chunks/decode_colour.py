"""Decoders of opacities and base colours of compact records (`spec.compact`), as combinational functions of codes.

A code should be a signal, because Verilog repeats expressions."""

from __future__ import annotations

from amaranth.hdl import Array, Cat, Const, Mux, Value

from rtl.fixed import as_integer, modular
from spec.compact import DC_COARSE_SHIFT, DC_LOW, OPACITY_LOG2, OPACITY_ONE, OPACITY_STEP_LOG2
from spec.config import AcceleratorConfig


def opacity(config: AcceleratorConfig, code: Value) -> Value:
    """The raw `log2_opacity` of an opacity's code: a table of the linear codes, and the difference to OPACITY_ONE times the
    logarithmic codes' step."""
    number = config.formats.log2_opacity
    places = OPACITY_ONE.bit_length()
    linear = Array(Const(raw, number.width) for raw in OPACITY_LOG2)[code[:places]]
    above = Cat(Const(0, OPACITY_STEP_LOG2), code[:places] + 1)  # code - OPACITY_ONE, which is one less than a power of two
    return modular(Mux(code[places:].any(), above, linear.as_signed()), number)


def base_colour(config: AcceleratorConfig, code: Value, coarse: Value, dc_range: Value) -> Value:
    """The raw `sh_dc` of a base colour's code. Whether it saturates is told by the code, so that no comparison waits for the
    difference and the shift."""
    number = config.formats.sh_dc
    steps = Mux(coarse, code << DC_COARSE_SHIFT, code)
    most = Array(Const(DC_LOW + (number.raw_max >> shift)) for shift in range(1 << len(dc_range)))[dc_range]
    raw = (as_integer(steps) - DC_LOW) << dc_range
    return modular(Mux(steps > most, number.raw_max, raw), number)
