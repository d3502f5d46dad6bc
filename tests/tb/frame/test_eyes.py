"""Frames of two eyes through the machine's command, with a player that gives back the golden frames: comparison and figures."""

import json

import numpy as np
import pytest
from PIL import Image

from golden.host.memory_image import DisplayPixels
from golden.msv2_ref.eyes import per_pixel, render_request
from spec.codes import ErrorCode
from spec.config import TINY
from spec.registers import STEREO_EVENTS, counters
from tb.common.runner import SimulationError
from tb.frame import __main__ as command
from tb.frame import whole
from tb.frame.bound import array_ops, bound_cycles
from tb.top.check_stereo import rendered_pixels, stereo_events
from tb.top.player import FrameResult

SCENE = "embedded --size 70x50 --gaze 30,20 --levels 4 --levels-from random --background 0.2,0.4,0.6 --ecc-thresh 15 --ipd 0.01"


def result_of(frame):
    """What a machine that does everything right gives."""
    source, target = (DisplayPixels(*(pixels[name].astype(np.int64) for name in DisplayPixels._fields))
                      for pixels in (frame.source_pixels, frame.target_pixels))
    registers = dict.fromkeys((counter.name for counter in counters(frame.source.config)), 0)
    registers |= {**stereo_events(frame), "cycles_total": 9000, "cycles_target": 2000, "cycles_geometry": 3000,
                  "cycles_render": 1_000_000, "read_beats": 70, "write_beats": 80, "read_beats_views": 60,
                  "write_beats_warp": 9000, "write_beats_frame": 20, "ops": 12_000, "warp_busy": 30}
    return FrameResult(source, ErrorCode.NONE, True, registers, 1_010_000, 70, 80, 100, 1.0, 1.0, (), target)


@pytest.fixture
def played(monkeypatch):
    """The frames that were asked for, and what is given back."""
    found = {"golden": [], "runs": [], "change": lambda result: result}

    def golden(*args, **options):
        found["golden"].append(render_request(*args, **options))
        return found["golden"][-1]

    def play(machine, runs, folder, **options):
        found["runs"] += runs
        return [found["change"](result_of(found["golden"][-1]))]

    monkeypatch.setattr(command, "render_request", golden)
    monkeypatch.setattr(command.device, "machine", lambda config: type("Stub", (), {"design": lambda self: config})())
    monkeypatch.setattr(whole, "build", lambda design, waves: found.update(config=design))
    monkeypatch.setattr(whole, "play_frames", play)
    return found


def run_command(text, out):
    status = command.main([*text.split(), "--stereo", "--config", "tiny", "--out", str(out)])
    return status, json.loads((out / "frame.json").read_text())


@pytest.mark.parametrize("source", ["left", "right"])
def test_equal_eyes_pass_and_are_reported(played, tmp_path, capfd, source):
    status, report = run_command(f"{SCENE} --source {source}", tmp_path)
    frame, run = played["golden"][0], played["runs"][0]
    assert status == 0 and report["bit_exact"] is True and report["mismatches"] == 0 and report["counter_errors"] == []
    assert played["config"] == TINY.with_(stereo=True) and run.settle == 1024 + 8 * 128
    assert run.image.settings["source_right"] == (source == "right") and run.image.settings["auto_beta"] == 1
    assert report["pixels_checked"] == 2 * 70 * 50 and report["pixels"] == "display" and report["cycles"] == 1_010_000
    assert report["entries"] == report["source_entries"] + report["target_entries"] > report["source_entries"] > 100
    assert report["target_cycles"] == 2000 and report["source_cycles"] == 7000
    assert report["stage_cycles"]["warp"] == {"busy": 30, "starved": 0, "blocked": 0}
    assert report["dram_bytes"]["writes"]["warp"] == 9000 * 32
    bounds = bound_cycles(frame.source, 12_000, 60, 20, 25.6, second=frame.target)
    assert report["bounds"] == bounds and bounds["memory"] == 100  # without what is warped
    assert report["stereo_overhead"] == round(1_010_000 / (3000 + max(bounds.values())), 4)
    assert report["shares"] == report["stereo"]["shares"] == frame.shares and frame.shares["warped"] > 0.02
    assert report["stereo"]["source_eye"] == source and {f"stereo_{name}" for name in STEREO_EVENTS} <= report.keys()
    for name, wanted in zip(("left", "right"), frame.images, strict=True):
        assert np.array_equal(np.asarray(Image.open(tmp_path / f"{name}.png")), wanted)
    assert (tmp_path / f"{'right' if source == 'left' else 'left'}_source.png").exists()
    assert "both eyes in" in capfd.readouterr().out


def test_bounds_are_of_what_is_rendered(played, tmp_path):
    run_command(SCENE, tmp_path)
    frame = played["golden"][0]
    source, target, tiles = frame.source, frame.target, int(frame.rendered.sum())
    assert 0 < tiles < len(frame.rendered)
    blend = target.registers.header[frame.rendered, 1]
    ops = len(target.entries.splat) + int((target.entries.use == 3).sum()) + len(blend) + int(blend.sum())
    assert array_ops(target) == ops * TINY.blocks
    both = bound_cycles(source, 0, 0, 0, None, second=target)
    alone = bound_cycles(source, 0, 0, 0, None)
    assert both["sort"] - alone["sort"] == len(target.entries.splat) and both["array"] - alone["array"] in (ops, ops + 1)
    assert both["pixel_rows"] - alone["pixel_rows"] == tiles * 64
    inside = per_pixel(target, frame.rendered)
    assert rendered_pixels(target) == inside.sum() and rendered_pixels(source) == 70 * 50


def test_a_wrong_bit_of_either_eye_fails(played, tmp_path, capfd):
    def change(result):
        colour = result.target.colour.copy()
        colour[20, 40, 1] ^= 4
        return FrameResult(**{**vars(result), "target": result.target._replace(colour=colour)})

    played["change"] = change
    status, report = run_command(SCENE, tmp_path)
    assert status == 1 and report["bit_exact"] is False and report["mismatches"] == 1
    assert report["first_mismatches"][0]["eye"] == "right"
    assert "pixel (40, 20) of tile 7 of the right eye: colour is" in capfd.readouterr().out


def test_a_wrong_counter_or_an_error_fails(played, tmp_path, capfd):
    played["change"] = lambda result: FrameResult(**{**vars(result), "registers": {**result.registers, "filled": -1}})
    status, report = run_command(SCENE, tmp_path)
    assert status == 1 and report["bit_exact"] is True and len(report["counter_errors"]) == 1
    played["change"] = lambda result: FrameResult(**{**vars(result), "done": False, "error": ErrorCode.WRITE_ERROR})
    assert command.main([*SCENE.split(), "--stereo", "--config", "tiny", "--out", str(tmp_path)]) == 1
    assert "FAILED: the frame ended with error WRITE_ERROR" in capfd.readouterr().out
    assert not (tmp_path / "frame.json").exists() and issubclass(SimulationError, Exception)


@pytest.mark.long
@pytest.mark.parametrize(("size", "options"), [
    ("128x96", "--gaze 64,48 --levels 4 --levels-from random"), ("100x70", "--ecc-thresh 0 --pipeline 0")],
    ids=["foveated", "plain"])
def test_the_embedded_scene_in_both_eyes(tmp_path, size, options):
    argv = ["embedded", "--size", size, *options.split(), "--stereo", "--config", "paper_small", "--out", str(tmp_path)]
    assert command.main(argv) == 0
    report = json.loads((tmp_path / "frame.json").read_text())
    assert report["bit_exact"] and report["counter_errors"] == report["stream_errors"] == []
    assert report["bound_cycles"] <= report["render_cycles"] and report["stereo_overhead"] >= 1
    assert all(sum(cycles.values()) == report["frame_cycles"] for cycles in report["stage_cycles"].values())


@pytest.mark.long
@pytest.mark.data
def test_a_captured_scene_in_both_eyes(data_dir, tmp_path):
    argv = [str(data_dir / "trained" / "truck.splat"), "--size", "256x144", "--gaze", "128,72", "--levels", "4",
            "--levels-from", "random", "--stereo", "--config", "paper"]
    assert command.main([*argv, "--out", str(tmp_path)]) == 0
    report = json.loads((tmp_path / "frame.json").read_text())
    assert report["bit_exact"] and report["counter_errors"] == report["stream_errors"] == []
