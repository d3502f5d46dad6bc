"""The check of a packed block's beats, a beat at a time."""

from __future__ import annotations

from functools import cache

from amaranth.hdl import Cat, Value

from spec.memory import BEAT_BYTES
from spec.packed import CHECK_BITS, CHECK_POLYNOMIAL, CHECK_START

_TOP = 1 << CHECK_BITS - 1


@cache
def _influence(steps: int) -> int:
    """The state that a single bit of data leaves, `steps` bits later."""
    if steps == 0:
        return CHECK_POLYNOMIAL
    before = _influence(steps - 1)
    return (before << 1) % (2 * _TOP) ^ (CHECK_POLYNOMIAL if before & _TOP else 0)


def first_state(block: Value) -> Value:
    """The state before a block's first beat, of the block's number."""
    return block[:CHECK_BITS] ^ CHECK_START


def next_state(state: Value, beat: Value) -> Value:
    """The state after a beat of 8 BEAT_BYTES bits: exclusive or of about half of the bits for each bit of the state."""
    count = 8 * BEAT_BYTES
    # the state acts like bits of data: the highest leaves first, together with the beat's first bit
    bits = beat ^ state[::-1]
    return Cat((bits & sum((_influence(count - 1 - n) >> k & 1) << n for n in range(count))).xor() for k in range(CHECK_BITS))
