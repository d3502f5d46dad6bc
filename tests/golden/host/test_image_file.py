"""Frame images as files: what is written is read back, and what does not fit a machine is refused with its reason."""

import struct

import numpy as np
import pytest

from golden.host.image_file import image_bytes, read_image
from golden.host.memory_image import memory_image
from golden.msv2_ref import pipeline
from spec.config import MACHINES, PAPER, TINY, V3, V3_RECORDS
from spec.errors import InputError
from spec.images import HEAD, IMAGE_VERSION
from tests.helpers.golden_samples import random_model, view

SETTINGS = {0x100: 7, 0x104: 0xFFFFFFFF}


def image_of(config):
    frame = pipeline.render(random_model(np.random.default_rng(1), 40), view(20, 20), config=config)
    return memory_image(config, frame.words, frame.registers, entries_beats=8, spill_beats=0)


@pytest.fixture(scope="module")
def packed():
    return image_bytes(image_of(V3_RECORDS), SETTINGS)


def changed(data, word, value):
    return data[: 4 * word] + struct.pack("<I", value) + data[4 * word + 4 :]


def at(name):
    return HEAD.index(name)


@pytest.mark.parametrize("config", [TINY, PAPER, V3, V3_RECORDS, V3_RECORDS.with_(records="wide")],
                         ids=["tiny", "paper", "v3", "v3_records", "wide"])
def test_what_is_written_is_read_back(config):
    image = image_of(config)
    found = read_image(config, image_bytes(image, SETTINGS))
    assert found.settings == SETTINGS
    assert (found.head["width"], found.head["height"], found.head["memory"]) == (20, 20, 32 * image.beats)
    assert found.head["frame"] == 32 * image.regions["frame"].base and found.head["pixel_bytes"] == image.pixel_bytes
    filled = {name: rows for name, rows in image.contents.items() if len(rows)}
    assert list(found.segments) == [32 * image.regions[name].base for name in filled]
    for segment, rows in zip(found.segments.values(), filled.values(), strict=True):
        assert np.array_equal(segment, rows.reshape(-1))
    assert ("chunks" in filled) == config.chunks


@pytest.mark.parametrize(("made", "read", "said"), [
    ("v3", "paper", "it holds compact records in chunks, and config 'paper' reads wide records"),
    ("paper", "v3", "it holds wide records, and config 'v3' reads compact records in chunks"),
    ("wide", "v3", "it holds wide records in chunks, and config 'v3' reads compact records in chunks"),
    ("v3_records", "v3", "it was made for a machine with fingerprint 0x"),
    ("paper", "tiny", "it was made for a machine with fingerprint 0x"),
])
def test_another_machines_image_is_refused(made, read, said):
    machines = MACHINES | {"wide": V3_RECORDS.with_(records="wide")}
    with pytest.raises(InputError, match=f"^x.img is not accepted: {said}"):
        read_image(machines[read], image_bytes(image_of(machines[made]), SETTINGS), "x.img")


@pytest.mark.parametrize(("word", "value", "said"), [
    ("magic", 0x4D535632, "begins with 0x3249534D, not 0x4D535632"),
    ("version", IMAGE_VERSION + 1, f"version {IMAGE_VERSION + 1}, and version {IMAGE_VERSION} is read"),
    ("records", 9, "it holds format 9"), ("settings", 1 << 20, "are cut off after"), ("segments", 1 << 20, "are cut off after"),
    ("memory", 64, "or its 64 bytes of memory")])
def test_a_wrong_word_is_named(packed, word, value, said):
    with pytest.raises(InputError, match=said):
        read_image(V3_RECORDS, changed(packed, at(word), value))


@pytest.mark.parametrize("size", [0, 1, 3])
def test_a_file_without_a_magic_number_is_refused(packed, size):
    with pytest.raises(InputError, match=f"not {size} bytes"):
        read_image(V3_RECORDS, packed[:size])


def test_a_file_that_is_cut_off_is_refused(packed):
    tables = 4 * (len(HEAD) + 2 * len(SETTINGS) + 3 * 4)
    for size in (8, 40, 4 * len(HEAD), tables - 4, tables, len(packed) - 1):
        with pytest.raises(InputError, match=r"cut off|are beyond"):
            read_image(V3_RECORDS, packed[:size])
    assert read_image(V3_RECORDS, packed).head["segments"] == 4
