"""Random images in memory and random registers: every frame ends, within the bus's rules, and the next one is right.

With lists by super-tile, memory holds two copies of a Gaussian. Where they contradict each other, the second phase may wait for
a splat that the first one counted, until the watchdog ends the frame. `tiny` has no such waits, and so needs no watchdog.
"""

from __future__ import annotations

import numpy as np
import pytest

from spec.chunks import chunk_header
from spec.config import TINY, TINY_V3
from spec.host_settings import settings
from spec.packing import unpack
from tb.top.device import machine
from tb.top.garbage import ends, garbage_plan, wrongs
from tb.top.player import play_frames
from tb.top.power_up import powered_up


def played(config, seed, count, folder):
    plan = garbage_plan(config, seed, count)
    device = powered_up(config) if config.supertiles else machine(config)
    return plan, play_frames(device, [spoilt.item.run for spoilt in plan], folder)


@pytest.mark.parametrize("config", [TINY, TINY_V3], ids=lambda config: config.name)
def test_frames_of_a_host_that_errs_end_and_the_next_one_is_right(config, tmp_path):
    plan, results = played(config, 7, 12, tmp_path)
    assert wrongs(plan, results) == {}
    found = ends(plan, results)
    assert found["NONE"] and found["BAD_SETTING"] and sum(found.values()) == 12


@pytest.mark.long
@pytest.mark.parametrize("config", [TINY, TINY_V3], ids=lambda config: config.name)
def test_many_of_them(config, tmp_path):
    for seed in range(20):
        assert wrongs(*played(config, 100 + seed, 30, tmp_path / str(seed))) == {}, seed


def places(image):
    """(chunks, 2) numbers of Gaussians of the chunks in memory, and their first ones."""
    words = unpack(chunk_header(image.config), image.contents["chunks"])
    return np.stack([words["count"], words["first"]], 1)


def test_what_is_random_and_what_is_not():
    plan = garbage_plan(TINY_V3, 1, 12)
    assert [spoilt.free for spoilt in plan] == [True, False] * 12
    spoilt = [one for one in plan if one.free]
    kept = {s.name for s in settings(TINY_V3) if s.name.endswith(("_base", "_beats"))} | {"gaussians", "chunks", "width"}
    assert not any(kept & set(one.item.run.changes) for one in spoilt)
    assert any(len(one.item.run.changes) > 20 for one in spoilt)
    for place in range(2):
        assert any((places(one.item.run.image) != places(two.item.run.image))[:, place].any()
                   for one, two in zip(plan[::2], plan[1::2], strict=True))
    good = plan[1].item.run.image.contents
    assert any(not np.array_equal(rows, good[name]) for name, rows in spoilt[0].item.run.image.contents.items())
