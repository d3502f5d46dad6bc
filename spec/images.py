"""The file format of a frame image: what the machine's memory and settings hold when a frame starts.

A file holds little-endian words of 32 bits: a head (HEAD), the settings (offset and value of each register), a table of
segments (byte address, bytes, place in the file), and the segments' contents. Addresses count from 0; whoever loads the image
adds the address at which it lies in memory. `golden.host.image_file` writes and reads it, examples/driver/msv2_driver.c reads
it.

An image fits one machine. Three words tell what it fits: VERSION, the record format, by which whole images can be told apart
even where machines differ only in number formats, and the machine's fingerprint.
"""

from __future__ import annotations

from spec.config import AcceleratorConfig

IMAGE_MAGIC = 0x3249534D
"""The first word of an image: "MSI2"."""

IMAGE_VERSION = 3
"""The second word. Version 1 had settings without offsets, version 2 no record format."""

RECORD_FORMATS = ("wide records", "wide records in chunks", "compact records in chunks")
"""Formats in which Gaussians lie in memory, by number."""

HEAD = (
    "magic", "version", "records", "fingerprint", "settings", "segments", "width", "height", "pixel_bytes", "frame", "memory")
"""Words of the head: `records` is the number of the record format, `settings` and `segments` are counts, width and height are
pixels, `pixel_bytes` is 0 where the frame is packed, `frame` is the byte address of the frame's pixels, and `memory` the number
of bytes of memory that the frame needs."""


def record_format(config: AcceleratorConfig) -> int:
    """The number of the format in which a machine reads Gaussians."""
    return 2 if config.compact else int(config.chunks)
