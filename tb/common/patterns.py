"""When a stream's source or sink pauses: one table of bits per port, the same for every kind of testbench."""

from __future__ import annotations

from enum import Enum

import numpy as np

PERIOD = 4093
"""Length of a table: a prime, so that no structure of the data keeps step with it."""


class Pattern(Enum):
    """How a port pauses: a source by holding back its next item, a sink by not being ready."""

    NEVER = "never"
    ALWAYS = "always"
    RANDOM = "random"
    BURSTY = "bursty"

    def pauses(self, seed: int = 0) -> np.ndarray:
        """(PERIOD,) bool, True where the port pauses; never True throughout.

        NEVER pauses not at all; ALWAYS in every other cycle, the most that still moves; RANDOM in half of the cycles;
        BURSTY for runs of up to 96 cycles, with runs of flow of the same kind between.
        """
        rng = np.random.default_rng(seed)
        if self is Pattern.NEVER:
            return np.zeros(PERIOD, bool)
        if self is Pattern.ALWAYS:
            return np.arange(PERIOD) % 2 == 0
        if self is Pattern.RANDOM:
            return rng.random(PERIOD) < 0.5
        lengths = rng.choice([1, 2, 3, 8, 24, 96], PERIOD)
        return np.repeat(np.arange(PERIOD) % 2 == 0, lengths)[:PERIOD]
