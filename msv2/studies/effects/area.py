"""Area of the effects that have hardware of their own: a machine with one, less the same machine without it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from spec.config import AcceleratorConfig
from spec.effects import machine_with
from synth.area import machine_area

ONE_EYE = frozenset(("sh", "levels", "blend", "depth"))
"""Effects of one eye that have hardware."""

PAIRS = {
    "sh": (ONE_EYE, ONE_EYE - {"sh"}),
    "levels": (ONE_EYE - {"blend"}, ONE_EYE - {"blend", "levels"}),
    "blend": (ONE_EYE, ONE_EYE - {"blend"}),
    "depth": (ONE_EYE, ONE_EYE - {"depth"}),
    "stereo": (ONE_EYE | {"stereo"}, ONE_EYE),
}
"""By effect, what a machine has with it and without it: all else of one eye, but that nothing blends where there are no levels.
Levels that never blend differ from one level by constants: views and the table of levels are every machine's, so their area is
within what synthesis varies by. Holes are filled, and tiles rendered again, by the second eye's units: `fill` and `rerender`
have no area of their own."""

Measure = Callable[[AcceleratorConfig], float]
"""mm^2 at 16 nm of a machine, memories included."""

TECHNOLOGY, CLOCK_PS, RUNS = "asap7", 1000.0, 1
"""Of all machines that are compared. One run, all sums fast at once: more area than the least, but by one rule everywhere."""


@dataclass(frozen=True)
class EffectArea:
    """Area of an effect: of the machine with it and without it, mm^2 at 16 nm."""

    with_mm2: float
    without_mm2: float

    @property
    def mm2(self) -> float:
        """The effect's own."""
        return self.with_mm2 - self.without_mm2

    @property
    def share(self) -> float:
        """Of the machine with it."""
        return self.mm2 / self.with_mm2


def measure_in(folder: Path, jobs: int = 1, progress: Callable[[str], None] = print) -> Measure:
    """Areas by synthesis, each machine's once; modules that are in `folder` are not made again.

    InputError, from what is returned, where Yosys or liberty files are absent.
    """
    @cache
    def measure(config: AcceleratorConfig) -> float:
        return machine_area(config, TECHNOLOGY, CLOCK_PS, folder, jobs, progress, RUNS, exact=True).total_mm2_16nm()

    return measure


def machine_of(config: AcceleratorConfig, active: frozenset[str]) -> AcceleratorConfig:
    """`config` with those effects and no others, harmonics of its degree."""
    return machine_with(config, active, config.sh_degree if "sh" in active else 0)


def effect_areas(config: AcceleratorConfig, measure: Measure) -> dict[str, EffectArea]:
    """Of every effect that has hardware."""
    return {effect: EffectArea(*(measure(machine_of(config, active)) for active in pair)) for effect, pair in PAIRS.items()}
