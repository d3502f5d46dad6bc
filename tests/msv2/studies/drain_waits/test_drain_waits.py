"""The measurement of drain waits: array and pixel writer together, bit for bit; the buffers order as they should."""

from __future__ import annotations

import pytest

from msv2.studies.drain_waits import study
from spec.config import TINY
from spec.errors import InputError
from tb.common.exact import run_plan
from tb.common.scenes import traced_frames


@pytest.mark.long
def test_array_and_writer_are_exact_behind_every_buffer(monkeypatch, tmp_path):
    monkeypatch.setenv("MSV2_DATA", str(tmp_path / "absent"))
    plan, waits = study.plan_of(traced_frames(TINY, "64x48")), {}
    assert len(plan) == 4
    for kind, machine, lines in study.buffers(TINY):
        outcome = run_plan(study.playback(machine, lines), plan, tmp_path / kind)
        assert outcome.failures == {}
        waits[kind] = [outcome.recordings[item.name].observed["waits"] for item in plan]
    least, double, _ = waits.values()
    assert all(a >= b for a, b in zip(least, double, strict=True)) and sum(least) > sum(double)


def test_bad_requests_name_what_is_accepted():
    with pytest.raises(InputError, match="'huge' is not accepted: choose one of tiny, default, paper"):
        study.main(["--config", "huge"])
