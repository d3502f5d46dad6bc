"""The host's registers: one description for the RTL, the page docs/registers.md, the C header and the drivers.

All registers have 32 bits, are little-endian, and lie in 4 KB of byte addresses. Reserved bits read 0 and ignore writes. A
write to a read-only register, and any access to an address without a register, is answered with SLVERR and has no effect.

    0x000  identity of the machine
    0x020  control, status, errors, interrupts
    0x100  settings of the frame, one register per number, in the order of `spec.memory.frame_settings`
    0x400  counters
    0x600  counters of saturated values

A register has the same address in all machines that have it. Where a machine has no chunks, no stereo or no splat records in
memory, the addresses of their registers are empty. A memory client's number is its place among those of its own machine.

**A frame.** The host writes the settings, then `control.start`. The machine checks the settings, takes a copy of all of them
and is busy; from then on the host may write those of the next frame. The frame ends with `status.done`, or with `status.error`
and a code. `start` is ignored while the machine is busy.

**Two frames.** A machine whose phases overlap takes the next frame as soon as the first phase of the one before has ended and
its second phase runs: `status.ready` says so. A frame that ends well sets `status.done` and counts in `frames`; frames end in
the order in which they began. If a frame fails, or the host aborts, both end: `error.code` is that of the frame in its second
phase and `error.first_code` that of the frame in its first, where there are such frames, and the one whose fault it is not has
ABORTED. A start with a bad setting disturbs no other frame. The host gives frames two places in memory in turn, for all regions
that the machine writes and for the tables of tiles, and reads the register `error` before the next start, which clears it.

**Values.** A setting stands in the lowest bits of its register, in its own number format: two's complement where the format
is signed fixed-point, the bit pattern where it is a small float. The bits above are ignored when written. When read, they
repeat the sign of signed fixed-point numbers, so that an int32 comes back as it was written, and are 0 otherwise.

**Counters** count from `control.clear` on, over all frames that follow. A counter of 64 bits has two registers. Reading the
lower one also stores the upper half of the same cycle, which the next read of the upper register returns.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace

from spec.codes import Phase
from spec.config import AcceleratorConfig
from spec.formats import Fixed, Format, SmallFloat
from spec.host_settings import limits, settings, with_every_register
from spec.register_fields import CONTROL, IDENTITY, Access, Bits, Register
from spec.saturations import SATURATIONS
from spec.stages import StagePhase, watched

REGISTER_ADDRESS_BITS = 12
"""Bits of a byte address in the register space."""

MAGIC = 0x4D535632
"""The value of register `id`: "MSV2" in ASCII."""

VERSION_MAJOR, VERSION_MINOR = 4, 0
"""Of this map. A higher minor version only adds registers; machines with stereo have the next one, those that pack frames the
second, those with joint frames the fourth, and those with overlapped phases the eighth. In version 3 every machine had the
settings, clients and counters of splat records, which machines with lists by super-tile lack, and `machine_frame` and
`machine_cache` had one number each. Version 2 had no machines with chunks, whose settings and counters stand before those of
stereo: these have moved. Version 1 had a field `sorting_units` in `machine_units`, which did nothing; versions below 1.2 no
counters of saturated values."""

SETTINGS_BASE = 0x100
"""Byte address of the first setting."""

COUNTERS_BASE = 0x400
"""Byte address of the first counter."""

SATURATIONS_BASE = 0x600
"""Byte address of the first counter of saturated values. It is the same in all machines, whatever other counters they have."""

STAGES = watched(StagePhase.GEOMETRY, StagePhase.RENDERING)
"""Prefixes of the counters of the stages whose input streams are counted: busy, starved and blocked cycles."""

READ_CLIENTS = ("geometry", "tiles", "colour", "entries", "spill", "views")
"""Clients that read memory, named by the region that they read; the position is the AXI read ID. The region `entries` includes
the directory of its pages."""

WRITE_CLIENTS = ("entries", "views", "spill", "frame")
"""Clients that write memory, named by the region that they write; the position is the AXI write ID. The region `entries`
includes the directory of its pages."""

VIEW_CLIENT = "views"
"""The read client and the write client that machines with lists by super-tile do not have."""

CHUNK_READ_CLIENTS = ("chunks",)
"""Additional read clients of machines with chunks: `chunks` reads the chunks' headers."""

SUPERTILE_STAGES = watched(StagePhase.GEOMETRY, StagePhase.RENDERING, supertiles=True)
"""The watched stages of machines with lists by super-tile, in the order of the data."""

OVERLAP_READ_CLIENTS = ("first",)
"""Additional read clients of machines with overlapped phases: `first` reads the table of tiles, and then the chunks'
headers, for the first phase, beside which the second one has the clients `tiles` and `chunks` for itself."""

STEREO_STAGES = watched(StagePhase.SECOND_EYE)
"""Additional stages of machines with stereo; the input stream of `warp` are the rows that the warp unit takes."""

STEREO_WRITE_CLIENTS = ("warp",)
"""Additional write clients of machines with stereo: `warp` writes the target eye's warped pixels. The client `frame` writes its
rendered pixels."""


@dataclass(frozen=True)
class Counter:
    """A counter: its name, what it counts, and its width in bits, 32 or 64."""

    name: str
    doc: str
    width: int = 32


EVENTS = {
    "points": "Gaussians read",
    "culled_near": "Gaussians culled because they lie at or before the near plane",
    "culled_faint": "Gaussians culled because they are too faint to be seen at any level",
    "culled_outside": "Gaussians culled because they touch no tile of the frame, or their mean is out of `mean2d`'s range",
    "survivors": "Gaussians with at least one intersection",
    "entries": "intersections written to the tile lists, or, with super-tiles, those that pairs stand for",
    "filtered": "intersections that the foveation filter dropped",
    "groups": "groups of merged tiles or lists",
    "spilled_entries": "intersections or pairs written to memory a second time, in sorted runs",
    "fetch_hits": "splat records found in the splat cache",
    "fetch_misses": "splat records read from memory",
    "ops": "ops of the array: splats at a level and backgrounds, once for every block of a tile",
    "skipped": "intersections that the array skipped because all pixels of their tile had stopped",
    "pixels": "pixels written",
}
"""Events that the units report when a frame ends: by name, what is counted. A frame of two eyes counts both passes together."""

CHUNK_EVENTS = {
    "chunks_read": "chunks whose Gaussians were read",
    "chunks_skipped": "chunks that the chunk test skipped",
}
"""Additional events of machines with chunks."""

VIEW_EVENTS = ("fetch_hits", "fetch_misses")
"""Those of EVENTS that machines with lists by super-tile do not report, because they store no splat records."""

SUPERTILE_EVENTS = {
    "pairs": "pairs of a splat and a super-tile written to the lists",
    "header_hits": "pairs whose chunk header was in the header cache, or on its way there",
    "header_misses": "chunk headers read from memory for pairs",
    "batches": "batches of pairs given to the array, empty ones included",
    "visits": "visits of tiles in the array",
}
"""Additional events of machines with lists by super-tile."""

STEREO_EVENTS = {
    "warped": "pixels of the target eye to which a pixel of the source eye was warped, background included",
    "filled": "holes of the target eye filled from their neighbours",
    "invalid_tiles": "tiles of the target eye with a hole that was not filled",
    "target_tiles": "tiles of the target eye that were rendered",
}
"""Additional events of machines with stereo. Holes are searched and filled in all tiles, including those that must be rendered
in any case."""


SWEEP_EVENTS = {
    "pairs_again": "pairs that the second sweep read again, for tiles with holes",
}
"""Additional events of machines whose joint frames may have a warped target (`spec.joint_warp`)."""


def stages(config: AcceleratorConfig) -> tuple[str, ...]:
    """The stages of a machine whose input streams are counted, in the order of the data."""
    own = SUPERTILE_STAGES if config.supertiles else STAGES
    return own + STEREO_STAGES if config.stereo else own


def _stored(config: AcceleratorConfig, clients: tuple[str, ...]) -> tuple[str, ...]:
    """Those of the clients that a machine has: without splat records in memory none for them."""
    return tuple(name for name in clients if not (config.supertiles and name == VIEW_CLIENT))


def read_clients(config: AcceleratorConfig) -> tuple[str, ...]:
    """The read clients of a machine, in the order of their AXI IDs."""
    return _stored(config, READ_CLIENTS) + (CHUNK_READ_CLIENTS if config.chunks else ()) + (
        OVERLAP_READ_CLIENTS if config.overlap else ())


def write_clients(config: AcceleratorConfig) -> tuple[str, ...]:
    """The write clients of a machine, in the order of their AXI IDs."""
    return _stored(config, WRITE_CLIENTS) + (STEREO_WRITE_CLIENTS if config.stereo else ())


def events(config: AcceleratorConfig) -> dict[str, str]:
    """Events that the units of a machine report when a frame ends: by name, what is counted."""
    chunks, stereo = CHUNK_EVENTS if config.chunks else {}, STEREO_EVENTS if config.stereo else {}
    supertiles = SUPERTILE_EVENTS if config.supertiles else {}
    sweep = SWEEP_EVENTS if config.warps_joint else {}
    return _common_events(config) | chunks | stereo | supertiles | sweep | {s.name: s.doc for s in SATURATIONS}


def _common_events(config: AcceleratorConfig) -> dict[str, str]:
    """Those of EVENTS that a machine reports."""
    return {name: doc for name, doc in EVENTS.items() if not (config.supertiles and name in VIEW_EVENTS)}


def counters(config: AcceleratorConfig) -> tuple[Counter, ...]:
    """Every counter of a machine, in the order of its registers: first those of all machines, then those of chunks, of stereo
    and of super-tiles, of overlapped phases and of second sweeps, at the end those of saturated values."""
    phases = {"total": "in which the machine was busy"} | {
        p.name.lower(): f"of phase {p.name}" for p in (Phase.TABLE, Phase.GEOMETRY, Phase.RENDER)}
    per_stage = {"busy": "took an item", "starved": "had none to take", "blocked": "had one but could not take it"}

    def of_clients(kind: str, names: tuple[str, ...]) -> list[Counter]:
        return [Counter(f"{kind}_beats_{name}", f"of these by {kind} client {name}") for name in names]

    def of_stages(names: tuple[str, ...]) -> list[Counter]:
        return [Counter(f"{stage}_{what}", f"busy cycles in which stage {stage} {doc}")
                for stage in names for what, doc in per_stage.items()]

    own = stages(config)
    chunks = (*of_clients("read", CHUNK_READ_CLIENTS), *(Counter(name, doc) for name, doc in CHUNK_EVENTS.items()))
    supertiles = (
        *of_stages(tuple(name for name in SUPERTILE_STAGES if name not in STAGES)),
        *(Counter(name, doc) for name, doc in SUPERTILE_EVENTS.items()))
    stereo = (
        Counter("cycles_target", "cycles of the target eye's pass, in joint frames of the second sweep", 64),
        *of_clients("write", STEREO_WRITE_CLIENTS),
        *of_stages(STEREO_STAGES), *(Counter(name, doc) for name, doc in STEREO_EVENTS.items()))
    return (
        *(Counter(f"cycles_{name}", f"cycles {doc}", 64) for name, doc in phases.items()),
        Counter("frames", "frames that have ended, however they did"),
        Counter("read_beats", "beats read from memory"),
        Counter("write_beats", "beats written to memory"),
        *of_clients("read", _stored(config, READ_CLIENTS)), *of_clients("write", _stored(config, WRITE_CLIENTS)),
        *of_stages(tuple(name for name in STAGES if name in own)),
        *(Counter(name, doc) for name, doc in _common_events(config).items()),
        *(chunks if config.chunks else ()),
        *(stereo if config.stereo else ()),
        *(supertiles if config.supertiles else ()),
        *(of_clients("read", OVERLAP_READ_CLIENTS) if config.overlap else ()),
        *(Counter(name, doc) for name, doc in (SWEEP_EVENTS if config.warps_joint else {}).items()),
        *(Counter(saturation.name, saturation.doc) for saturation in SATURATIONS),
    )


def fingerprint(config: AcceleratorConfig) -> int:
    """A hash of 32 bits that differs where machines differ in any parameter but their names. The lack of what older machines
    did not know, joint frames, overlapped phases, banks in memories and fewer beats of reads, leaves it as it was."""
    text = repr(config.with_(name="any"))
    for lack in ("joint=False", "overlap=False", "bank_memories=False", "read_beats=512"):
        text = text.replace(f"{lack}, ", "")
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:4], "little")


def version_minor(config: AcceleratorConfig) -> int:
    """The minor version of a machine's map."""
    return VERSION_MINOR + config.stereo + 2 * config.packed + 4 * config.joint + 8 * config.overlap


def identity(config: AcceleratorConfig) -> dict[str, int]:
    """The values of a machine's identity registers, by name."""
    parts = {
        "machine_array": (
            config.cores_x, config.cores_y, config.levels, config.depth, config.incremental, config.counters, config.stereo,
            config.sh_degree, config.blend, config.chunks, config.compact, config.supertiles, config.packed,
            config.streams > 1),
        "machine_units": (
            config.culling_units, config.joint, config.overlap, config.merge_ways, config.warp_lanes if config.stereo else 0),
        "machine_frame": (config.row_width, *((config.list_heads, config.buckets) if config.supertiles else (0, 0))),
        "machine_cache": (config.header_lines, config.batch_places) if config.supertiles else (config.splat_cache_lines, 0),
    }
    values = {"id": MAGIC, "version": VERSION_MAJOR << 16 | version_minor(config), "fingerprint": fingerprint(config)}
    for register in IDENTITY:
        if register.name in parts:
            values[register.name] = sum(
                int(value) << bits.low for value, bits in zip(parts[register.name], register.bits, strict=True))
    return values | {"machine_sort_buffer": config.sort_buffer_bytes}


def _control_registers(config: AcceleratorConfig) -> Iterator[Register]:
    clients = (Bits("read", 0, len(read_clients(config)), "one bit per read client"),
               Bits("write", 16, len(write_clients(config)), "one bit per write client"))
    return (replace(r, bits=clients) if r.name == "error_clients" else r for r in CONTROL)


def _setting_registers(config: AcceleratorConfig) -> Iterator[Register]:
    words = {limit.setting: limit.words for limit in limits(config)}
    for s in settings(config):
        number, several = s.field.format, f", number {s.index} of {s.field.count}" if s.field.count > 1 else ""
        limit = f"; must be {words[s.name]}" if s.name in words else ""
        yield Register(s.name, SETTINGS_BASE + 4 * s.number, Access.READ_WRITE, f"{s.field.doc}{several}{limit}",
                       (Bits("value", 0, number.width, str(number)),), number)


def _counter_registers(config: AcceleratorConfig) -> Iterator[Register]:
    own, offset = {counter.name for counter in counters(config)}, COUNTERS_BASE
    last = [counter.name for counter in counters(config)[-len(SATURATIONS):]]
    every = {c.name: c for machine in with_every_register(config) for c in counters(machine) if c.name not in last}
    for counter in (*every.values(), *counters(config)[-len(SATURATIONS):]):
        offset = SATURATIONS_BASE if counter.name == SATURATIONS[0].name else offset
        halves = {"": ""} if counter.width == 32 else {"_low": ", lower half", "_high": ", upper half"}
        for half, words in halves.items():
            if counter.name in own:
                yield Register(counter.name + half, offset, Access.READ_ONLY, counter.doc + words)
            offset += 4


def register_map(config: AcceleratorConfig) -> tuple[Register, ...]:
    """Every register, by ascending address."""
    return (*IDENTITY, *_control_registers(config), *_setting_registers(config), *_counter_registers(config))


def is_signed(number: Format | None) -> bool:
    """Whether a register of the format is read back with its sign extended."""
    return isinstance(number, Fixed) and number.signed


def scale_words(number: Format) -> str:
    """Words that tell how the host turns a register's value into a number."""
    if isinstance(number, SmallFloat):
        return (f"{number.width}-bit float: {'sign, ' if number.signed else ''}{number.exp_bits} exponent bits of bias "
                f"{number.bias}, {number.sig_bits - 1} fraction bits; exponent 0 is zero")
    return f"{number.width}-bit {'signed' if number.signed else 'unsigned'}" + (
        f", value * 2^-{number.frac_bits}" if number.frac_bits else "")
