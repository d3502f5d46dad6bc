"""The memory image and the settings of joint frames, read back field by field."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from golden.host.memory_image import memory_image, view_shift
from golden.msv2_ref.joint import JointFrame, render_joint
from golden.scenes.gaze import Display, foveation_map
from golden.scenes.stereo import stereo_pair
from spec.config import TINY_EYES, TINY_V3
from spec.constants import SUPER_TILES, SUPER_X, SUPER_Y
from spec.errors import InputError
from spec.joint import grid_origins
from spec.memory import TILE_SETTING_BYTES, frame_pixel, tile_setting
from tb.top.stimuli import camera_of, cloud

ROOM = {"entries_beats": 4096, "spill_beats": 64}


def joint_frame(shift: int, **options: object) -> JointFrame:
    model = cloud(np.random.default_rng(1), 60, levels=4)
    pair = stereo_pair(camera_of(150, 50), ipd_metres=0.2)
    levels = foveation_map(Display(150, 50), (60, 20), 4)
    return render_joint(model, pair, config=TINY_EYES, foveation=levels, gaze_target=(90, 30), shift=shift, **options)


@pytest.mark.parametrize("shift", [-8, -3, 0, 1, 8])
def test_every_tile_of_both_eyes_lies_at_its_place(shift):
    frame = joint_frame(shift)
    r = frame.registers
    image = memory_image(TINY_EYES, frame.source.words, r.source, second=r, **ROOM)
    record, flat = tile_setting(TINY_EYES), image.contents["supertiles"].reshape(-1, TILE_SETTING_BYTES)
    columns, rows = -(-(10 + abs(shift)) // SUPER_X), 2
    assert len(flat) == 2 * rows * columns * SUPER_TILES
    found = {}
    for number, word in enumerate(flat):
        supertile, rest = divmod(number, 2 * SUPER_TILES)
        eye, place = divmod(rest, SUPER_TILES)
        x = supertile % columns * SUPER_X + place % SUPER_X - grid_origins(shift)[eye]
        y = supertile // columns * SUPER_Y + place // SUPER_X
        bits = int.from_bytes(word.tobytes(), "little")
        if 0 <= x < 10 and y < 4:
            found[eye, y * 10 + x] = record.unpack(bits)
        else:
            assert bits == 0
    for eye, registers in enumerate(r.eyes):
        for tile, header in enumerate(registers.header):
            wanted = {"level": header[0], "blend": header[1], "plane": registers.plane[tile].tolist()}
            assert found[eye, tile] == wanted
    assert len(found) == 80 and not np.array_equal(*(eye.plane for eye in r.eyes))


def test_settings_and_regions_of_both_kinds_of_frames():
    frame = joint_frame(-3, shared_colour=True)
    r = frame.registers
    both = memory_image(TINY_EYES, frame.source.words, r.source, second=r, **ROOM)
    assert (both.settings["joint"], both.settings["shift"], both.settings["shared_colour"]) == (1, -3, 1)
    assert both.settings["target_position"] == TINY_EYES.formats.view.quantise(r.target.position).tolist()
    for name in ("target_tiles", "target_frame"):
        assert both.settings[f"{name}_base"] == both.regions[name].base
    assert both.regions["target_frame"].beats == both.regions["frame"].beats == 150 * 50 * 16 // 32
    one = memory_image(TINY_EYES, frame.source.words, r.source, **ROOM)
    assert one.settings["joint"] == 0 and "target_frame" not in one.regions
    plain = memory_image(TINY_V3, frame.source.words, r.source, **ROOM)
    assert one.contents.keys() == plain.contents.keys()
    assert all(np.array_equal(one.contents[name], plain.contents[name]) for name in plain.contents)


def test_each_eye_is_read_from_its_place_in_a_dump(tmp_path):
    frame = joint_frame(0)
    image = memory_image(TINY_EYES, frame.source.words, frame.registers.source, second=frame.registers, **ROOM)
    dump = np.random.default_rng(5).integers(0, 256, (image.frames.beats, 32), dtype=np.uint8)
    dump.tofile(tmp_path / "frames.bin")
    target = image.regions["target_frame"].base - image.regions["frame"].base
    assert 0 < target < image.frames.beats
    for found, first in ((image.frame(tmp_path / "frames.bin"), 0), (image.target_frame(tmp_path / "frames.bin"), target)):
        pixels = dump[first:].reshape(-1, 16)
        for y, x in ((0, 0), (20, 7), (49, 149)):
            wanted = frame_pixel(TINY_EYES).unpack(int.from_bytes(pixels[150 * y + x].tobytes(), "little"))
            assert all(getattr(found, name)[y, x].tolist() == wanted[name] for name in found._fields)
    one = memory_image(TINY_EYES, frame.source.words, frame.registers.source, **ROOM)
    assert one.target_frame(tmp_path / "frames.bin") is None


def test_machines_without_joint_frames_refuse_them():
    frame = joint_frame(0)
    with pytest.raises(InputError, match=r"^two eyes are not accepted: the RTL of config 'tiny_v3' has no joint frames"):
        memory_image(TINY_V3, frame.source.words, frame.registers.source, second=frame.registers, **ROOM)


@pytest.mark.parametrize(("levels", "shift"), [((0, 0), 0), ((1, 0), 1), ((0, 1), 1), ((0, 2), 2), ((3, 0), 2)])
def test_there_are_as_many_splat_records_as_either_eye_has_levels(levels, shift):
    eyes = [SimpleNamespace(header=np.array([[level, 1, 0], [0, 0, 0]])) for level in levels]
    assert view_shift(*eyes) == shift
