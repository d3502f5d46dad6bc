"""The cycles in which a stream's source or sink pauses: one table of bits per port, used by every kind of testbench."""

from __future__ import annotations

from enum import Enum

import numpy as np

PERIOD = 4093
"""Length of a table. It is a prime number, so that periodic data does not stay in step with the pauses."""


class Pattern(Enum):
    """How a port pauses: a source by holding back its next item, a sink by not being ready."""

    NEVER = "never"
    ALWAYS = "always"
    RANDOM = "random"
    BURSTY = "bursty"
    TIDAL = "tidal"

    def pauses(self, seed: int = 0) -> np.ndarray:
        """(PERIOD,) bool, True where the port pauses; never True throughout.

        NEVER does not pause; ALWAYS pauses in every other cycle, the most that still lets items move; RANDOM pauses in half of
        the cycles; BURSTY pauses for up to 96 cycles in a row, and flows for up to 96 cycles in a row between. TIDAL pauses for
        a third of the table, flows for a sixth, and again: behind a sink that does so even long pipelines fill up.
        """
        rng = np.random.default_rng(seed)
        if self is Pattern.NEVER:
            return np.zeros(PERIOD, bool)
        if self is Pattern.ALWAYS:
            return np.arange(PERIOD) % 2 == 0
        if self is Pattern.RANDOM:
            return rng.random(PERIOD) < 0.5
        if self is Pattern.TIDAL:
            return np.arange(PERIOD) % (PERIOD // 2) < PERIOD // 3
        lengths = rng.choice([1, 2, 3, 8, 24, 96], PERIOD)
        return np.repeat(np.arange(PERIOD) % 2 == 0, lengths)[:PERIOD]
