"""The memory of frames that are in flight two at a time, in machines whose phases overlap.

While a frame is rendered, the lists of the next one are written, so that whatever belongs to a frame lies at one of two places
in turn. A place is free again when the frame that has it has ended, and so when the frame after the next one may start.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from golden.host.memory_image import MemoryImage, Region

PLACES = 2
"""Places in memory that frames take in turn."""


def in_turn(images: Sequence[MemoryImage]) -> tuple[list[MemoryImage], int]:
    """Moves the images of frames in a row to two places in turn, and returns them with the first beat that the machine may
    write. What the host fills of both places comes first.

    Args:
        images: the images, each as if it were alone in memory.
    """
    filled = max(image.first_writable for image in images)
    written = max(image.beats - image.first_writable for image in images)
    moved = []
    for number, image in enumerate(images):
        place = number % PLACES
        by = {True: place * filled, False: PLACES * filled + place * written - image.first_writable}
        regions = {name: Region(region.base + by[name in image.contents], region.beats)
                   for name, region in image.regions.items()}
        bases = {f"{name}_base": region.base for name, region in regions.items()}
        moved.append(replace(image, regions=regions, settings=image.settings | bases))
    return moved, PLACES * filled
