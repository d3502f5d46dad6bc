"""The soak: the same frames for the same seed, counts that a later run goes on with, and differences that are made small."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from msv2.cases.soak import command, draw, runs, shrink
from msv2.cases.soak.draw import ABORT, GOOD, RESET
from spec.codes import ErrorCode
from spec.errors import InputError
from tb.top.stimuli import cloud


@pytest.mark.parametrize("machine", list(runs.MACHINES))
def test_a_batch_is_always_the_same_and_has_its_bounds(machine):
    config = runs.MACHINES[machine]
    once, again = (runs.frames_of(config, machine, 3, 5)[:4] for _ in range(2))
    for a, b in zip(once, again, strict=True):
        assert (a.kind, a.size, a.view, a.pixels, a.speed, a.fate, a.where) == (
            b.kind, b.size, b.view, b.pixels, b.speed, b.fate, b.where)
        assert np.array_equal(a.model.means, b.model.means)
    plan = draw.plan(config, [replace(once[0], fate=RESET), replace(once[1], fate=ABORT), replace(once[2], fate=GOOD)])
    assert [(item.run.reset, item.run.poison) for item in plan] == [(True, True), (True, False), (False, False)]
    assert plan[0].run.cut and plan[1].error is ErrorCode.ABORTED and plan[2].error is ErrorCode.NONE


def test_every_kind_and_every_end_is_drawn():
    drawn = [draw.draw(config, np.random.default_rng(n), name) for name, config in runs.MACHINES.items() for n in range(40)]
    assert {frame.fate for frame in drawn} == set(draw.FATES)
    assert {frame.kind for frame in drawn} == {draw.ONE, draw.JOINT, draw.WARPED}


def test_frames_of_the_machine_are_played_and_counted_on(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(runs, "BATCH", 3)
    arguments = ["--machine", "tiny", "--out", str(tmp_path)]
    assert command.main(["--cycles", "1", *arguments]) == 0
    first = json.loads((tmp_path / "soak.json").read_text())
    assert first["batches"] == 1 and first["frames"] == 3 and first["cycles"] > 1 and not first["differences"]
    assert command.main(["--cycles", str(first["cycles"] + 1), *arguments]) == 0
    assert json.loads((tmp_path / "soak.json").read_text())["batches"] == 2
    assert "6 frames" in capsys.readouterr().out
    with pytest.raises(InputError, match=r"has a soak of seed 1, not 2"):
        command.main(["--seed", "2", *arguments])


def test_a_difference_ends_it_and_is_made_small(tmp_path, monkeypatch, capsys):
    """A machine that fails wherever a frame with a Gaussian at z = 99 follows another frame."""
    monkeypatch.setattr(runs, "BATCH", 5)

    def broken(config, frames, folder):
        wrong = {n: ["seen"] for n, frame in enumerate(frames) if n and (frame.model.means[:, 2] == 99).any()}
        return 100, wrong

    def with_one(config, machine, seed, batch):
        frames = [replace(draw.draw(config, np.random.default_rng(n), "x"), model=cloud(np.random.default_rng(n), 50))
                  for n in range(5)]
        frames[3].model.means[17, 2] = 99
        return frames

    monkeypatch.setattr(runs, "play", broken)
    monkeypatch.setattr(runs, "frames_of", with_one)
    assert command.main(["--machine", "tiny", "--cycles", "1000", "--out", str(tmp_path)]) == 1
    shown = capsys.readouterr().out
    assert "frame 3 of batch 0 on tiny: seen" in shown and "it takes 2 frames, the last one with 1 Gaussians" in shown
    assert sorted(path.name for path in (tmp_path / "tiny-1-0-3").iterdir()) == ["0.ply", "1.ply"]


def test_tries_are_limited():
    frame = draw.draw(runs.MACHINES["tiny"], np.random.default_rng(0), "x")
    frame = replace(frame, model=cloud(np.random.default_rng(0), 64))
    tried = []
    assert len(shrink.fewest_gaussians([frame], lambda frames: tried.append(1), tries=9)[-1].model) == 64 and len(tried) == 9


def test_bad_requests_name_what_is_accepted():
    for arguments, words in ((["--machine", "huge"], "machine"), (["--cycles", "0"], "cycles from 1")):
        with pytest.raises(InputError, match=words):
            command.main(arguments)
