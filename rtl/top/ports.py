"""What both phases of the machine have in common: memory clients by name, settings by name, and watched streams."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from amaranth.hdl import Cat, Module
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Member, Out

from rtl.shapes import layout
from spec.config import AcceleratorConfig
from spec.memory import frame_settings, read_data, read_request, write_request
from spec.queues import COUNTER_BITS
from spec.records import frame_tiles


def memory_ports(config: AcceleratorConfig, readers: Sequence[str], writers: Sequence[str]) -> dict[str, Member]:
    """Ports `reads_NAME` and `data_NAME` of every reader, and `writes_NAME` and `idle_NAME` of every writer."""
    members = {}
    for name in readers:
        members[f"reads_{name}"] = Out(stream.Signature(layout(read_request(config))))
        members[f"data_{name}"] = In(stream.Signature(layout(read_data(config))))
    for name in writers:
        members[f"writes_{name}"] = Out(stream.Signature(layout(write_request(config))))
        members[f"idle_{name}"] = In(1)
    return members


def phase_ports(
    config: AcceleratorConfig, readers: Sequence[str], writers: Sequence[str], stages: Sequence[str], counts: Sequence[str],
) -> dict[str, Member]:
    """The ports that both phases have.

    They are the frame's `settings`, `tiles_x` and `tile_count`; the strobes `clear` and `start`; the ports of their memory
    clients; `done` and `ready`; the handshakes of their `stages`; the `counts` of the frame; and where a frame has
    two passes `target`, which says that the target eye's is running.

    Raises:
        TypeError: `config` is not an AcceleratorConfig.
    """
    if not isinstance(config, AcceleratorConfig):
        raise TypeError(f"config must be an AcceleratorConfig, not {config!r}")
    tiles = In(range(frame_tiles(config) + 1))
    return {
        "settings": In(layout(frame_settings(config))), "tiles_x": tiles, "tile_count": tiles, "clear": In(1), "start": In(1),
        **memory_ports(config, readers, writers), "done": Out(1), "ready": Out(1),
        "stage_valid": Out(len(stages)), "stage_ready": Out(len(stages)), **{name: Out(COUNTER_BITS) for name in counts},
        **({"target": In(1)} if config.two_passes else {})}


def connect_settings(m: Module, outer: Any, unit: wiring.Component) -> None:
    """Connects the frame's settings, its numbers of tiles and its pass to those inputs of a unit that have the same names."""
    fields = outer.settings.shape().members
    for name, member in unit.signature.members.items():
        if name in fields:
            m.d.comb += getattr(unit, name).eq(outer.settings[name])
        elif name in ("tiles_x", "tile_count", "target"):
            m.d.comb += getattr(unit, name).eq(getattr(outer, name))
        if name in fields and member.flow is not In:
            raise ValueError(f"{name} must be an input of {type(unit).__name__}, not {member!r}")


def watch(m: Module, outer: Any, streams: Sequence[Any]) -> None:
    """Brings out the handshakes of the stages' input streams as `stage_valid` and `stage_ready`."""
    m.d.comb += [outer.stage_valid.eq(Cat(s.valid for s in streams)), outer.stage_ready.eq(Cat(s.ready for s in streams))]
