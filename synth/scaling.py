"""Areas, delays and energies of one process node in another: factors to 16 nm, and where they are from."""

from __future__ import annotations

from dataclasses import dataclass

SOURCE = ("A. Stillmaker, B. Baas: Scaling equations for the accurate prediction of CMOS device performance from 180 nm to "
          "7 nm, Integration 58, 2017")


@dataclass(frozen=True)
class Factors:
    """What multiplies a number of a node to give one of 16 nm (0.8 V).

    Attributes:
        node_nm: the node.
        area, delay, energy: the factors.
    """

    node_nm: int
    area: float
    delay: float
    energy: float


TO_16NM = {
    "asap7": Factors(7, 1 / 0.31, 1 / 0.48, 1 / 0.40),
    "nangate45": Factors(45, 0.19, 1 / 1.86, 1 / 7.16),
    "osu018": Factors(180, 0.010, 1 / 11.8, 1 / 219),
}
"""By technology. Predictive libraries (ASAP7, Nangate45) are taken for the node that they are named after."""

AREA_TO_16NM = {name: factors.area for name, factors in TO_16NM.items()}
DELAY_TO_16NM = {name: factors.delay for name, factors in TO_16NM.items()}
ENERGY_TO_16NM = {name: factors.energy for name, factors in TO_16NM.items()}


def same_clock(clock_ps: float, technology: str, other: str) -> float:
    """The clock of `other` that scales to the same one at 16 nm; ps, rounded to 25."""
    return 25.0 * round(clock_ps * DELAY_TO_16NM[technology] / DELAY_TO_16NM[other] / 25.0)
