"""Misses of the splat cache, against a cache written with lists: sets, ways, what is replaced, and how an index is folded."""

from __future__ import annotations

import numpy as np
import pytest

from golden.msv2_ref.fetch import find_misses


def folded(index: int, bits: int) -> int:
    """The lowest three digits of `bits` bits of an index, combined by XOR."""
    first, second, third = (index >> bits * digit & (1 << bits) - 1 for digit in range(3))
    return first ^ second ^ third


def misses(index: list[int], level: list[int], sets: int, ways: int, keep_used: bool, fold: bool) -> list[bool]:
    """Which accesses miss; each set is a list of what it holds, the newest first."""
    bits, found = sets.bit_length() - 1, []
    held: list[list[tuple[int, int]]] = [[] for _ in range(sets)]
    for key in zip(index, level, strict=True):
        line = held[folded(key[0], bits) if fold and bits else key[0] % sets]
        found.append(key not in line)
        if key not in line or keep_used:
            line[:] = [key, *(other for other in line if other != key)][:ways]
    return found


@pytest.mark.parametrize("fold", [False, True])
@pytest.mark.parametrize("keep_used", [False, True])
@pytest.mark.parametrize(("lines", "ways"), [(4, 2), (16, 1), (16, 4), (4, 4), (64, 2)])
def test_misses_are_those_of_lists(lines: int, ways: int, keep_used: bool, fold: bool):
    rng = np.random.default_rng(lines * ways)
    recent = rng.integers(0, 4000, 24)
    index = np.where(rng.random(600) < 0.8, rng.choice(recent, 600), rng.integers(0, 4000, 600))
    level = rng.integers(0, 2, 600)
    found = find_misses(index, level, lines, ways, keep_used, fold)
    assert found.tolist() == misses(index.tolist(), level.tolist(), lines // ways, ways, keep_used, fold)
    assert 30 < found.sum() < 600
