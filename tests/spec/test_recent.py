"""The last few results of a computation."""

from __future__ import annotations

from spec.recent import Recent


def test_kept_results_are_made_once_and_the_oldest_goes():
    kept, made = Recent(2), []
    for key in (1, 2, 1, 3, 1, 2):
        kept.get(key, lambda key=key: made.append(key))
    assert made == [1, 2, 3, 2] and 3 not in kept
