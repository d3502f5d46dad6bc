"""The pixel writer and the frame packer behind one set of ports."""

import numpy as np
import pytest

from rtl.pixels.frame_writer import FrameWriter
from spec.config import PAPER, TINY_V3
from spec.memory import write_request
from spec.records import pixel_row
from tb.pixels.packer_stimuli import graded_pixels, joint_packed_writes, packed_pixels, packed_writes
from tb.vrc_array.pixel_writer_stimuli import rows_of, writes_of
from tests.helpers.rtl_streams import exchange

CONFIG = TINY_V3.with_(name="tiny_v3_packed", packed=True)


@pytest.mark.parametrize("display", [0, 1])
@pytest.mark.parametrize("packed", [0, 1])
def test_the_setting_says_which_of_them_writes(packed, display):
    if packed and not display:
        pytest.skip("a packed frame has display pixels")
    rng = np.random.default_rng(packed)
    frame = graded_pixels(CONFIG, rng, 30, 19)
    rows, dut = rows_of(CONFIG, frame, rng), FrameWriter(CONFIG)
    wanted = (packed_writes(CONFIG, packed_pixels(CONFIG, frame), [0, 1, 2, 3], 7) if packed else
              writes_of(CONFIG, frame, rows, 7, bool(display)))

    def setup(ctx):
        for port, value in ((dut.width, 30), (dut.height, 19), (dut.frame_base, 7), (dut.tile_count, 4), (dut.packed, packed),
                            (dut.display, display)):
            ctx.set(port, value)

    got, _ = exchange(dut, {dut.rows: [pixel_row(CONFIG).pack(row) for row in rows]}, dut.writes, len(wanted), setup=setup)
    assert got == [write_request(CONFIG).pack(row) for row in wanted]


@pytest.mark.parametrize("display", [0, 1])
@pytest.mark.parametrize("packed", [0, 1])
def test_both_eyes_of_a_joint_frame_have_frames_of_their_own(packed, display):
    """Their tiles come by turns: two of the source, one of the target, and so on, which share beats of neither table."""
    if packed and not display:
        pytest.skip("a packed frame has display pixels")
    config, rng = CONFIG.with_(joint=True), np.random.default_rng(packed)
    eyes, bases = [graded_pixels(config, rng, 76, 19) for _ in range(2)], (7, 3000)
    order = [(0, 0), (0, 1), (1, 0), (0, 2), (0, 3), (1, 1), (1, 2), (1, 3), (1, 4), (0, 4), *(
        (eye, tile) for tile in range(5, 10) for eye in (1, 0))]
    by_tile = []
    for eye, frame in enumerate(eyes):
        rows = rows_of(config, frame, rng)
        rows["eye"] = eye
        by_tile.append(rows.reshape(10, -1))
    rows, dut = np.concatenate([by_tile[eye][tile] for eye, tile in order]), FrameWriter(config)
    wanted = (joint_packed_writes(config, [packed_pixels(config, frame) for frame in eyes], order, bases) if packed else
              np.concatenate([writes_of(config, eyes[eye], by_tile[eye][tile], bases[eye], bool(display))
                              for eye, tile in order]))

    def setup(ctx):
        for port, value in ((dut.width, 76), (dut.height, 19), (dut.frame_base, 7), (dut.target_frame_base, 3000),
                            (dut.joint, 1), (dut.tile_count, 10), (dut.packed, packed), (dut.display, display)):
            ctx.set(port, value)

    got, _ = exchange(dut, {dut.rows: [pixel_row(config).pack(row) for row in rows]}, dut.writes, len(wanted), setup=setup)
    assert got == [write_request(config).pack(row) for row in wanted]


def test_machines_that_cannot_pack_are_refused():
    with pytest.raises(TypeError, match="config must be an AcceleratorConfig, not 'tiny'"):
        FrameWriter("tiny")
    with pytest.raises(ValueError, match="packed must be True in a machine with a frame packer, not False"):
        FrameWriter(PAPER)
    with pytest.raises(ValueError, match="streams must be 1 for rows of a frame, not 4"):
        FrameWriter(CONFIG.with_(streams=4))
