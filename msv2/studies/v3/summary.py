"""Gains over `paper`, step by step, and the goals."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from golden.scenes.load import EMBEDDED
from msv2.studies.memory import IDEAL, LPDDR3
from msv2.studies.performance.summary import geomean
from msv2.studies.v3.frames import MACHINES
from spec.config import PAPER, V3, V3_EYES_LARGE, V3_PACKED, V3_RECORDS, V3_STREAMS_PACKED

Row = Mapping[str, Any]

BYTES_GOAL, LPDDR3_GOAL, CHUNKS_GOAL = 1.2, 1.25, 0.35
"""How many times fewer bytes and cycles a frame of `v3_records` takes, as geometric means; and the largest share of
garden_large's chunks that is read."""

SUPER_BYTES_GOAL, SUPER_CAPTURED_GOAL, SUPER_IDEAL_GOAL, SUPER_LPDDR3_GOAL, OVERFLOW_GOAL = 2.3, 2.35, 2.0, 2.4, 0.001
"""The same of `v3`, with lists by super-tile: bytes of all frames, and at least of each captured scene at CAPTURED_SIZE;
cycles with the ideal memory and with LPDDR3; and the largest share of pairs in lists that the sorter cannot hold at once."""

WHOLE_BYTES_GOAL, WHOLE_IDEAL_GOAL, WHOLE_LPDDR3_GOAL, WHOLE_DRAM_GOAL = 2.9, 2.6, 3.0, 2.7
"""The same of the machine with four arrays and packed frames: bytes, cycles with the ideal memory and with LPDDR3, and the
energy of DRAM."""

CAPTURED_SIZE = "640x360"

CULLED = "garden_large"
"""The scene whose share of chunks has a goal: a camera in it sees a part of it only."""


def of(rows: Iterable[Row], **wanted: object) -> list[Row]:
    """The rows that have the wanted values."""
    return [row for row in rows if all(row[name] == value for name, value in wanted.items())]


def gains(rows: Sequence[Row], machine: str, over: str = PAPER.name) -> dict[str, object]:
    """How many times fewer bytes and cycles, and how many times less energy, frames take on a machine than on another one, as
    geometric means over the frames; None where there is no frame."""
    def mean(memory: str, value: str) -> float | None:
        base = {row["frame"]: _value(row, value) for row in of(rows, machine=over, memory=memory)}
        return geomean(base[row["frame"]] / _value(row, value) for row in of(rows, machine=machine, memory=memory))

    return {"bytes_gain": mean(LPDDR3, "total_bytes"), "lpddr3_gain": mean(LPDDR3, "cycles"),
            "ideal_gain": mean(IDEAL, "cycles"), "activates_gain": mean(LPDDR3, "activates"),
            "dram_energy_gain": mean(LPDDR3, "dram"), "energy_gain": mean(LPDDR3, "energy")}


def _value(row: Row, name: str) -> float:
    if name == "dram":
        return row["energy_mj"]["dram"]
    if name == "energy":
        return row["energy_mj"]["chip"] + row["energy_mj"]["dram"]
    return row[name]


def shares(rows: Sequence[Row]) -> dict[str, float]:
    """The share of chunks that machines with chunks read, by frame."""
    found = of(rows, machine=V3_RECORDS.name, memory=LPDDR3)
    return {row["frame"]: row["chunks_read"] / max(1, row["chunks"]) for row in found}


def worst_captured(rows: Sequence[Row]) -> float | None:
    """How many times fewer bytes a frame of a captured scene of CAPTURED_SIZE takes at least on the machine with super-tiles;
    None where there is none."""
    base = {row["frame"]: row["total_bytes"] for row in of(rows, machine=PAPER.name, memory=LPDDR3)}
    found = of(rows, machine=V3.name, memory=LPDDR3, size=CAPTURED_SIZE)
    return min((base[row["frame"]] / row["total_bytes"] for row in found if row["scene"] != EMBEDDED), default=None)


def worst_overflow(overflow: Sequence[Row]) -> float | None:
    """The largest share of pairs that overflow after a turn, in frames of four levels; None where there is none."""
    return max((row["overflow_share"] for row in overflow if row["foveated"] and row["degrees"] is not None), default=None)


def supertiles(rows: Sequence[Row], overflow: Sequence[Row]) -> dict[str, object]:
    """The step to lists by super-tile: gains over `paper`, and how much overflows."""
    return {**gains(rows, V3.name), "worst_bytes_gain_captured": worst_captured(rows),
            "overflow_share": worst_overflow(overflow), "overflow": list(overflow)}


def steps(
    rows: Sequence[Row], photographs: Sequence[Row], overflow: Sequence[Row], eyes: Mapping[str, Row] | None = None,
    machines: Sequence[Row] = (),
) -> dict[str, object]:
    """The steps by name. `records` stands for spatial order, chunks and compact records together; beside it stand its parts.
    `supertiles` stands for these and lists by super-tile, `packed` for packed frames besides, and `streams` for packed frames
    and four arrays, in reports that have them.

    Args:
        rows: the frames.
        photographs: the rows of losses against photographs.
        overflow: the rows of turns.
        eyes: the summary of reports/two_eyes.json. Its joint frames on V3_EYES_LARGE stand beside the step `streams`.
        machines: the steps of reports/performance.json. How many times as fast as a GSCore-like machine of equal area the
            machine with four arrays is on the frames of that report stands there, too.
    """
    parts = {name: gains(rows, name) for name in MACHINES if name not in (PAPER.name, V3_RECORDS.name)}
    worst = max((row["loss_db"] for row in photographs), default=None)
    found = {**gains(rows, V3_RECORDS.name), "worst_photo_loss_db": worst, "chunks_read": shares(rows), "beside": parts}
    packed = {"packed": {**gains(rows, V3_PACKED.name), "over_v3": gains(rows, V3_PACKED.name, V3.name)}}
    streams = {"streams": {**gains(rows, V3_STREAMS_PACKED.name), "over_v3": gains(rows, V3_STREAMS_PACKED.name, V3.name),
                           **_second_eye(eyes or {}), **_over_gscore(machines)}}
    return {"records": found, "supertiles": supertiles(rows, overflow), **(packed if of(rows, machine=V3_PACKED.name) else {}),
            **(streams if of(rows, machine=V3_STREAMS_PACKED.name) else {})}


def _second_eye(eyes: Mapping[str, Row]) -> dict[str, float | None]:
    """What joint frames give on V3_EYES_LARGE: with LPDDR3, and with the ideal memory."""
    out: dict[str, float | None] = {}
    for memory, end in ((LPDDR3, ""), (IDEAL, "_ideal")):
        found = eyes.get(f"{V3_EYES_LARGE.name}, {memory}", {})
        out |= {f"{name}{end}": found.get(name) for name in ("two_eyes_gain", "second_eye_share")}
    return out


def _over_gscore(machines: Sequence[Row]) -> dict[str, float | None]:
    """How many times as fast as a GSCore-like machine of equal area the machine with four arrays and packed frames is."""
    found = next((row["gscore_like_gain"] for row in machines if row["machine"] == V3_STREAMS_PACKED.name), {})
    return {f"gscore_like_gain{end}": found.get(memory) for memory, end in ((LPDDR3, ""), (IDEAL, "_ideal"))}


def goals(rows: Sequence[Row], photographs: Sequence[Row], overflow: Sequence[Row]) -> list[dict[str, object]]:
    """The goals, and whether they are reached."""
    found = gains(rows, V3_RECORDS.name)
    culled = [row["chunks_read"] / row["chunks"] for row in of(rows, machine=V3_RECORDS.name, memory=LPDDR3, scene=CULLED)]
    out = [_goal("bytes of a frame, times fewer", BYTES_GOAL, found["bytes_gain"], least=True),
           _goal("LPDDR3 cycles of a frame, times fewer", LPDDR3_GOAL, found["lpddr3_gain"], least=True),
           _goal(f"share of {CULLED}'s chunks that is read", CHUNKS_GOAL, max(culled, default=None), least=False)]
    for limit in sorted({row["limit_db"] for row in photographs}):
        lost = [row for row in photographs if row["limit_db"] == limit]
        levels = lost[0]["levels"]
        out.append(_goal(f"dB lost against photographs, {levels} level{'s' if levels > 1 else ''}", limit,
                         max(row["loss_db"] for row in lost), least=False))
    step, whole = supertiles(rows, overflow), gains(rows, V3_STREAMS_PACKED.name)
    return [
        *out, _goal("super-tiles: bytes of a frame, times fewer", SUPER_BYTES_GOAL, step["bytes_gain"], least=True),
        _goal(f"super-tiles: bytes of a captured frame of {CAPTURED_SIZE}, times fewer at least", SUPER_CAPTURED_GOAL,
              step["worst_bytes_gain_captured"], least=True),
        _goal("super-tiles: ideal cycles of a frame, times fewer", SUPER_IDEAL_GOAL, step["ideal_gain"], least=True),
        _goal("super-tiles: LPDDR3 cycles of a frame, times fewer", SUPER_LPDDR3_GOAL, step["lpddr3_gain"], least=True),
        _goal("super-tiles: share of pairs that overflow after a turn", OVERFLOW_GOAL, step["overflow_share"], least=False),
        *(_goal(f"four arrays, packed frames: {what}", wanted, whole[name], least=True) for what, wanted, name in (
            ("bytes of a frame, times fewer", WHOLE_BYTES_GOAL, "bytes_gain"),
            ("ideal cycles of a frame, times fewer", WHOLE_IDEAL_GOAL, "ideal_gain"),
            ("LPDDR3 cycles of a frame, times fewer", WHOLE_LPDDR3_GOAL, "lpddr3_gain"),
            ("energy of DRAM, times less", WHOLE_DRAM_GOAL, "dram_energy_gain")))]


def _goal(what: str, wanted: float, found: float | None, *, least: bool) -> dict[str, object]:
    reached = None if found is None else found >= wanted if least else found <= wanted
    return {"goal": what, "wanted": wanted, "least": least, "found": found, "reached": reached}


def order_means(rows: Sequence[Row]) -> list[dict[str, object]]:
    """The gains of every order over the file's order on `paper`, as geometric means over the frames."""
    base = {(row["frame"], row["memory"]): row for row in of(rows, order="file", machine=PAPER.name)}
    out = []
    for name, machine in dict.fromkeys((row["order"], row["machine"]) for row in rows):
        mine = of(rows, order=name, machine=machine)

        def mean(memory: str, value: str, mine: Sequence[Row] = mine) -> float | None:
            return geomean(base[row["frame"], memory][value] / row[value] for row in mine if row["memory"] == memory)

        read = [row["chunks_read"] / row["chunks"] for row in mine if row["chunks"]]
        out.append({"order": name, "machine": machine, "lpddr3_gain": mean(LPDDR3, "cycles"),
                    "ideal_gain": mean(IDEAL, "cycles"), "bytes_gain": mean(LPDDR3, "total_bytes"),
                    "chunks_read": geomean(read)})
    return out
