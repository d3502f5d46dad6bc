"""The pixel writer and the frame packer behind one set of ports."""

import numpy as np
import pytest

from rtl.pixels.frame_writer import FrameWriter
from spec.config import PAPER, TINY_V3
from spec.errors import InputError
from spec.memory import write_request
from spec.records import pixel_row
from tb.pixels.packer_stimuli import graded_pixels, packed_pixels, packed_writes
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


def test_machines_that_cannot_pack_are_refused():
    with pytest.raises(TypeError, match="config must be an AcceleratorConfig, not 'tiny'"):
        FrameWriter("tiny")
    with pytest.raises(ValueError, match="packed must be True in a machine with a frame packer, not False"):
        FrameWriter(PAPER)
    with pytest.raises(InputError, match="packed frames are not accepted with streams 4: blocks are packed with 1 stream"):
        FrameWriter(CONFIG.with_(streams=4))
