"""Writes the array's rows of pixels to memory, unpacked or as a packed frame."""

from __future__ import annotations

from amaranth.hdl import Module, Mux, Value
from amaranth.lib import wiring

from rtl.pixels.frame_packer import FramePacker
from rtl.vrc_array.pixel_writer import PixelWriter, frame_writer_ports
from spec.config import AcceleratorConfig

_SETTINGS = ("width", "height", "display", "frame_base", "packed")
_JOINT = ("joint", "target_frame_base")


def check_packed(config: AcceleratorConfig) -> None:
    """Raises where a machine cannot pack frames.

    Raises:
        ValueError: the machine has no frame packer, or it has several streams: the packer takes the rows that they give
            together (`spec.supertiles.frame_rows`).
    """
    if not config.packed:
        raise ValueError(f"packed must be True in a machine with a frame packer, not {config.packed!r}")
    if config.streams > 1:
        raise ValueError(f"streams must be 1 for rows of a frame, not {config.streams!r}: spec.supertiles.frame_rows")


class FrameWriter(wiring.Component):
    """`PixelWriter` and `FramePacker` behind one set of ports.

    Parameters:
        config: the machine, with `packed`.

    Ports:
        packed: setting of the frame; 1: the packer takes the rows. Stable from `begin` to `finished`.

    The other ports, storage, throughput and latency are those of the unit that `packed` selects. Nothing is registered here.
    """

    def __init__(self, config: AcceleratorConfig):
        if not isinstance(config, AcceleratorConfig):
            raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
        check_packed(config)
        self._plain, self._packer = PixelWriter(config), FramePacker(config)
        super().__init__(frame_writer_ports(config, _SETTINGS))

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.plain, m.submodules.packer = self._plain, self._packer
        plain, packer = self._plain, self._packer
        units: tuple[tuple[PixelWriter | FramePacker, Value], ...] = ((plain, ~self.packed), (packer, self.packed))
        for unit, mine in units:
            for name in unit.signature.members:
                if name in (*_SETTINGS, *_JOINT, "tile_count", "begin", "writes_idle"):
                    m.d.comb += getattr(unit, name).eq(getattr(self, name))
            m.d.comb += [
                unit.rows.payload.eq(self.rows.payload), unit.rows.valid.eq(self.rows.valid & mine),
                unit.writes.ready.eq(self.writes.ready)]
        m.d.comb += [
            self.rows.ready.eq(Mux(self.packed, packer.rows.ready, plain.rows.ready)),
            self.writes.payload.eq(Mux(self.packed, packer.writes.payload, plain.writes.payload)),
            self.writes.valid.eq(plain.writes.valid | packer.writes.valid),  # of the other unit nothing is inside
            self.pixels.eq(Mux(self.packed, packer.pixels, plain.pixels)),
            self.finished.eq(Mux(self.packed, packer.finished, plain.finished)),
            self.busy.eq(plain.busy | packer.busy)]
        return m
