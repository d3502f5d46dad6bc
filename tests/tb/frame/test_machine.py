"""Frames through the machine, with a stand-in for it that copies what memory holds: comparison, counters, figures, command."""

import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from golden.host.memory_image import DisplayPixels, FramePixels, spill_beats
from golden.msv2_ref import pipeline
from golden.msv2_ref.frame_memory import display_pixels
from spec.config import PAPER_SMALL, TINY
from spec.constants import TILE
from spec.errors import InputError
from spec.lpddr3 import CHANNELS
from spec.memory import BEAT_BYTES, DISPLAY_PIXEL_BYTES, PIXEL_BYTES, display_pixel, frame_pixel, page_beats
from spec.packing import pack
from spec.registers import STAGES
from tb.frame import __main__ as command
from tb.frame import whole
from tb.frame.bound import array_ops, bound_cycles
from tb.top import check, device
from tests.helpers.golden_samples import map_for, random_model, view
from tests.helpers.stand_in_machine import WRONG_PIXEL, preset, stand_in

SIZE = (40, 24)
EVENTS = check.expected_events
SCENE = "embedded --size 40x24 --gaze 5,5 --levels 4 --levels-from random --background 0.2,0.4,0.6"


@pytest.fixture(scope="module")
def frame():
    camera = view(70, 50)
    model = random_model(np.random.default_rng(5), 500, levels=4, sh=1)
    return pipeline.render(model, camera, config=TINY, foveation=map_for(camera, (0.1, 0.2), 4), beta=300)


def raw_pixels(frame):
    return FramePixels(*(frame.untiled(getattr(frame.pixels, name)).astype(np.int64) for name in FramePixels._fields))


def test_mismatches_are_named_with_their_tile(frame):
    pixels = raw_pixels(frame)
    assert check.mismatches(frame, pixels) == []
    pixels.colour[20, 35, 1] += 3
    pixels.depth[49, 69] -= 1
    pixels.transmittance[20, 17] += 1
    found = check.mismatches(frame, pixels)
    assert [(m["field"], m["tile"], m["x"], m["y"]) for m in found] == [
        ("transmittance", 6, 17, 20), ("colour", 7, 35, 20), ("depth", 19, 69, 49)]
    assert np.subtract(found[1]["rtl"], found[1]["golden"]).tolist() == [0, 3, 0]
    assert found[2]["rtl"][0] == found[2]["golden"][0] - 1


def test_mismatches_of_frames_for_displays(frame):
    golden = display_pixels(frame)
    pixels = DisplayPixels(*(golden[name].astype(np.int64) for name in DisplayPixels._fields))
    assert check.mismatches(frame, pixels) == []
    pixels.colour[20, 35, 1] ^= 1
    pixels.coverage[20, 17] ^= 8
    found = check.mismatches(frame, pixels)
    assert [(m["field"], m["tile"], m["x"], m["y"]) for m in found] == [("coverage", 6, 17, 20), ("colour", 7, 35, 20)]
    assert (whole.picture(frame, pixels) != golden["colour"]).sum() == 1


def test_pixels_from_memory_become_tiles(frame):
    pixels = raw_pixels(frame)
    assert all((a == b).all() for a, b in zip(whole.tiled(frame, pixels), frame.pixels, strict=True))
    pixels.depth[17, 33] += 5
    changed = replace(frame, pixels=whole.tiled(frame, pixels))
    assert np.argwhere(changed.pixels.depth != frame.pixels.depth).tolist() == [[1 * 5 + 2, 1, 1]]


@pytest.mark.parametrize("config", [TINY, PAPER_SMALL], ids=lambda config: config.name)
def test_the_bound_follows_the_text(frame, config):
    frame = replace(frame, config=config)
    e, blend = frame.entries, frame.registers.header[:, 1]
    ops = 0
    for tile in range(len(blend)):
        use = e.use[e.start[tile] : e.start[tile + 1]]
        ops += len(use) + np.count_nonzero(use == 3) + (2 if blend[tile] else 1)
    assert blend.any() and (e.use == 3).any() and array_ops(frame) == ops * config.blocks
    bounds = bound_cycles(frame, 5, 1000, 250, 25.6)
    assert bounds == {"sort": len(e.splat), "array": ops, "memory": 1563,
                      "pixel_rows": len(blend) * TILE * TILE // config.cores_x}
    assert bound_cycles(frame, ops + 7, 1000, 250, None) == {**bounds, "array": ops + 7, "memory": 1000}


def test_a_run_has_room_for_its_frame(frame):
    run = check.frame_run(frame, 300)
    counts = np.diff(frame.entries.start)
    assert run.image.settings["entries_beats"] == page_beats(counts) and run.image.settings["beta"] == 300
    chunk = TINY.sort_chunk
    assert spill_beats(TINY, np.array([chunk, 3])) == chunk
    assert spill_beats(TINY, np.array([2 * chunk + 1, 3])) == 3 * chunk


def counters_of(frame, display):
    events = EVENTS(frame)
    beats = SIZE[0] * SIZE[1] // (8 if display else 2)
    stages = {f"{stage}_{what}": 100 * i + j for i, stage in enumerate(STAGES)
              for j, what in enumerate(("busy", "starved", "blocked"))}
    return {**events, **stages, "read_beats": beats, "write_beats": beats, "read_beats_views": 100, "write_beats_frame": beats,
            "cycles_render_low": 16_000, "cycles_render_high": 0, "ops": 12_000, "skipped": 9}


@pytest.fixture
def copied(monkeypatch, tmp_path):
    """The command with a stand-in that has the golden pixels to copy; settings may be changed."""
    changes, run_of = {}, whole.frame_run

    def with_golden_pixels(frame, *args, display=False, **how):
        run = run_of(frame, *args, display=display, **how)
        preset(frame.config, tmp_path / "sim", counters_of(frame, display))
        if display:
            patterns = pack(display_pixel(frame.config), display_pixels(frame).reshape(-1), 8)[:, :DISPLAY_PIXEL_BYTES]
        else:
            raw = raw_pixels(frame)
            rows = {"colour": raw.colour.reshape(-1, 3), "reserved": np.zeros(raw.depth.size, int),
                    "depth": raw.depth.reshape(-1), "transmittance": raw.transmittance.reshape(-1)}
            patterns = pack(frame_pixel(frame.config), rows, PIXEL_BYTES)
        pixels = patterns.reshape(-1, BEAT_BYTES)
        geometry = run.image.contents["geometry"].copy()
        geometry[: len(pixels)] = pixels
        return replace(run, image=replace(run.image, contents={**run.image.contents, "geometry": geometry}), changes=changes)

    monkeypatch.setattr(whole, "frame_run", with_golden_pixels)
    monkeypatch.setattr(device, "machine", stand_in)
    return changes


def run_command(text, out):
    status = command.main([*text.split(), "--config", "tiny", "--out", str(out)])
    return status, json.loads((out / "frame.json").read_text())


def test_an_equal_frame_passes_and_is_reported(copied, tmp_path, capfd):
    copied["beta"] = 0  # the stand-in's faults
    status, report = run_command(f"{SCENE} --bandwidth 12.8 --latency 9", tmp_path)
    assert status == 0 and report["bit_exact"] is True and report["mismatches"] == 0
    assert report["counter_errors"] == [] == report["stream_errors"] and report["part"] == "machine"
    assert report["pixels_checked"] == 40 * 24 and report["tiles"] == 6 and report["config"] == "tiny" and report["levels"] == 4
    assert report["entries"] == report["events"]["entries"] > 100 and report["groups"] == report["events"]["groups"] <= 6
    assert report["beta"] is None and report["merge"] is report["pipeline"] is True
    assert report["latency"] == 9 and report["bytes_per_cycle"] == 12.8
    assert report["render_cycles"] == 16_000 and report["bounds"]["memory"] == (100 + 480) * 32 / 12.8
    assert report["bound_cycles"] == max(report["bounds"].values()) == report["ops"] == 12_000 and report["skipped"] == 9
    assert report["utilisation"] == 0.75
    assert report["stage_cycles"]["projection"] == {"busy": 100, "starved": 101, "blocked": 102}
    assert report["stalls"]["pixel_write"] == 1002 and report["dram_bytes"]["reads"]["views"] == 3200
    assert report["dram_bytes"]["read"] == report["dram_bytes"]["write"] == 480 * 32
    assert abs(report["cycles"] - 2 * 480 * 32 / 12.8) < 60
    picture = np.asarray(Image.open(tmp_path / "frame.png"))
    assert picture.shape == (24, 40, 3) and picture.std() > 5
    assert "bit-exact" in capfd.readouterr().out


def test_a_frame_on_lpddr3_is_compared_and_reported_the_same(copied, tmp_path):
    copied["beta"] = 0
    status, ideal = run_command(SCENE, tmp_path)
    assert (ideal["memory"], ideal["activates"], ideal["refreshes"]) == ("ideal", 0, 0)
    picture = np.asarray(Image.open(tmp_path / "frame.png"))
    status, report = run_command(f"{SCENE} --memory lpddr3", tmp_path)
    assert status == 0 and report["bit_exact"] is True and report["counter_errors"] == [] == report["stream_errors"]
    assert np.array_equal(picture, np.asarray(Image.open(tmp_path / "frame.png")))
    assert report["memory"] == "lpddr3" and report["latency"] is report["bytes_per_cycle"] is None
    assert report["dram_bytes"] == ideal["dram_bytes"] and report["bounds"] == ideal["bounds"]
    assert 0 < report["activates"] < 2 * 480 and report["cycles"] > ideal["cycles"] > 1.9 * 480 * 32 / 25.6
    assert CHANNELS * report["cycles"] / 3900 - CHANNELS <= report["refreshes"] <= CHANNELS * report["cycles"] / 3900 + CHANNELS


def test_an_equal_frame_for_displays_passes(copied, tmp_path):
    copied["beta"] = 0
    status, report = run_command(f"{SCENE} --pixels display --bandwidth 12.8", tmp_path)
    assert status == 0 and report["bit_exact"] is True and report["counter_errors"] == [] and report["pixels"] == "display"
    assert report["dram_bytes"]["writes"]["frame"] == SIZE[0] * SIZE[1] * DISPLAY_PIXEL_BYTES
    assert report["bounds"]["memory"] == (100 + 120) * 32 / 12.8
    displayed = np.asarray(Image.open(tmp_path / "frame.png"))
    status, report = run_command(SCENE, tmp_path)
    assert status == 0 and report["pixels"] == "wide"
    assert np.array_equal(displayed, np.asarray(Image.open(tmp_path / "frame.png"))) and displayed.std() > 5


def test_one_wrong_bit_of_a_frame_for_displays_fails(copied, tmp_path):
    copied["beta"] = WRONG_PIXEL
    status, report = run_command(f"{SCENE} --pixels display", tmp_path)
    assert status == 1 and report["bit_exact"] is False and report["mismatches"] == 1
    assert [report["first_mismatches"][0][key] for key in ("field", "tile", "x", "y")] == ["colour", 1, 24, 0]


def test_one_wrong_bit_fails(copied, tmp_path, capfd):
    copied["beta"] = WRONG_PIXEL
    status, report = run_command(f"{SCENE} --merge 0 --pipeline 0", tmp_path)
    assert status == 1 and report["bit_exact"] is False and report["mismatches"] == 1
    assert [report["first_mismatches"][0][key] for key in ("field", "tile", "x", "y")] == ["colour", 0, 6, 0]
    assert report["beta"] == 0 and report["groups"] == 6 and report["pipeline"] is False
    said = capfd.readouterr().out
    assert "pixel (6, 0) of tile 0: colour is" in said and "NOT bit-exact: 1 values differ" in said


def test_a_wrong_counter_fails(copied, tmp_path, monkeypatch, capfd):
    copied["beta"] = 0
    monkeypatch.setattr(check, "expected_events", lambda frame: EVENTS(frame) | {"survivors": 1})
    status, report = run_command(SCENE, tmp_path)
    assert status == 1 and report["bit_exact"] is True and len(report["counter_errors"]) == 1
    assert "counter survivors must be 1, not" in capfd.readouterr().out


def test_two_eyes_are_refused_by_the_name_of_a_machine_that_has_them(tmp_path):
    out = ["--out", str(tmp_path / "x")]
    with pytest.raises(InputError, match=r"^two eyes are not accepted: the RTL of config 'v3' has no joint frames; "):
        command.main(["embedded", "--config", "v3", "--stereo", *out])
    with pytest.raises(InputError, match="`paper` renders two eyes"):
        command.main(["embedded", "--config", "v3", "--set", "stereo=true", *out])
    assert not list(tmp_path.iterdir())
