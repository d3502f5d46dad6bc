"""The measurement of drain waits: array and pixel writer together, bit for bit; the buffers order as they should."""

from __future__ import annotations

import pytest

from spec.config import TINY
from spec.errors import InputError
from tb.common.exact import run_plan
from tb.common.scenes import traced_frames
from tb.vrc import drain_waits


@pytest.mark.long
def test_array_and_writer_are_exact_behind_every_buffer(monkeypatch, tmp_path):
    monkeypatch.setenv("MSV2_DATA", str(tmp_path / "absent"))
    plan, waits = drain_waits.plan_of(traced_frames(TINY, "64x48")), {}
    assert len(plan) == 4
    for kind, machine, lines in drain_waits.buffers(TINY):
        outcome = run_plan(drain_waits.playback(machine, lines), plan, tmp_path / kind)
        assert outcome.failures == {}
        waits[kind] = [outcome.recordings[item.name].observed["waits"] for item in plan]
    least, double, _ = waits.values()
    assert all(a >= b for a, b in zip(least, double, strict=True)) and sum(least) > sum(double)


def test_bad_requests_name_what_is_accepted():
    with pytest.raises(InputError, match="'huge' is not accepted: choose one of tiny, default, paper"):
        drain_waits.main(["--config", "huge"])
