"""Named numbers that the host's registers hold (`spec.registers`)."""

from __future__ import annotations

from enum import IntEnum


class Code(IntEnum):
    """Named numbers that a register holds."""

    @classmethod
    def width(cls) -> int:
        """Number of bits that the largest of them needs."""
        return max(cls).bit_length()


class Phase(Code):
    """What the machine is doing."""

    IDLE = 0
    """The machine is ready for `start`."""
    CLEAR = 1
    """The units clear their state of the frame before."""
    TABLE = 2
    """The machine reads the table of tiles."""
    GEOMETRY = 3
    """Projection and tile test of all Gaussians, and their colours, which with super-tiles belong to the next phase."""
    RENDER = 4
    """Merging, sorting and blending of all tiles."""
    DRAIN = 5
    """The frame has failed; the machine waits for outstanding answers of memory."""
    RESET = 6
    """The frame has failed; the machine resets all units."""
    WAIT = 7
    """With overlapped phases: the frame's lists are in memory, and the frame before is still in its second phase."""


class ErrorCode(Code):
    """Why a frame ended early, or did not begin."""

    NONE = 0
    """No error."""
    BAD_SETTING = 1
    """A setting is out of its limits; `bad_setting` says which. The frame did not begin."""
    READ_ERROR = 2
    """Memory answered a read with an error; `error_clients` names the client."""
    WRITE_ERROR = 3
    """Memory answered a write with an error; `error_clients` names the client."""
    ENTRIES_FULL = 4
    """The intersections of all tiles need more beats than `entries_beats`."""
    SPILL_FULL = 5
    """The spilled runs need more beats than `spill_beats`."""
    COUNT_SATURATED = 6
    """A tile, or a group of tiles, has more intersections than can be counted or addressed."""
    ABORTED = 7
    """`control.abort` ended the frame."""
    WATCHDOG = 8
    """No beat of memory moved for 2^24 cycles."""
