"""Packed frames: what is packed is what the text says, everything comes back bit for bit, and damage is named."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from golden.host.packed_frame import block_checks, by_block, in_frame, unpack_blocks, unpack_frame
from golden.msv2_ref.frame_memory import display_pixels
from golden.msv2_ref.frame_packing import PackedFrame, display_bytes, pack_frame
from golden.msv2_ref.pipeline import render
from golden.scenes.embedded.splats import cached_embedded_model
from golden.scenes.embedded.views import embedded_cameras
from spec import packed as text
from spec.config import TINY
from spec.constants import TILE
from spec.errors import InputError
from spec.memory import BEAT_BYTES
from spec.packed import BLOCKS, SLOT_BEATS, PackedError, block_size, packed_beats, packed_entry, packed_header, table_beat
from tests.helpers.packed_by_the_text import block_by_the_text, check_by_the_text

SIZES = ((1, 1), (16, 16), (17, 3), (31, 33), (64, 20), (5, 49))
QUICK = settings(max_examples=40, derandomize=True, deadline=None, database=None)


def drawn(seed: int, width: int, height: int, kind: str) -> np.ndarray:
    """A frame: noise, a slope with a little noise, one colour, edges, or the largest differences of either sign."""
    rng, y, x = np.random.default_rng(seed), *np.indices((height, width))
    shape = (height, width, 4)
    if kind == "noise":
        return rng.integers(0, 256, shape, np.uint8)
    if kind == "slope":
        slope = (x * rng.integers(0, 9) + y * rng.integers(0, 9))[..., None] + rng.integers(0, 1 << rng.integers(0, 8), shape)
        return slope.astype(np.uint8)
    if kind == "plain":
        return np.broadcast_to(rng.integers(0, 256, 4, np.uint8), shape).copy()
    if kind == "edges":
        return np.where(((x // rng.integers(1, 20) + y // rng.integers(1, 9)) % 2)[..., None] > 0, rng.integers(0, 256, 4),
                        rng.integers(0, 256, 4)).astype(np.uint8)
    return np.where(((x + y) % 2)[..., None] > 0, 255 * rng.integers(0, 2, 4), 127 + rng.integers(0, 2, 4)).astype(np.uint8)


KINDS = ("noise", "slope", "plain", "edges", "extremes")
FRAMES = st.builds(drawn, st.integers(0, 1 << 30), st.integers(1, 70), st.integers(1, 40), st.sampled_from(KINDS))


def bytes_of(frame: PackedFrame) -> np.ndarray:
    """The frame's region, in a memory that held other things before."""
    region = np.random.default_rng(1).integers(0, 256, frame.region().shape, np.uint8)
    beats = region[: table_beat(frame.width, frame.height)].reshape(-1, SLOT_BEATS, BEAT_BYTES)
    written = np.arange(SLOT_BEATS) < frame.sizes[:, None]
    beats[written] = frame.slots[written]
    region[table_beat(frame.width, frame.height):] = frame.table()
    return region.reshape(-1)


@QUICK
@given(FRAMES)
def test_every_frame_comes_back(pixels: np.ndarray) -> None:
    height, width = pixels.shape[:2]
    assert (unpack_frame(bytes_of(pack_frame(pixels)), width, height) == pixels).all()


@QUICK
@given(FRAMES)
def test_blocks_are_what_the_text_says(pixels: np.ndarray) -> None:
    height, width = pixels.shape[:2]
    frame = pack_frame(pixels)
    whole = np.zeros((-(-height // TILE) * TILE, -(-width // TILE) * TILE, 4), np.int64)
    whole[:height, :width] = pixels
    for number, (block, inside) in enumerate(zip(by_block(whole).tolist(), in_frame(width, height).tolist(), strict=True)):
        data, check = block_by_the_text(
            [[pixel if there else None for pixel, there in zip(*row, strict=True)] for row in zip(block, inside, strict=True)],
            number)
        assert frame.slots[number].tobytes() == data.ljust(BEAT_BYTES * SLOT_BEATS, b"\0")
        assert (frame.sizes[number], frame.checks[number]) == (len(data) // BEAT_BYTES, check)


def test_every_width_of_a_group_is_reached_and_decoded() -> None:
    """Groups whose largest difference is any of -128..127."""
    pixels = np.zeros((4 * 256, 16, 4), np.uint8)
    pixels[::4, 5:, 1] = np.arange(256, dtype=np.uint8)[:, None]
    frame = pack_frame(pixels)
    assert (unpack_frame(bytes_of(frame), 16, 1024) == pixels).all()
    # the difference of green in the second group of row 0 and back in row 1, and of red and blue with the other sign
    wanted = [min(n for n in (*range(7), 8) if -(1 << n >> 1) <= v < max(1, 1 << n >> 1)) for v in range(-128, 128)]
    bits = np.unpackbits(frame.slots[:, 0, 4:16], axis=1, bitorder="little").reshape(256, 32, 3) @ (1, 2, 4)
    assert [8 if code == 7 else code for code in np.roll(bits[:, 1], 128).tolist()] == wanted


@pytest.mark.parametrize("kind", ["noise", "extremes"])
def test_noise_costs_at_most_three_percent(kind: str) -> None:
    pixels = drawn(0, 320, 192, kind)
    frame = pack_frame(pixels)
    share = frame.moved_beats * BEAT_BYTES / pixels.size
    assert share <= 1.03 and (kind != "noise" or (frame.sizes == SLOT_BEATS).all())


def test_a_frame_of_one_colour_takes_a_beat_a_block() -> None:
    frame = pack_frame(drawn(0, 64, 32, "plain"))
    assert (frame.sizes == 1).all() and frame.moved_beats == 32 + 2


def test_rendered_frames_come_back_and_are_smaller() -> None:
    frame = render(cached_embedded_model(), embedded_cameras(320, 180)[0], config=TINY.with_(row_width=320))
    pixels = display_bytes(display_pixels(frame))
    done = pack_frame(pixels)
    assert (unpack_frame(bytes_of(done), 320, 180) == pixels).all()
    assert done.moved_beats * BEAT_BYTES < 0.62 * pixels.size
    assert (done.sizes.reshape(-1, BLOCKS)[-20:, 1:] == 0).all()  # 180 = 11 * 16 + 4 rows


def test_every_wrong_bit_is_noticed_and_named() -> None:
    """Every bit of every used beat and entry; the same one in all blocks at once."""
    pixels = np.concatenate([drawn(3, 16, 16, "slope"), drawn(4, 16, 9, "noise")])
    frame, (height, width) = pack_frame(pixels), pixels.shape[:2]
    data, count, slot = bytes_of(frame), len(frame.sizes), BEAT_BYTES * SLOT_BEATS
    assert {*frame.sizes.tolist()} >= {0, SLOT_BEATS} and ((frame.sizes > 0) & (frame.sizes < SLOT_BEATS)).any()
    places = [(n, slot, frame.sizes * BEAT_BYTES > n) for n in range(slot)]
    places += [(slot * count + n, 2, np.full(count, True)) for n in range(2)]
    kinds = set()
    for begin, step, used in places:
        at = begin + step * np.flatnonzero(used)
        for bit in range(8):
            data[at] ^= 1 << bit
            errors = unpack_blocks(data, width, height)[1]
            data[at] ^= 1 << bit
            assert ((errors > 0) == used).all(), f"bit {bit} of byte {begin}"
            kinds |= {PackedError(error) for error in errors.tolist()}
    assert kinds == {*PackedError}
    assert not unpack_blocks(data, width, height)[1].any()


def test_pairs_of_wrong_bits_and_bursts_are_noticed() -> None:
    frame = pack_frame(drawn(0, 16, 4, "noise"))
    data, rng = bytes_of(frame), np.random.default_rng(0)
    bits = 8 * BEAT_BYTES * SLOT_BEATS
    wrong = [rng.choice(bits, 2, replace=False) for _ in range(300)]
    wrong += [at + np.flatnonzero(np.r_[1, rng.integers(0, 2, 10), 1]) for at in rng.integers(0, bits - 12, 300)]
    for places in wrong:
        bad = data.copy()
        np.bitwise_xor.at(bad, places // 8, (1 << places % 8).astype(np.uint8))
        assert unpack_blocks(bad, 16, 4)[1].tolist() == [PackedError.CHECK, 0, 0, 0]


def test_what_else_can_happen_to_a_frame_is_noticed() -> None:
    old, new = (pack_frame(drawn(seed, 64, 16, "slope")) for seed in (1, 2))
    data, table = bytes_of(new), BEAT_BYTES * table_beat(64, 16)

    def errors(change) -> list[int]:
        bad = data.copy()
        change(bad)
        return unpack_blocks(bad, 64, 16)[1].tolist()

    def lost(bad: np.ndarray) -> None:
        bad[BEAT_BYTES * SLOT_BEATS * 5 :][: BEAT_BYTES] = old.slots[5, 0]

    def exchanged(bad: np.ndarray) -> None:
        slot = BEAT_BYTES * SLOT_BEATS
        bad[:slot], bad[slot : 2 * slot] = data[slot : 2 * slot], data[:slot]
        bad[table : table + 2], bad[table + 2 : table + 4] = data[table + 2 : table + 4], data[table : table + 2]

    def unwritten(bad: np.ndarray) -> None:
        bad[table:] = 0

    def every_size(bad: np.ndarray) -> None:
        bad[table:] |= 15

    assert errors(lost)[5] in (PackedError.LENGTH, PackedError.CHECK) and sum(error > 0 for error in errors(lost)) == 1
    assert [error > 0 for error in errors(exchanged)] == [True] * 2 + [False] * 14
    assert errors(unwritten) == [PackedError.MISSING] * 16
    assert errors(every_size) == [PackedError.SIZE] * 16


@pytest.mark.parametrize(("width", "height"), SIZES)
def test_a_frame_that_is_cut_off_is_named(width: int, height: int) -> None:
    data = bytes_of(pack_frame(drawn(0, width, height, "slope")))
    assert len(data) == BEAT_BYTES * packed_beats(width, height)
    for kept in (0, 1, BEAT_BYTES, len(data) // 2, len(data) - 1):
        with pytest.raises(InputError, match=f"{width}x{height} pixels is not accepted: it is cut off after {kept:,} bytes"):
            unpack_frame(data[:kept], width, height)


def test_the_first_damaged_block_is_told() -> None:
    data = bytes_of(pack_frame(drawn(0, 40, 20, "slope")))
    data[BEAT_BYTES * SLOT_BEATS * 6] ^= 1
    wanted = ("packed frame of 40x20 pixels is not accepted: block 6 (columns 16 to 31, rows 8 to 11): CHECK, its beats are "
              "not those that were packed; 1 of 24 blocks are damaged")
    with pytest.raises(InputError, match=re.escape(wanted)):
        unpack_frame(data, 40, 20)


def test_the_other_blocks_of_a_damaged_frame_are_right() -> None:
    pixels = drawn(0, 32, 16, "slope")
    data = bytes_of(pack_frame(pixels))
    data[BEAT_BYTES * table_beat(32, 16) + 2] |= 15  # the size of block 1: rows 4 to 7 of the first tile
    found, errors = unpack_blocks(data, 32, 16)
    assert np.flatnonzero(errors).tolist() == [1] and not found[4:8, :16].any()
    pixels[4:8, :16] = 0
    assert (found == pixels).all()


def test_the_check_is_that_of_the_text_for_any_number() -> None:
    rng = np.random.default_rng(0)
    slots, sizes = rng.integers(0, 256, (20, BEAT_BYTES * SLOT_BEATS), np.uint8), rng.integers(0, SLOT_BEATS + 1, 20)
    numbers = rng.integers(0, 1 << text.BLOCK_BITS, 20)
    wanted = [check_by_the_text(slot[: BEAT_BYTES * size].tobytes(), number) if size else 0
              for slot, size, number in zip(slots, sizes.tolist(), numbers.tolist(), strict=True)]
    assert block_checks(slots, sizes, numbers).tolist() == wanted


def test_the_polynomial_is_primitive() -> None:
    """Its period exceeds the bits of a block and its check, so that no two wrong bits cancel."""
    state, period = 1, 0
    while state != 1 or not period:
        state = state << 1 ^ ((1 << text.CHECK_BITS | text.CHECK_POLYNOMIAL) if state >> text.CHECK_BITS - 1 else 0)
        period += 1
    assert period == (1 << text.CHECK_BITS) - 1 > 8 * BEAT_BYTES * SLOT_BEATS + text.CHECK_BITS


def test_records_and_sizes() -> None:
    assert packed_entry(TINY).width == text.ENTRY_BITS and packed_header(TINY).width == 8 * text.HEADER_BYTES
    assert [block_size(planes) for planes in (0, 16, 17, text.PLANES_MOST, text.PLANES_MOST + 1, 256)] == [1, 1, 2, 7, 8, 8]
    assert packed_beats(1920, 1080) == 120 * 68 * 32 + 120 * 68 // 4 and packed_beats(1, 1) == 33
    assert table_beat(17, 16) == 64
    assert max(PackedError) == 4 and text.BLOCK_BITS == 22
