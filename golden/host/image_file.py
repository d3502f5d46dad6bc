"""Frame images as files (`spec.images`): all that a machine needs for a frame, in one file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from golden.host.memory_image import MemoryImage
from spec.config import AcceleratorConfig
from spec.errors import InputError
from spec.images import HEAD, IMAGE_MAGIC, IMAGE_VERSION, RECORD_FORMATS, record_format
from spec.memory import BEAT_BYTES
from spec.registers import fingerprint


@dataclass(frozen=True)
class ImageFile:
    """What a frame image holds.

    Attributes:
        head: the words of the head, by the names in HEAD.
        settings: values of registers by their offsets.
        segments: contents of memory, uint8, by byte address.
    """

    head: dict[str, int]
    settings: dict[int, int]
    segments: dict[int, np.ndarray]


def image_bytes(image: MemoryImage, settings: Mapping[int, int]) -> bytes:
    """The file's contents for a frame's memory image and the values of its registers by their offsets."""
    segments = {name: rows for name, rows in image.contents.items() if len(rows)}
    words = {
        "magic": IMAGE_MAGIC, "version": IMAGE_VERSION, "records": record_format(image.config),
        "fingerprint": fingerprint(image.config), "settings": len(settings), "segments": len(segments), "width": image.width,
        "height": image.height, "pixel_bytes": image.pixel_bytes, "frame": BEAT_BYTES * image.regions["frame"].base,
        "memory": BEAT_BYTES * image.beats}
    place, table = 4 * (len(HEAD) + 2 * len(settings) + 3 * len(segments)), []
    for name, rows in segments.items():
        table += [BEAT_BYTES * image.regions[name].base, rows.nbytes, place]
        place += rows.nbytes
    numbers = [*(words[name] for name in HEAD), *(number for pair in settings.items() for number in pair), *table]
    return np.array(numbers, "<u4").tobytes() + b"".join(rows.tobytes() for rows in segments.values())


def read_image(config: AcceleratorConfig, data: bytes, name: str = "image") -> ImageFile:
    """The frame image in a file's contents.

    Args:
        config: the machine that is to render it.
        data: the file's contents.
        name: what the messages call the file.

    Raises:
        InputError: the data is no frame image, is one of another version, was made for another record format or another
            machine, or is cut off.
    """
    def refuse(why: str) -> InputError:
        return InputError(f"{name} is not accepted: {why}")

    words = np.frombuffer(data, "<u4", count=len(data) // 4).astype(np.int64)
    if len(words) < 2 or words[0] != IMAGE_MAGIC:
        found = f"0x{words[0]:08X}" if len(words) else f"{len(data)} bytes"
        raise refuse(f"a frame image begins with 0x{IMAGE_MAGIC:08X}, not {found}")
    if words[1] != IMAGE_VERSION:
        raise refuse(f"it is a frame image of version {words[1]}, and version {IMAGE_VERSION} is read; write it anew")
    if len(words) < len(HEAD):
        raise refuse(f"its head is cut off after {len(data)} bytes")
    head = {word: int(value) for word, value in zip(HEAD, words, strict=False)}
    wanted = record_format(config)
    if head["records"] != wanted:
        found = RECORD_FORMATS[head["records"]] if head["records"] < len(RECORD_FORMATS) else f"format {head['records']}"
        raise refuse(f"it holds {found}, and config {config.name!r} reads {RECORD_FORMATS[wanted]}")
    if head["fingerprint"] != fingerprint(config):
        raise refuse(f"it was made for a machine with fingerprint 0x{head['fingerprint']:08X}, and that of config "
                     f"{config.name!r} is 0x{fingerprint(config):08X}")
    table = len(HEAD) + 2 * head["settings"]
    end = table + 3 * head["segments"]
    if len(words) < end:
        raise refuse(f"its tables of {4 * end} bytes are cut off after {len(data)} bytes")
    settings = {int(offset): int(value) for offset, value in words[len(HEAD) : table].reshape(-1, 2)}
    segments = {}
    for address, count, place in words[table:end].reshape(-1, 3).tolist():
        if place + count > len(data) or address + count > head["memory"]:
            raise refuse(f"{count} bytes at {place} of the file, for address {address}, are beyond its {len(data)} bytes or "
                         f"its {head['memory']} bytes of memory")
        segments[address] = np.frombuffer(data, np.uint8, count, place)
    return ImageFile(head, settings, segments)
