"""Area of the effects that have their own hardware: the area of a machine with the effect minus that of one without it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from spec.config import AcceleratorConfig
from spec.effects import machine_with
from synth.area import machine_area

ONE_EYE = frozenset(("sh", "levels", "blend", "depth"))
"""The effects that have hardware in a machine for one eye."""

PAIRS = {
    "sh": (ONE_EYE, ONE_EYE - {"sh"}),
    "levels": (ONE_EYE - {"blend"}, ONE_EYE - {"blend", "levels"}),
    "blend": (ONE_EYE, ONE_EYE - {"blend"}),
    "depth": (ONE_EYE, ONE_EYE - {"depth"}),
    "stereo": (ONE_EYE | {"stereo"}, ONE_EYE),
}
"""For each effect the effects of the machine with it and of the machine without it.

Both machines have all other effects of one eye, except that nothing blends where there are no levels. Levels without blending
differ from a single level only by constants: every machine has the splat records and the table of levels, so the difference is
within the variation of synthesis. Holes are filled and tiles are rendered again by units of the second eye, so `fill` and
`rerender` have no area of their own."""

Measure = Callable[[AcceleratorConfig], float]
"""A function from a machine to its area in mm^2 at 16 nm, including memories."""

TECHNOLOGY, CLOCK_PS, RUNS = "asap7", 1000.0, 1
"""The synthesis settings of all machines that are compared. With one run all sums are fast from the start, which takes more
area than necessary, but is the same rule for every machine."""


@dataclass(frozen=True)
class EffectArea:
    """Areas of the machine with an effect and of the machine without it, in mm^2 at 16 nm."""

    with_mm2: float
    without_mm2: float

    @property
    def mm2(self) -> float:
        """Area of the effect in mm^2 at 16 nm."""
        return self.with_mm2 - self.without_mm2

    @property
    def share(self) -> float:
        """Area of the effect as a share of the machine that has it."""
        return self.mm2 / self.with_mm2


def measure_in(folder: Path, jobs: int = 1, progress: Callable[[str], None] = print) -> Measure:
    """A function that measures a machine by synthesis, once per machine; results of modules found in `folder` are reused.

    The returned function raises InputError if Yosys or liberty files are missing.
    """
    @cache
    def measure(config: AcceleratorConfig) -> float:
        return machine_area(config, TECHNOLOGY, CLOCK_PS, folder, jobs, progress, RUNS, exact=True).total_mm2_16nm()

    return measure


def machine_of(config: AcceleratorConfig, active: frozenset[str]) -> AcceleratorConfig:
    """`config` with these effects and no others; with "sh" it keeps its own degree of harmonics."""
    return machine_with(config, active, config.sh_degree if "sh" in active else 0)


def effect_areas(config: AcceleratorConfig, measure: Measure) -> dict[str, EffectArea]:
    """The area of every effect that has hardware."""
    return {effect: EffectArea(*(measure(machine_of(config, active)) for active in pair)) for effect, pair in PAIRS.items()}
