"""What a register is, and the registers of every machine: identity, commands and state. `spec.registers` has the map."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

from spec.codes import Code, ErrorCode, Phase
from spec.formats import Format

CONTROL_BASE = 0x020
"""Byte address of the first control register."""


class Access(Enum):
    """What the host may do with a register, and what a write does."""

    READ_ONLY = "read"
    READ_WRITE = "read, write"
    CLEARING = "read, write 1 to clear"


@dataclass(frozen=True)
class Bits:
    """Some bits of a register.

    Attributes:
        name: name of the bits.
        low: position of the lowest bit.
        width: number of bits.
        doc: what the bits mean.
        strobe: whether writing 1 triggers an action; such bits always read 0.
        values: the enumeration that the bits hold, if any.
    """

    name: str
    low: int
    width: int
    doc: str
    strobe: bool = False
    values: type[Code] | None = None

    @property
    def mask(self) -> int:
        """A mask of these bits in the register."""
        return (1 << self.width) - 1 << self.low


@dataclass(frozen=True)
class Register:
    """A register.

    Attributes:
        name: name in lower case, with underscores between words.
        offset: byte address in the register space.
        access: what the host may do with it.
        doc: what it holds.
        bits: its parts; where there are none, all 32 bits are one number.
        format: number format, where the register is a setting.
    """

    name: str
    offset: int
    access: Access
    doc: str
    bits: tuple[Bits, ...] = ()
    format: Format | None = None


IDENTITY = (
    Register("id", 0x000, Access.READ_ONLY, "0x4D535632 in every machine"),
    Register("version", 0x004, Access.READ_ONLY, "version of this map", (
        Bits("minor", 0, 16, "a higher one adds registers"), Bits("major", 16, 16, "a different one is not compatible"))),
    Register("fingerprint", 0x008, Access.READ_ONLY, "differs where machines differ in any parameter or number format"),
    Register("machine_array", 0x00C, Access.READ_ONLY, "parameters of the array", (
        Bits("cores_x", 0, 8, "pixel cores in a row"), Bits("cores_y", 8, 8, "rows of pixel cores"),
        Bits("levels", 16, 4, "foveation levels"), Bits("depth", 20, 1, "depth sums present"),
        Bits("incremental", 21, 1, "stages hand over incrementally"), Bits("counters", 22, 1, "counters present"),
        Bits("stereo", 23, 1, "frames of two eyes"), Bits("sh_degree", 24, 2, "highest degree of harmonics"),
        Bits("blend", 26, 1, "tiles may blend two levels, where the machine has more than one"),
        Bits("chunks", 27, 1, "Gaussians are read in chunks"), Bits("compact", 28, 1, "records are compact"),
        Bits("supertiles", 29, 1, "lists by super-tile; no splat record is stored"),
        Bits("packed", 30, 1, "frames for displays may be packed"),
        Bits("streams", 31, 1, "four arrays, each with a stream of its own"))),
    Register("machine_units", 0x010, Access.READ_ONLY, "parameters of the units around the array", (
        Bits("culling_units", 0, 8, "culling and conversion units"),
        Bits("joint", 8, 1, "frames of two eyes in one set of lists"),
        Bits("overlap", 9, 1, "the phases of two frames run side by side"),
        Bits("merge_ways", 16, 8, "runs merged at a time"),
        Bits("warp_lanes", 24, 8, "rows warped side by side; 0 without stereo"))),
    Register("machine_frame", 0x014, Access.READ_ONLY, "largest frame", (
        Bits("row_width", 0, 16, "widest row in pixels"),
        Bits("list_heads", 16, 15, "lists of a frame; 0 without super-tiles"),
        Bits("buckets", 31, 1, "super-tiles have several lists each, by depth"))),
    Register("machine_sort_buffer", 0x018, Access.READ_ONLY, "bytes of the double buffer before sorting"),
    Register("machine_cache", 0x01C, Access.READ_ONLY, "caches of what the array needs", (
        Bits("lines", 0, 18, "lines of the splat cache; with super-tiles, of the header cache"),
        Bits("batch_places", 18, 14, "splat records in each half of the batch buffer; 0 without super-tiles"))),
)
"""What a machine is, as the host reads it."""

CONTROL = (
    Register("control", CONTROL_BASE, Access.READ_WRITE, "commands", (
        Bits("start", 0, 1, "begin a frame; ignored while busy, or with overlapped phases where `ready` of `status` is 0",
             strobe=True),
        Bits("abort", 1, 1, "end the frame, or both, with error ABORTED; ignored unless busy", strobe=True),
        Bits("reset", 2, 1, "abort where busy; clear how the last frame ended: `done` and `error` of `status`, `error`, "
             "`bad_setting`, `interrupt`", strobe=True),
        Bits("clear", 3, 1, "set all counters to 0", strobe=True),
        Bits("enable_done", 8, 1, "interrupt when a frame is done"),
        Bits("enable_error", 9, 1, "interrupt when a frame ends with an error"))),
    Register("status", CONTROL_BASE + 0x4, Access.READ_ONLY, "state of the frame", (
        Bits("busy", 0, 1, "a frame is under way, or is being stopped"),
        Bits("done", 1, 1, "the last frame is in memory; cleared by the next start"),
        Bits("error", 2, 1, "the last frame ended early; cleared by the next start"),
        Bits("ready", 3, 1, "with overlapped phases: no frame is in its first phase, so that a start begins one"),
        Bits("phase", 8, 4, "what the machine is doing; with overlapped phases for the frame in its second phase",
             values=Phase),
        Bits("first_phase", 12, 4, "with overlapped phases: what it is doing for the frame in its first phase", values=Phase))),
    Register("error", CONTROL_BASE + 0x8, Access.READ_ONLY, "why the last frame ended early", (
        Bits("code", 0, 8, "cleared by the next start; with overlapped phases that of the frame in its second phase",
             values=ErrorCode),
        Bits("first_code", 8, 8, "with overlapped phases: that of the frame in its first phase, or of one that did not begin",
             values=ErrorCode))),
    Register("bad_setting", CONTROL_BASE + 0xC, Access.READ_ONLY,
             "with BAD_SETTING: number of the first setting that is out of its limits, counted from 0 in their order"),
    Register("error_clients", CONTROL_BASE + 0x10, Access.READ_ONLY, "clients whose accesses memory answered with an error"),
    Register("interrupt", CONTROL_BASE + 0x14, Access.CLEARING, "pending causes of an interrupt, whether or not enabled", (
        Bits("done", 0, 1, "a frame is done"), Bits("error", 1, 1, "a frame ended with an error"))),
)
"""Commands, state and errors. `error_clients` has a bit for each memory client of a machine."""
