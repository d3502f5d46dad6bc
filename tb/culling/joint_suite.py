"""The projection unit's tests in joint frames: every splat of both eyes and every counter is compared with the golden
renderer's."""

from __future__ import annotations

from functools import cache, partial

import numpy as np
from amaranth.hdl import Cat, Module

from rtl.culling.frame import COUNTER_BITS
from rtl.culling.projection_unit import COUNTS, ProjectionUnit
from rtl.emit import to_verilog
from spec.config import TINY_EYES, V3_EYES, AcceleratorConfig
from spec.joint import EYES, SHIFT_MOST
from spec.memory import frame_settings
from spec.records import gaussian_point, projected_splat
from tb.common import exact
from tb.common.bench import Bench
from tb.common.emission import emitted
from tb.common.exact import Outcome, Planned, every_pattern, planned
from tb.common.playback import Playback
from tb.culling.joint_stimuli import JOINT_SETTINGS, JointCase
from tb.culling.projection_stimuli import EDITS, case_of, mixed_case

VARIANTS: dict[str, AcceleratorConfig] = {"tiny_eyes": TINY_EYES, "v3_eyes": V3_EYES}
"""Configurations that can be tested."""

DISTINCT = tuple(VARIANTS)
"""Configurations with different units: they take a point every 8 cycles, and every cycle."""

PORTS = ("sink", "source")

_SETTLING = 210
"""Most cycles from a frame's last point to its `end` at the source."""


class JointProjectionBench(Bench):
    """The unit, with the fields that mean nothing of splats with `none` set to 0.

    Parameters:
        config: the machine, with joint frames.
    """

    def __init__(self, config: AcceleratorConfig) -> None:
        self._unit = ProjectionUnit(config)
        widths = {f.name: f.width for f in frame_settings(config).fields}
        super().__init__(
            {"sink": gaussian_point(config)}, {"source": projected_splat(config)},
            {"rendering": 1, **{name: widths[name] for name in JOINT_SETTINGS}}, dict.fromkeys(COUNTS, COUNTER_BITS))

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.unit = unit = self._unit
        for name in JOINT_SETTINGS:  # settings with several numbers
            m.d.comb += Cat(getattr(unit, name)).eq(getattr(self, name))
        self.join(m, unit, apart=("source", *JOINT_SETTINGS))
        given, out = unit.source.payload, self.source.payload
        m.d.comb += [self.source.valid.eq(unit.source.valid), unit.source.ready.eq(self.source.ready), out.eq(given)]
        with m.If(given.none):
            m.d.comb += [out.as_value().eq(0), *(out[name].eq(given[name]) for name in ("index", "eye", "none"))]
        return m


def _emit(config: AcceleratorConfig) -> str:
    return to_verilog(JointProjectionBench(config), "joint_projection_bench")


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The bench of a configuration, emitted as Verilog, with a file at each stream."""
    return JointProjectionBench(config).playback(
        f"projection-{config.point_interval}-joint", "joint_projection_bench",
        emitted("joint-projection-bench", config, _emit))


def plan_of(case: JointCase, name: str | None = None, **options: object) -> Planned:
    """The run that plays a case; `options` are those of `planned`."""
    return planned(name or case.name, {"sink": case.items}, {"source": case.splats}, observed=case.observed,
                   settings=case.settings, **options)


def most_cycles(case: JointCase) -> int:
    """Cycles of a case at full rate: an interval per point and eye, and the latency of the unit."""
    return case.config.point_interval * (case.points + len(case.base.frames)) + _SETTLING


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Every kind of point in both phases and with every kind of distance between the eyes, frames of one eye, patterns of
    pauses, runs cut off by resets, and runs back to back."""
    rng = np.random.default_rng(seed)
    plan, make = [], partial(case_of, config, rng)
    for number, name in enumerate(EDITS):
        for rendering in (False, True):
            offset = rng.normal(size=3) * (0.03, 0.3, 3, 30)[number % 4]
            shift = int(rng.integers(-SHIFT_MOST, SHIFT_MOST + 1))
            plan.append(plan_of(JointCase(make(name, count=150), offset, shift, rendering)))
        plan.append(plan_of(JointCase(make(name, count=60), None, 3)))
    for size in ((1, 1), (17, 33), (config.row_width, config.row_width)):
        for shift in (-SHIFT_MOST, 0, SHIFT_MOST):
            base = make("edges of the frame", size=size, count=120)
            plan.append(plan_of(JointCase(base, np.array([0.2, -0.1, 0.05]), shift)))
    streams = JointCase(mixed_case(config, rng, "streams", [40, 0, 1, 90, 0, 60]), np.array([0.3, 0.1, -0.4]), -2)
    for name, patterns in every_pattern(PORTS, seed).items():
        plan.append(plan_of(streams, name, patterns=patterns, reset=False))
    for cycles in (3, 60, 200, 900):
        base = mixed_case(config, rng, f"cut off after {cycles} cycles", [400])
        plan.append(plan_of(JointCase(base, np.array([0.1, 0, 0])), abort=cycles))
        plan.append(plan_of(streams, f"frames after a reset at {cycles}"))
    for k, offset in enumerate((np.array([0.1, 0, 0]), None)):
        case = JointCase(mixed_case(config, rng, f"back to back {k}", [70, 3, 120]), offset)
        plan.append(plan_of(case, reset=False, quiet=0, most_cycles=most_cycles(case)))
    return plan


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    return unit_plan(config, seed)


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per run at full rate with its speed."""
    return [f"{item.name}: {len(item.run.inputs['sink'])} points of up to {EYES} eyes in {recording.cycles} cycles"
            for item, recording in exact.at_full_rate(plan, outcome)]


run_plan = exact.runner(playback)
"""Plays a plan and compares all results."""
