"""The host's registers: one description for the RTL, the page docs/registers.md, the C header and the drivers.

32-bit registers, little-endian, in 4 KB of byte addresses. Reserved bits read 0 and ignore writes. A write to a read-only
register, and any access where no register is, is answered with SLVERR and has no effect.

    0x000  identity: what machine this is
    0x020  control, status, errors, interrupts
    0x100  settings of the frame, a register a number, in the order of `spec.memory.frame_settings`
    0x400  counters
    0x600  counters of saturated values

**A frame.** Write the settings, then `control.start`. The machine checks the settings, takes a copy of all of them and is
busy; from then on the host may write those of the next frame. The frame ends with `status.done`, or with `status.error` and
a code. `start` is ignored while the machine is busy.

**Values.** A setting stands in the lowest bits of its register, in its own number format: two's complement where the format
is signed fixed-point, the bit pattern where it is a small float. Bits above are ignored; they read as the sign of signed
fixed-point numbers, so that an int32 comes back as it was written, and as 0 otherwise.

**Counters** count from `control.clear` on, over as many frames as follow. A counter of 64 bits has two registers; reading
the lower one keeps the upper half of the same moment for the next read of the upper one.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from enum import Enum, IntEnum

from spec.config import AcceleratorConfig
from spec.formats import Fixed, Format, SmallFloat
from spec.host_settings import limits, settings
from spec.saturations import SATURATIONS
from spec.stages import StagePhase, watched

REGISTER_ADDRESS_BITS = 12
"""Byte addresses of the register space."""

MAGIC = 0x4D535632
"""What register `id` reads: "MSV2"."""

VERSION_MAJOR, VERSION_MINOR = 2, 0
"""Of this map. A higher minor version only adds registers; machines with stereo have the next one, which is odd. Version 1 had
a field `sorting_units` in bits 15:8 of `machine_units`, which did nothing; they now read 0. Versions below 1.2 had no counters
of saturated values."""

CONTROL_BASE = 0x020
"""First of the control registers."""

SETTINGS_BASE = 0x100
"""First of the settings."""

COUNTERS_BASE = 0x400
"""First of the counters."""

SATURATIONS_BASE = 0x600
"""First of the counters of saturated values: in all machines the same, whatever other counters they have."""

STAGES = watched(StagePhase.GEOMETRY, StagePhase.RENDERING)
"""Prefixes of the counters of the stages' input streams."""

READ_CLIENTS = ("geometry", "tiles", "colour", "entries", "spill", "views")
"""Who reads memory, by the region that is read; the place is the AXI read ID. Entries include their directory."""

WRITE_CLIENTS = ("entries", "views", "spill", "frame")
"""Who writes memory, by the region that is written; the place is the AXI write ID. Entries include their directory."""

STEREO_STAGES = watched(StagePhase.SECOND_EYE)
"""Stages more of machines with stereo: the rows that the warp unit takes."""

STEREO_WRITE_CLIENTS = ("warp",)
"""Write clients more of machines with stereo: the target eye's warped strips. What is rendered of it is `frame`'s."""


class Code(IntEnum):
    """Numbers with names, as registers hold them."""

    @classmethod
    def width(cls) -> int:
        """Bits that hold every one of them."""
        return max(cls).bit_length()


class Phase(Code):
    """What the machine is doing."""

    IDLE = 0
    """Nothing; ready for `start`."""
    CLEAR = 1
    """Forgetting the frame before."""
    TABLE = 2
    """Reading the table of tiles."""
    GEOMETRY = 3
    """Culling, conversion, tile test, colours."""
    RENDER = 4
    """Merging, sorting, blending."""
    DRAIN = 5
    """The frame has failed: waiting for what memory still owes."""
    RESET = 6
    """The frame has failed: starting all units anew."""


class ErrorCode(Code):
    """Why a frame ended early, or did not begin."""

    NONE = 0
    """No error."""
    BAD_SETTING = 1
    """A setting is out of its limits; `bad_setting` says which. The frame did not begin."""
    READ_ERROR = 2
    """Memory answered a read with an error; `error_clients` says whose."""
    WRITE_ERROR = 3
    """Memory answered a write with an error; `error_clients` says whose."""
    ENTRIES_FULL = 4
    """The tiles' entries need more than `entries_beats`."""
    SPILL_FULL = 5
    """The spilled runs need more than `spill_beats`."""
    COUNT_SATURATED = 6
    """A tile, or a group of tiles, has more entries than can be counted or addressed."""
    ABORTED = 7
    """`control.abort` ended the frame."""
    WATCHDOG = 8
    """Nothing moved for too long."""


class Access(Enum):
    """What the host may do with a register; with what a write does."""

    READ_ONLY = "read"
    READ_WRITE = "read, write"
    CLEARING = "read, write 1 to clear"


@dataclass(frozen=True)
class Bits:
    """Some bits of a register.

    Attributes:
        name: of the bits.
        low: place of the lowest.
        width: how many.
        doc: what they mean.
        strobe: writing 1 does something; they always read 0.
        values: the enumeration they hold, if any.
    """

    name: str
    low: int
    width: int
    doc: str
    strobe: bool = False
    values: type[Code] | None = None

    @property
    def mask(self) -> int:
        """The bits of the register that are these."""
        return (1 << self.width) - 1 << self.low


@dataclass(frozen=True)
class Register:
    """A register.

    Attributes:
        name: in lower case, words joined by underscores.
        offset: byte address.
        access: what the host may do with it.
        doc: what it holds.
        bits: its parts; without any, all 32 bits are one number.
        format: number format of a setting.
    """

    name: str
    offset: int
    access: Access
    doc: str
    bits: tuple[Bits, ...] = ()
    format: Format | None = None


@dataclass(frozen=True)
class Counter:
    """A counter: its name, what it counts, and its bits, 32 or 64."""

    name: str
    doc: str
    width: int = 32


EVENTS = {
    "points": "Gaussians read",
    "culled_near": "points in front of the near plane",
    "culled_faint": "points too faint to be seen at any level",
    "culled_outside": "points whose projection is degenerate or touches no tile of the frame",
    "survivors": "points with an entry",
    "entries": "tile entries written",
    "filtered": "pairs of point and tile that the foveation filter dropped",
    "groups": "groups of merged tiles",
    "spilled_entries": "entries written to memory once more, in sorted runs",
    "fetch_hits": "views found in the splat cache",
    "fetch_misses": "views read from memory",
    "ops": "ops of the array: splats at a level and backgrounds, once for every block of a tile",
    "skipped": "entries that the array skipped because their tile's pixels had all stopped",
    "pixels": "pixels written",
}
"""What the units report of a frame that has ended, by name; of a frame of two eyes, both passes' together."""

STEREO_EVENTS = {
    "warped": "pixels of the target eye that a pixel of the source eye was warped to, background included",
    "filled": "holes of the target eye filled from their neighbours",
    "invalid_tiles": "tiles of the target eye with a hole that was not filled",
    "target_tiles": "tiles of the target eye that were rendered",
}
"""Events more of machines with stereo; holes are filled and looked for in all tiles, those that must be rendered too."""


def stages(config: AcceleratorConfig) -> tuple[str, ...]:
    """Stages whose input streams are watched, of a machine."""
    return STAGES + STEREO_STAGES if config.stereo else STAGES


def write_clients(config: AcceleratorConfig) -> tuple[str, ...]:
    """Write clients of a machine."""
    return WRITE_CLIENTS + STEREO_WRITE_CLIENTS if config.stereo else WRITE_CLIENTS


def events(config: AcceleratorConfig) -> dict[str, str]:
    """What the units of a machine report of a frame that has ended, by name."""
    return EVENTS | (STEREO_EVENTS if config.stereo else {}) | {s.name: s.doc for s in SATURATIONS}


def counters(config: AcceleratorConfig) -> tuple[Counter, ...]:
    """Every counter of a machine, in the order of its registers; those of stereo come after what all have, saturations last."""
    phases = {"total": "in which the machine was busy"} | {
        p.name.lower(): f"of phase {p.name}" for p in (Phase.TABLE, Phase.GEOMETRY, Phase.RENDER)}
    per_stage = {"busy": "took an item", "starved": "had none to take", "blocked": "had one but could not take it"}

    def of_clients(kind: str, names: tuple[str, ...]) -> list[Counter]:
        return [Counter(f"{kind}_beats_{name}", f"of these by {kind} client {name}") for name in names]

    def of_stages(names: tuple[str, ...]) -> list[Counter]:
        return [Counter(f"{stage}_{what}", f"busy cycles in which stage {stage} {doc}")
                for stage in names for what, doc in per_stage.items()]

    stereo = (
        Counter("cycles_target", "cycles of the target eye's pass", 64), *of_clients("write", STEREO_WRITE_CLIENTS),
        *of_stages(STEREO_STAGES), *(Counter(name, doc) for name, doc in STEREO_EVENTS.items()))
    return (
        *(Counter(f"cycles_{name}", f"cycles {doc}", 64) for name, doc in phases.items()),
        Counter("frames", "frames that have ended, however they did"),
        Counter("read_beats", "beats read from memory"),
        Counter("write_beats", "beats written to memory"),
        *of_clients("read", READ_CLIENTS), *of_clients("write", WRITE_CLIENTS), *of_stages(STAGES),
        *(Counter(name, doc) for name, doc in EVENTS.items()),
        *(stereo if config.stereo else ()),
        *(Counter(saturation.name, saturation.doc) for saturation in SATURATIONS),
    )


def fingerprint(config: AcceleratorConfig) -> int:
    """32 bits that differ where two machines differ in anything but their names."""
    return int.from_bytes(hashlib.sha256(repr(config.with_(name="any")).encode()).digest()[:4], "little")


def identity(config: AcceleratorConfig) -> dict[str, int]:
    """What the identity registers of a machine read, by name."""
    parts = {
        "machine_array": (
            config.cores_x, config.cores_y, config.levels, config.depth, config.incremental, config.counters, config.stereo,
            config.sh_degree, config.blend),
        "machine_units": (config.culling_units, config.merge_ways, config.warp_lanes if config.stereo else 0),
        "machine_frame": (config.row_width,),
    }
    version = VERSION_MAJOR << 16 | VERSION_MINOR + config.stereo
    values = {"id": MAGIC, "version": version, "fingerprint": fingerprint(config)}
    for register in _IDENTITY:
        if register.name in parts:
            values[register.name] = sum(
                int(value) << bits.low for value, bits in zip(parts[register.name], register.bits, strict=True))
    return values | {"machine_sort_buffer": config.sort_buffer_bytes, "machine_cache": config.splat_cache_lines}


_IDENTITY = (
    Register("id", 0x000, Access.READ_ONLY, "0x4D535632 in every machine"),
    Register("version", 0x004, Access.READ_ONLY, "version of this map", (
        Bits("minor", 0, 16, "higher ones add registers"), Bits("major", 16, 16, "others are not compatible"))),
    Register("fingerprint", 0x008, Access.READ_ONLY, "differs where machines differ in any parameter or number format"),
    Register("machine_array", 0x00C, Access.READ_ONLY, "parameters of the array", (
        Bits("cores_x", 0, 8, "pixel cores of a row"), Bits("cores_y", 8, 8, "rows of pixel cores"),
        Bits("levels", 16, 4, "foveation levels"), Bits("depth", 20, 1, "depth sums present"),
        Bits("incremental", 21, 1, "stages hand over incrementally"), Bits("counters", 22, 1, "counters present"),
        Bits("stereo", 23, 1, "frames of two eyes"), Bits("sh_degree", 24, 2, "highest degree of harmonics"),
        Bits("blend", 26, 1, "tiles may blend two levels, where there are levels"))),
    Register("machine_units", 0x010, Access.READ_ONLY, "parameters of the units around the array", (
        Bits("culling_units", 0, 8, "culling and conversion units"), Bits("merge_ways", 16, 8, "runs merged at a time"),
        Bits("warp_lanes", 24, 8, "rows warped side by side; 0 without stereo"))),
    Register("machine_frame", 0x014, Access.READ_ONLY, "largest frame", (Bits("row_width", 0, 16, "widest row in pixels"),)),
    Register("machine_sort_buffer", 0x018, Access.READ_ONLY, "bytes of the double buffer before sorting"),
    Register("machine_cache", 0x01C, Access.READ_ONLY, "lines of the splat cache"),
)

_CONTROL = (
    Register("control", CONTROL_BASE, Access.READ_WRITE, "commands", (
        Bits("start", 0, 1, "begin a frame; ignored while busy", strobe=True),
        Bits("abort", 1, 1, "end the frame with error ABORTED; ignored unless busy", strobe=True),
        Bits("reset", 2, 1, "as abort where busy; and forget how frames ended, interrupts included", strobe=True),
        Bits("clear", 3, 1, "set all counters to 0", strobe=True),
        Bits("enable_done", 8, 1, "interrupt when a frame is done"),
        Bits("enable_error", 9, 1, "interrupt when a frame ends with an error"))),
    Register("status", CONTROL_BASE + 0x4, Access.READ_ONLY, "how far the frame is", (
        Bits("busy", 0, 1, "a frame, or stopping, is under way"),
        Bits("done", 1, 1, "the last frame is in memory; until the next start"),
        Bits("error", 2, 1, "the last frame ended early; until the next start"),
        Bits("phase", 8, 4, "what the machine is doing", values=Phase))),
    Register("error", CONTROL_BASE + 0x8, Access.READ_ONLY, "why", (
        Bits("code", 0, 8, "until the next start", values=ErrorCode),)),
    Register("bad_setting", CONTROL_BASE + 0xC, Access.READ_ONLY,
             "of BAD_SETTING: which setting, counted from 0 in their order; the first that is out of its limits"),
    Register("error_clients", CONTROL_BASE + 0x10, Access.READ_ONLY, "whose accesses memory answered with an error"),
    Register("interrupt", CONTROL_BASE + 0x14, Access.CLEARING, "why the interrupt line is high, whether or not enabled", (
        Bits("done", 0, 1, "a frame is done"), Bits("error", 1, 1, "a frame ended with an error"))),
)


def _control_registers(config: AcceleratorConfig) -> Iterator[Register]:
    clients = (Bits("read", 0, len(READ_CLIENTS), "a bit a read client"),
               Bits("write", 16, len(write_clients(config)), "a bit a write client"))
    return (replace(r, bits=clients) if r.name == "error_clients" else r for r in _CONTROL)


def _setting_registers(config: AcceleratorConfig) -> Iterator[Register]:
    words = {limit.setting: limit.words for limit in limits(config)}
    for s in settings(config):
        number, several = s.field.format, f", number {s.index} of {s.field.count}" if s.field.count > 1 else ""
        limit = f"; must be {words[s.name]}" if s.name in words else ""
        yield Register(s.name, SETTINGS_BASE + 4 * s.number, Access.READ_WRITE, f"{s.field.doc}{several}{limit}",
                       (Bits("value", 0, number.width, str(number)),), number)


def _counter_registers(config: AcceleratorConfig) -> Iterator[Register]:
    offset = COUNTERS_BASE
    for counter in counters(config):
        offset = SATURATIONS_BASE if counter.name == SATURATIONS[0].name else offset
        halves = {"": ""} if counter.width == 32 else {"_low": ", lower half", "_high": ", upper half"}
        for half, words in halves.items():
            yield Register(counter.name + half, offset, Access.READ_ONLY, counter.doc + words)
            offset += 4


def register_map(config: AcceleratorConfig) -> tuple[Register, ...]:
    """Every register, by ascending address."""
    return (*_IDENTITY, *_control_registers(config), *_setting_registers(config), *_counter_registers(config))


def is_signed(number: Format) -> bool:
    """Whether a register of the format is read back with its sign extended."""
    return isinstance(number, Fixed) and number.signed


def scale_words(number: Format) -> str:
    """How the host turns a register's value into a number."""
    if isinstance(number, SmallFloat):
        return (f"{number.width}-bit float: {'sign, ' if number.signed else ''}{number.exp_bits} exponent bits of bias "
                f"{number.bias}, {number.sig_bits - 1} fraction bits; exponent 0 is zero")
    return f"{number.width}-bit {'signed' if number.signed else 'unsigned'}" + (
        f", value * 2^-{number.frac_bits}" if number.frac_bits else "")
