"""The C unpacker of packed frames: it gives what the Python one gives, of whole frames and of damaged ones."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
import time

import numpy as np
import pytest

from golden.host.packed_frame import unpack_blocks
from golden.msv2_ref.frame_packing import pack_frame
from spec.memory import BEAT_BYTES
from spec.packed import BLOCKS, SLOT_BEATS, PackedError, packed_beats, table_beat
from spec.paths import ROOT

DRIVER = ROOT / "examples" / "driver"
WARNINGS = ("-std=c99", "-O2", "-Wall", "-Wextra", "-Wpedantic", "-Wconversion", "-Wshadow", "-Wstrict-prototypes", "-Werror")
WHOLE, DAMAGED, CUT_OFF = range(3)

pytestmark = pytest.mark.skipif(shutil.which("gcc") is None, reason="needs gcc")


class Damage(ctypes.Structure):
    """struct msv2_packed_damage."""

    _fields_ = [(name, ctypes.c_uint32) for name in ("blocks", "block", "x", "y", "error")]


@pytest.fixture(scope="module")
def library(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    """The unpacker as a shared library, compiled as strict C99 with all warnings as errors."""
    built = tmp_path_factory.mktemp("packed") / "packed.so"
    subprocess.run(["gcc", *WARNINGS, "-shared", "-fPIC", DRIVER / "msv2_packed.c", "-o", built], check=True)
    return ctypes.CDLL(str(built))


def unpacked(library: ctypes.CDLL, data: np.ndarray, width: int, height: int) -> tuple[int, np.ndarray, Damage]:
    """Result, pixels with a guard behind them, and damage."""
    pixels, damage = np.full(4 * width * height + 64, 0xA5, np.uint8), Damage()
    result = library.msv2_unpack_frame(
        data.tobytes(), len(data), width, height, ctypes.c_void_p(pixels.ctypes.data), ctypes.byref(damage))
    assert (pixels[4 * width * height :] == 0xA5).all()
    return result, pixels[: 4 * width * height].reshape(height, width, 4), damage


def drawn(rng: np.random.Generator, width: int, height: int) -> np.ndarray:
    """A frame whose blocks have all sizes: noise of amplitudes that grow from left to right, on a slope."""
    y, x = np.indices((height, width))
    most = np.ceil(2 ** (8 * (x + 1) / width)).astype(np.int64)[..., None]
    return (3 * x[..., None] + 5 * y[..., None] + rng.integers(0, 1 << 16, (height, width, 4)) % most).astype(np.uint8)


@pytest.mark.parametrize(("width", "height"), [(1, 1), (16, 16), (17, 3), (200, 33), (640, 90), (5, 49)])
def test_frames_come_back(library: ctypes.CDLL, width: int, height: int) -> None:
    rng = np.random.default_rng(width)
    pixels = drawn(rng, width, height)
    frame = pack_frame(pixels)
    assert width < 200 or {*frame.sizes.tolist()} >= {3, 4, 5, 6, 7, 8}
    result, found, damage = unpacked(library, frame.region().reshape(-1), width, height)
    assert (result, damage.blocks, damage.error) == (WHOLE, 0, PackedError.NONE) and (found == pixels).all()


def test_damage_is_named_as_in_python(library: ctypes.CDLL) -> None:
    """Random bytes in random places: pixels and the first damaged block are Python's."""
    rng, (width, height) = np.random.default_rng(0), (150, 41)
    whole = pack_frame(drawn(rng, width, height)).region().reshape(-1)
    table, kinds = BEAT_BYTES * table_beat(width, height), set()
    for n in range(200):
        data = whole.copy()
        places = rng.integers(0, table, 3) // 256 * 256 + rng.integers(0, 16, 3) if n % 2 else table + rng.integers(0, 240, 2)
        data[places] = rng.choice([0, 1 << n % 8, 255, 8, 7, 3], len(places))
        wanted, errors = unpack_blocks(data, width, height)
        result, found, damage = unpacked(library, data, width, height)
        first = np.flatnonzero(errors)
        assert (found == wanted).all() and (result, damage.blocks) == (DAMAGED if len(first) else WHOLE, len(first))
        if len(first):
            tile, part = divmod(int(first[0]), BLOCKS)
            assert (damage.block, damage.error) == (first[0], errors[first[0]])
            assert (damage.x, damage.y) == (tile % 10 * 16, tile // 10 * 16 + 4 * part)
        kinds |= {PackedError(error) for error in errors.tolist()}
    assert kinds == {*PackedError}


def test_frames_that_are_cut_off_are_refused(library: ctypes.CDLL) -> None:
    data = pack_frame(drawn(np.random.default_rng(0), 40, 20)).region().reshape(-1)
    for kept in (0, 1, len(data) // 2, len(data) - 1):
        result, found, damage = unpacked(library, data[:kept], 40, 20)
        assert result == CUT_OFF and (found == 0xA5).all() and damage.blocks == 0
    assert library.msv2_unpack_frame(data.tobytes(), len(data), 0, 20, None, None) == CUT_OFF


def test_sizes(library: ctypes.CDLL) -> None:
    library.msv2_packed_bytes.restype = ctypes.c_uint32
    for width, height in ((1, 1), (16, 17), (1920, 1080), (16383, 16383)):
        assert library.msv2_packed_bytes(width, height) == BEAT_BYTES * packed_beats(width, height)
    for width, height in ((0, 5), (5, 0), (1 << 16, 1 << 16), (0xFFFFFFFF, 0xFFFFFFFF)):
        assert library.msv2_packed_bytes(width, height) == 0


def test_a_block_alone(library: ctypes.CDLL) -> None:
    frame, pixels = pack_frame(drawn(np.random.default_rng(1), 16, 4)), np.zeros(BEAT_BYTES * SLOT_BEATS, np.uint8)
    block = frame.slots[0].tobytes(), int(frame.entries()[0])
    assert library.msv2_unpack_block(*block, 0, ctypes.c_void_p(pixels.ctypes.data)) == PackedError.NONE
    assert (pixels.reshape(4, 16, 4) == drawn(np.random.default_rng(1), 16, 4)).all()
    assert library.msv2_unpack_block(*block, 1, ctypes.c_void_p(pixels.ctypes.data)) == PackedError.CHECK


def test_full_hd_takes_a_fraction_of_a_second(library: ctypes.CDLL) -> None:
    pixels = drawn(np.random.default_rng(2), 1920, 1080)
    data = pack_frame(pixels).region().reshape(-1)
    begin = time.process_time()
    result, found, _ = unpacked(library, data, 1920, 1080)
    assert time.process_time() - begin < 1 and result == WHOLE and (found == pixels).all()
