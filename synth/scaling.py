"""Factors that scale areas, delays and energies of a process node to 16 nm, and their source."""

from __future__ import annotations

from dataclasses import dataclass

SOURCE = ("A. Stillmaker, B. Baas: Scaling equations for the accurate prediction of CMOS device performance from 180 nm to "
          "7 nm, Integration 58, 2017")


@dataclass(frozen=True)
class Factors:
    """The factors by which a number of a node is multiplied to give the number at 16 nm (0.8 V).

    Attributes:
        node_nm: the node in nm.
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
"""Factors by technology. A predictive library (ASAP7, Nangate45) is taken for the node after which it is named."""

FO4_PS = {"asap7": 19.5, "asap7_ss": 29.3, "nangate45": 25.8}
"""The delay of an inverter that drives four like itself, in ps, in ASAP7 at the typical and the slow corner and in Nangate45
(`synth.fo4`). A test measures it again where the libraries are."""

DELAY_TO_16NM = {name: factors.delay for name, factors in TO_16NM.items()}
ENERGY_TO_16NM = {name: factors.energy for name, factors in TO_16NM.items()}


def same_clock(clock_ps: float, technology: str, other: str) -> float:
    """The clock of `other`, in ps, that scales to the same clock at 16 nm as `clock_ps` of `technology`; rounded to 25 ps."""
    return 25.0 * round(clock_ps * DELAY_TO_16NM[technology] / DELAY_TO_16NM[other] / 25.0)
