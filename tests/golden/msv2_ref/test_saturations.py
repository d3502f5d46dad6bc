"""Which culled Gaussians count as misplaced."""

from __future__ import annotations

import numpy as np
import pytest

from golden.msv2_ref.projection import OUTSIDE, VISIBLE, Projected
from golden.msv2_ref.saturations import misplaced


@pytest.mark.parametrize(("reason", "box", "counts"), [
    (OUTSIDE, (0, 3, 1, 1), True), (OUTSIDE, (2, 2, 0, 5), True), (VISIBLE, (0, 3, 1, 1), False),
    (OUTSIDE, (1, 0, 0, 5), False), (OUTSIDE, (0, 3, 5, 4), False), (OUTSIDE, (0, 9, 5, 4), False),
    (OUTSIDE, (7, 6, 2, 9), False)])
def test_a_culled_gaussian_is_misplaced_if_its_box_meets_the_frame_along_both_axes(reason, box, counts):
    none = np.zeros((1, 3), np.int32)
    projected = Projected(np.array([reason], np.uint8), none[:, :2], none * 1.0, none[:, 0], none[:, 0],
                          np.array([box], np.int16))
    assert misplaced(projected).tolist() == [counts]
