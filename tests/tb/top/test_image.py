"""Memory images: every record where spec says, every setting a legal pattern, the frame read back."""

from itertools import pairwise

import numpy as np
import pytest

from golden.host.memory_image import REGIONS, gaussian_bytes, memory_image, read_frame
from golden.msv2_ref import pipeline
from spec.chunks import chunk_header
from spec.compact import compact_colour, compact_geometry, compact_harmonics
from spec.config import CONFIGS, PAPER, RECORDS, TINY, V3_RECORDS
from spec.formats import Fixed
from spec.host_settings import first_illegal
from spec.memory import (
    BEAT_BYTES,
    BEAT_ENTRIES,
    DIRECTORY_SLOTS,
    DISPLAY_PIXEL_BYTES,
    FIRST_PAGE_ENTRIES,
    PIXEL_BYTES,
    colour_beats,
    display_pixel,
    frame_pixel,
    frame_settings,
    page_beats,
    tile_setting,
)
from spec.packing import pack
from spec.records import gaussian_colour, gaussian_geometry
from tb.top.check_stereo import stereo_run
from tb.top.player import setting_writes
from tb.top.stimuli_stereo import stereo_case, wall
from tb.top.suite import TINY_RECORDS
from tests.helpers.golden_samples import map_for, random_model, view


def random_rows(record, count, seed=0):
    rng, rows = np.random.default_rng(seed), np.zeros(count, record.dtype)
    for f in record.fields:
        rows[f.name] = rng.integers(*f.raw_range, rows[f.name].shape, endpoint=True)
        rows[f.name][:2] = np.array(f.raw_range).reshape(2, *(1,) * (rows[f.name].ndim - 1))
    return rows


def frame_of(gaze=None, levels=1, sh=0, size=(50, 37), config=TINY, points=300):
    camera = view(*size)
    model = random_model(np.random.default_rng(7), points, levels, sh)
    return pipeline.render(model, camera, config=config, foveation=map_for(camera, gaze, levels), background=(0.1, 0.5, 1.0))


def number(data):
    return int.from_bytes(data.tobytes(), "little")


def image_of(frame, **options):
    return memory_image(frame.config, frame.words, frame.registers, entries_beats=40, spill_beats=9, **options)


@pytest.mark.parametrize("sh", range(4))
def test_gaussians_lie_by_index(sh):
    frame = frame_of(sh=sh)
    contents, beats = gaussian_bytes(TINY, frame.words), colour_beats(TINY, sh)
    assert beats == (1, 2, 2, 3)[sh] and len(contents["colour"]) == beats * len(contents["geometry"]) == beats * 300
    geometry, colour = gaussian_geometry(TINY), gaussian_colour(TINY, sh)
    for i in (0, 17, 299):
        assert int.from_bytes(contents["geometry"][i].tobytes(), "little") == geometry.pack(frame.words.geometry[i])
        bits = int.from_bytes(contents["colour"][i * beats : (i + 1) * beats].tobytes(), "little")
        assert bits == colour.pack(frame.words.colour[i])


@pytest.mark.parametrize("sh", range(4))
@pytest.mark.parametrize("records", RECORDS)
def test_chunks_and_records_lie_by_index(sh, records):
    """Every byte of the three regions, by the text of `spec.memory`."""
    config = V3_RECORDS.with_(records=records)
    frame = frame_of((0.5, 0.5), 4, sh, config=config, points=301)
    words, contents = frame.words, gaussian_bytes(config, frame.words)
    header, beats = chunk_header(config), colour_beats(config, sh)
    assert {int(bound) for bound in words.chunks["bound"]} == {0, 1, 2, 3}
    assert contents["chunks"].shape == (len(words.chunks), BEAT_BYTES)
    for i, chunk in enumerate(words.chunks):
        assert number(contents["chunks"][i]) == header.pack(chunk)
    assert len(contents["geometry"]) == (151 if records == "compact" else 301)
    assert len(contents["colour"]) == beats * 301
    geometry = contents["geometry"].reshape(-1, 16 if records == "compact" else 32)
    assert not geometry[301:].any()
    colour = contents["colour"].reshape(-1, beats, BEAT_BYTES)
    for i in range(301):
        coarse = bool(words.geometry["bound"][i] == 3)
        if records == "wide":
            assert number(geometry[i]) == gaussian_geometry(config).pack(words.geometry[i])
            assert number(colour[i]) == gaussian_colour(config, sh).pack(words.colour[i])
            continue
        assert number(geometry[i]) == compact_geometry(config, coarse).pack(words.compact.geometry[i])
        held = compact_colour(config, coarse)
        assert number(colour[i, 0]) == held.pack({
            f.name: words.compact.colour[f.name][i][: f.count] if f.count > 1 else words.compact.colour[f.name][i]
            for f in held.fields})
        if sh:
            assert number(colour[i, 1]) == compact_harmonics(config).pack(words.compact.harmonics[i])


def test_chunks_lie_first_and_the_settings_name_them():
    frame = frame_of(config=V3_RECORDS)
    image = image_of(frame)
    assert list(image.regions) == [name for name in REGIONS if not name.startswith(("target", "supertiles"))]
    assert image.settings["chunks"] == len(frame.words.chunks) == image.regions["chunks"].beats == 5
    assert image.settings["chunks_base"] == image.regions["chunks"].base < image.regions["geometry"].base
    assert image.settings["gaussians"] == 300 and image.regions["geometry"].beats == 150


def test_a_model_without_gaussians_has_an_image():
    image = image_of(frame_of(config=V3_RECORDS, points=0))
    assert image.settings["chunks"] == image.settings["gaussians"] == image.regions["chunks"].beats == 0
    assert all(len(image.contents[name]) == 0 for name in ("chunks", "geometry", "colour"))


def test_tiles_lie_row_by_row():
    frame = frame_of(gaze=(0.1, 0.2), levels=4, size=(200, 90))
    tiles, record = image_of(frame).contents["tiles"], tile_setting(TINY)
    assert tiles.shape == (-(-len(frame.headers) // 4), BEAT_BYTES)
    for tile, header in enumerate(frame.headers):
        row = record.unpack(int.from_bytes(tiles.reshape(-1)[8 * tile : 8 * tile + 8].tobytes(), "little"))
        assert row["plane"] == header["plane"].tolist() and row["blend"] == header["blend"]
        assert row["level"] == frame.registers.header[tile, 0]
    assert len({int(level) for level in frame.registers.header[:, 0]}) > 2


@pytest.mark.parametrize("config", [TINY, TINY_RECORDS], ids=["tiny", "tiny_records"])
@pytest.mark.parametrize(("gaze", "levels", "size", "shift"), [
    (None, 1, (50, 37), 0), ((0.5, 0.5), 3, (40, 24), 2), ((0.0, 0.0), 4, (500, 300), 2), ((0.4, 0.4), 2, (500, 300), 1)])
def test_regions_do_not_overlap_and_are_large_enough(gaze, levels, size, shift, config):
    frame = frame_of(gaze, levels, 2, size, config=config)
    image = image_of(frame)
    absent = ("target", "supertiles", *(() if config.chunks else ("chunks",)))
    places = [image.regions[name] for name in REGIONS if not name.startswith(absent)]
    assert len(places) == len(image.regions)
    if config.chunks:
        assert image.regions["geometry"].beats == 150 and image.regions["colour"].beats == 600
        assert image.settings["chunks"] == image.regions["chunks"].beats == len(frame.words.chunks) > 4
    assert all(a.end < b.base for a, b in pairwise(places)) and places[0].base > 0
    assert image.beats == places[-1].end
    for name, rows in image.contents.items():
        assert len(rows) == image.regions[name].beats
    assert image.settings["view_shift"] == shift
    assert frame.registers.header[:, 0].max() < 1 << shift
    assert image.regions["views"].beats == 300 << shift
    assert 0 <= image.regions["frame"].beats * 2 - size[0] * size[1] < 2
    display = image_of(frame, display=True)
    assert 0 <= display.regions["frame"].beats * 8 - size[0] * size[1] < 8
    assert (image.settings["display"], display.settings["display"]) == (0, 1)


@pytest.mark.parametrize("config", CONFIGS.values(), ids=CONFIGS)
@pytest.mark.parametrize("beta", [None, 0, 700])
def test_settings_are_the_registers(config, beta):
    frame = frame_of(config=config)
    image = image_of(frame, beta=beta, obb=True)
    fields = {f.name: f for f in frame_settings(config).fields}
    assert fields.keys() == image.settings.keys()
    assert frame_settings(config).unpack(frame_settings(config).pack(image.settings)) == image.settings
    for name, field in fields.items():
        if hasattr(frame.registers, name):
            wanted, raw = np.reshape(getattr(frame.registers, name), -1), np.reshape(image.settings[name], -1)
            assert (raw == wanted).all() if isinstance(field.format, Fixed) else (field.format.to_float(raw) == wanted).all()
    assert (image.settings["beta"], image.settings["auto_beta"], image.settings["obb"]) == (beta or 0, beta is None, 1)
    assert image.settings["frame_base"] == image.regions["frame"].base and image.settings["spill_beats"] == 9
    assert first_illegal(config, setting_writes(config, image, {})) is None


def test_pages_follow_the_text_of_spec():
    first = FIRST_PAGE_ENTRIES

    def by_the_text(count):
        pages = {((n + first) // first).bit_length() - 1 for n in range(count)} | {0}
        return sum(first << k for k in pages) // BEAT_ENTRIES

    counts = np.array([0, 1, 31, 32, 33, 95, 96, 97, 1000, 4096])
    assert [page_beats([count]) for count in counts] == [by_the_text(count) for count in counts]
    assert page_beats(counts) == sum(map(by_the_text, counts))
    most = (first << DIRECTORY_SLOTS + 1) - first
    assert page_beats([most]) * BEAT_ENTRIES == most
    with pytest.raises(ValueError, match=f"at most {most} entries a tile, not {most + 1}"):
        page_beats([3, most + 1])


@pytest.mark.parametrize("size", [(3, 5), (16, 16), (7, 1)])
def test_the_frame_is_read_row_by_row(size):
    width, height = size
    record = frame_pixel(PAPER)
    rows = random_rows(record, width * height)
    data = np.concatenate([pack(record, rows, PIXEL_BYTES).reshape(-1), np.full(PIXEL_BYTES, 255, np.uint8)])
    pixels = read_frame(PAPER, data, width, height)
    for name in ("colour", "depth", "transmittance"):
        assert (getattr(pixels, name).reshape(rows[name].shape) == rows[name]).all()
        assert getattr(pixels, name).shape[:2] == (height, width)


def test_a_frame_for_displays_is_read_row_by_row():
    width, height, record = 7, 3, display_pixel(PAPER)
    rows = random_rows(record, width * height)
    data = pack(record, rows, 8)[:, :DISPLAY_PIXEL_BYTES].reshape(-1)
    pixels = read_frame(PAPER, np.append(data, np.full(12, 255, np.uint8)), width, height, display=True)
    for name in ("colour", "coverage"):
        assert (getattr(pixels, name).reshape(rows[name].shape) == rows[name]).all()
        assert getattr(pixels, name).shape[:2] == (height, width)


@pytest.mark.parametrize("source_eye", ["left", "right"])
def test_the_second_eye_has_a_table_and_a_frame_of_its_own(source_eye):
    config = TINY.with_(stereo=True)
    made = stereo_case(config, "", wall(np.random.default_rng(1), 3, 4), (90, 60), gaze=(45, 30), source_eye=source_eye).frame
    image = stereo_run(made, None).image
    record, target = tile_setting(config), made.registers.target
    rows = [record.unpack(int.from_bytes(row.tobytes(), "little"))
            for row in image.contents["target_tiles"].reshape(-1, 8)[: len(target.header)]]
    assert [row["warp"] for row in rows] == made.registers.warp.tolist() and {row["warp"] for row in rows} == {0, 1}
    assert [[row["level"], row["blend"]] for row in rows] == target.header[:, :2].tolist()
    first = [record.unpack(int.from_bytes(row.tobytes(), "little")) for row in image.contents["tiles"].reshape(-1, 8)]
    assert not any(row["warp"] for row in first)
    places = [image.regions[name] for name in REGIONS if name not in ("chunks", "supertiles")]
    assert len(image.regions) == len(places) and all(a.end < b.base for a, b in pairwise(places))
    patterns = setting_writes(config, image, {})
    assert first_illegal(config, patterns) is None
    assert first_illegal(config, patterns | {"display": 0}) is not None
    assert patterns["stereo"] == 1 and patterns["source_right"] == (source_eye == "right")
    assert patterns["target_tiles_base"] == image.regions["target_tiles"].base
    assert patterns["target_frame_base"] == image.regions["target_frame"].base
    assert patterns["disparity_scale"] == made.registers.disparity_scale > 0
    moved = [patterns[f"target_position_{i}"] != patterns[f"position_{i}"] for i in range(3)]
    assert any(moved)


def test_frames_of_one_eye_leave_the_second_ones_settings_to_chance():
    frame = frame_of(config=TINY.with_(stereo=True))
    image = image_of(frame)
    patterns = setting_writes(frame.config, image, {})
    assert patterns["stereo"] == 0 and patterns["target_frame_base"] > image.beats and "target_frame" not in image.regions


def test_both_eyes_are_read_back(tmp_path):
    made = stereo_case(TINY.with_(stereo=True), "", wall(np.random.default_rng(1), 3, 1), (33, 18)).frame
    image = stereo_run(made, None).image
    words = np.random.default_rng(0).integers(0, 256, image.frames.beats * BEAT_BYTES, np.uint8)
    words.tofile(tmp_path / "dump")
    size, gap = 33 * 18 * DISPLAY_PIXEL_BYTES, BEAT_BYTES * (image.regions["target_frame"].base - image.regions["frame"].base)
    for pixels, at in ((image.frame(tmp_path / "dump"), 0), (image.target_frame(tmp_path / "dump"), gap)):
        expected = words[at : at + size].reshape(18, 33, 4)
        assert np.array_equal(pixels.colour, expected[..., :3]) and np.array_equal(pixels.coverage, expected[..., 3])
    assert image_of(frame_of()).target_frame(tmp_path / "dump") is None
