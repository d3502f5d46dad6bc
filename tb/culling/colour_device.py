"""The colour unit in a test bench whose memory delays its answers."""

from __future__ import annotations

from functools import cache, partial

from amaranth.hdl import Module

from rtl.culling.colour import ColourUnit, splat_interval
from rtl.emit import to_verilog
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BITS, read_data, read_request, write_request
from spec.queues import COLOUR_LOOKAHEAD
from spec.records import surviving_splat
from tb.common.bench import Bench
from tb.common.emission import emitted
from tb.common.playback import Playback

MOST_DELAY = COLOUR_LOOKAHEAD - 1
"""Largest `delay`, in cycles from a request to its beat."""


class ColourBench(Bench):
    """The colour unit with delayed `data`.

    Parameters:
        config: the machine's configuration.
        sh_degree: the highest degree of spherical harmonics that the unit supports.
    """

    def __init__(self, config: AcceleratorConfig, sh_degree: int = 3) -> None:
        self._unit = ColourUnit(config, sh_degree=sh_degree)
        super().__init__(
            {"survivors": surviving_splat(config), "data": read_data(config)},
            {"reads": read_request(config), "writes": write_request(config)},
            {"sh_degree": 2, "colour_base": BEAT_BITS, "views_base": BEAT_BITS, "view_shift": 2,
             "delay": MOST_DELAY.bit_length()},
            {"finished": 1, "error": 1})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.unit = unit = self._unit
        self.join(m, unit, apart=("data",))
        self.delay_answers(m, unit, MOST_DELAY)
        return m


def _emit(config: AcceleratorConfig, sh_degree: int) -> str:
    return to_verilog(ColourBench(config, sh_degree), "colour_bench")


@cache
def playback(config: AcceleratorConfig, sh_degree: int = 3) -> Playback:
    """The bench of a configuration, emitted as Verilog, with a file at each stream."""
    name = f"colour-{'compact-' * config.compact}{splat_interval(config)}-{sh_degree}"
    verilog = emitted(f"{name}-bench", config, partial(_emit, sh_degree=sh_degree))
    return ColourBench(config, sh_degree).playback(name, "colour_bench", verilog)
