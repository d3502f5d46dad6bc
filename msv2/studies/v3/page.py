"""The page of the report: what the steps towards `v3` give."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from msv2.studies.memory import LPDDR3, MEMORY_NAMES
from msv2.studies.page import table
from msv2.studies.v3.frames import MACHINES, MEMORIES
from msv2.studies.v3.summary import Row, of
from spec.config import PAPER, V3, V3_EYES_LARGE, V3_PACKED, V3_RECORDS, V3_STREAMS_PACKED
from spec.registers import CHUNK_READ_CLIENTS, READ_CLIENTS, WRITE_CLIENTS

NONE = "-"
_NAMES = (*MACHINES, V3.name)


def page(content: Mapping[str, Any]) -> str:
    """The report as a Markdown page."""
    rows = content["frames"]
    found, step = content["steps"]["records"], content["steps"]["supertiles"]
    parts = [
        "# v3: spatial order, chunks, compact records and lists by super-tile", _introduction(content),
        "## Goals", _goals(content["goals"]),
        "## Gains over `paper`", "Geometric means over the frames. `paper, spatial order` is work of the host alone. "
        f"`{V3_RECORDS.name}` has chunks of compact records. `{V3.name}` has lists by super-tile and depth buckets, too; it "
        "gathers records and projects them again.",
        _gains({**found["beside"], V3_RECORDS.name: found, V3.name: step}), _packed(content), _streams(content),
        *(part for memory in MEMORIES for part in (f"## Cycles, {MEMORY_NAMES[memory]}", _cycles(rows, memory))),
        "## Bytes by client", f"MB of a frame: `{PAPER.name}` / `{V3_RECORDS.name}` / `{V3.name}`.", _bytes(rows),
        "## Super-tiles", f"Frames on `{V3.name}`, with the bounds of an unmoved camera. A pair is a splat and a "
        "super-tile.", _supertiles(rows),
        "## Depth buckets", "Pairs in lists above the sort buffer, where the bounds come from a frame before the camera "
        "turned by so many degrees and moved to the side by 0.005 units. After a cut there are no bounds.",
        _overflow(step["overflow"]),
        "## Chunks", "What `v3` reads of the model. Each chunk's header, 32 bytes, is read in any case.", _chunks(rows),
        "## Energy and activates",
        f"{MEMORY_NAMES[LPDDR3]}: `{PAPER.name}` / `{V3_RECORDS.name}` / `{V3.name}`. The energy of DRAM includes activates, "
        "refreshes, standby, I/O and termination; `msv2 study run energy` names the sources.", _energy(rows),
        "## Against photographs", "PSNR in dB of golden frames against photographs of test views, which training does not see. "
        "Frames of four levels have the gaze in the centre.", _photographs(content),
        "## Orders of the model", "Gains over `paper` with the order of the file, as geometric means over the frames "
        f"{'; '.join(content['ordered']) or NONE}. `golden.host.order` defines the orders.", _orders(content["orders"]),
    ]
    return "\n\n".join(part for part in parts if part)


def _introduction(content: Mapping[str, Any]) -> str:
    frames = len({row["frame"] for row in content["frames"]})
    lines = [
        "Written by `msv2 study run v3`.",
        f"{frames} frames, each with four levels and the gaze in its centre, seen from the orbit's first camera, at 1 GHz. The "
        "cycle model (`perf/`) simulates the golden renderer's frame on each machine. LPDDR3 stands for four channels of "
        "LPDDR3-1600, which count; the ideal memory has their bandwidth, but no rows, refreshes or turnarounds: it is a bound."]
    if content["missing"]:
        lines.append(f"Missing: {', '.join(content['missing'])}.")
    return "\n\n".join(lines)


def _number(value: float | None, form: str = ".3f") -> str:
    return NONE if value is None else format(value, form)


def _goals(goals: Sequence[Row]) -> str:
    return table(("goal", "wanted", "found", "state"), (
        (goal["goal"], f"{'>=' if goal['least'] else '<='} {goal['wanted']:g}", _number(goal["found"], ".4f"),
         {True: "reached", False: "missed", None: "not measured"}[goal["reached"]]) for goal in goals),
        left=1, words=("state",))


def _gains(found: Mapping[str, Row]) -> str:
    keys = ("lpddr3_gain", "ideal_gain", "bytes_gain", "activates_gain", "dram_energy_gain", "energy_gain")
    head = ("machine", "LPDDR3 cycles", "ideal cycles", "bytes", "activates", "energy of DRAM", "energy of chip and DRAM")
    return table(head, ((name, *(_number(gain[key]) for key in keys)) for name, gain in found.items()), left=1)


def _packed(content: Mapping[str, Any]) -> str:
    """What packed frames give, in reports that have them."""
    rows, step = content["frames"], content["steps"].get("packed")
    if not step:
        return ""
    lines = []
    for row in of(rows, machine=V3_PACKED.name, memory=LPDDR3):
        both = {memory: [of(rows, frame=row["frame"], machine=name, memory=memory)[0] for name in (V3.name, V3_PACKED.name)]
                for memory in MEMORIES}
        written = [other["bytes"]["write"]["frame"] for other in both[LPDDR3]]
        lines.append((row["frame"], *(f"{one['cycles'] / two['cycles']:.3f}" for one, two in both.values()),
                      f"{both[LPDDR3][0]['total_bytes'] / row['total_bytes']:.3f}", f"{written[1] / written[0]:.3f}"))
    over = step["over_v3"]
    head = ("frame", *(f"{MEMORY_NAMES[memory]} cycles" for memory in MEMORIES), "bytes", "share of the frame")
    lines.append(("geometric mean", *(f"{over[key]:.3f}" for key in ("lpddr3_gain", "ideal_gain", "bytes_gain")), ""))
    return "\n\n".join((
        "## Packed frames", f"`{V3_PACKED.name}`, which packs frames for displays, over `{V3.name}`. The energy of "
        "packing counts in rows that were measured since reports/energy_per_operation.json has the frame packer.",
        table(head, lines, left=1)))


def _streams(content: Mapping[str, Any]) -> str:
    """What four arrays and packed frames give, in reports that have them."""
    step = content["steps"].get("streams")
    if not step:
        return ""
    name, eyes = V3_STREAMS_PACKED.name, ""
    if step["two_eyes_gain"] is not None:
        eyes = (f" Both eyes in joint frames on `{V3_EYES_LARGE.name}` (reports/two_eyes.md) take "
                f"{step['two_eyes_gain']:.2f} times fewer LPDDR3 cycles than two frames of `{PAPER.name}`, "
                f"{step['two_eyes_gain_ideal']:.2f} with the ideal memory; the second eye costs "
                f"{step['second_eye_share']:.2f} and {step['second_eye_share_ideal']:.2f} of the first.")
    if step.get("gscore_like_gain") is not None:
        eyes += (" Over a GSCore-like machine of equal area it is "
                 f"{step['gscore_like_gain']:.2f} times as fast with LPDDR3, and {step['gscore_like_gain_ideal']:.2f} times "
                 "with the ideal memory, on the frames of reports/performance.md.")
    return "\n\n".join((
        "## Four arrays", f"`{name}` is `{V3.name}` with four arrays, each with a stream of the batch of its own, packed "
        f"frames, and batches of {V3_STREAMS_PACKED.batch_places} places instead of {V3.batch_places}. The first row is over "
        f"`{PAPER.name}`, the second over `{V3.name}`.{eyes}",
        _gains({f"{name} over {PAPER.name}": step, f"{name} over {V3.name}": step["over_v3"]})))


def _cycles(rows: Sequence[Row], memory: str) -> str:
    lines = []
    for row in of(rows, machine=PAPER.name, memory=memory):
        others = {name: of(rows, frame=row["frame"], machine=name, memory=memory)[0] for name in _NAMES}
        last = others[V3.name]
        lines.append((
            row["frame"], *(f"{other['cycles']:,}" for other in others.values()), f"{row['cycles'] / last['cycles']:.3f}",
            *(f"{row['phases'][phase]:,} / {last['phases'][phase]:,}" for phase in ("geometry", "render"))))
    return table(("frame", *_NAMES, "gain", f"geometry, `{PAPER.name}` / `{V3.name}`", "rendering"), lines, left=1)


def _beside(values: Iterable[float], form: str = ".2f") -> str:
    return " / ".join(f"{value:{form}}" for value in values)


def _compared(rows: Sequence[Row]) -> Iterator[tuple[Row, ...]]:
    """For each frame, its rows on `paper`, `v3_records` and `v3`, with LPDDR3."""
    for row in of(rows, machine=PAPER.name, memory=LPDDR3):
        yield row, *(of(rows, frame=row["frame"], machine=name, memory=LPDDR3)[0] for name in (V3_RECORDS.name, V3.name))


def _bytes(rows: Sequence[Row]) -> str:
    clients = [("read", name) for name in (*CHUNK_READ_CLIENTS, *READ_CLIENTS)] + [("write", name) for name in WRITE_CLIENTS]
    lines = []
    for found in _compared(rows):
        cells = [_beside(row["bytes"][kind].get(name, 0) / 1e6 for row in found) for kind, name in clients]
        total = [row["total_bytes"] for row in found]
        lines.append((found[0]["frame"], *cells, _beside(value / 1e6 for value in total), f"{total[0] / total[1]:.3f}",
                      f"{total[0] / total[2]:.3f}"))
    return table(("frame", *(f"{name} {kind}" for kind, name in clients), "all", f"gain, `{V3_RECORDS.name}`",
                  f"gain, `{V3.name}`"), lines, left=1)


def _supertiles(rows: Sequence[Row]) -> str:
    names = ("pairs", "places", "lists", "batches", "visits", "header_misses")
    return table(("frame", "intersections", *(name.replace("_", " ") for name in names), "pairs a splat"), (
        (row["frame"], f"{row['entries']:,}", *(f"{row[name]:,}" for name in names),
         f"{row['pairs'] / max(1, row['survivors']):.2f}") for row in of(rows, machine=V3.name, memory=LPDDR3)), left=1)


def _overflow(rows: Sequence[Row]) -> str:
    return table(("frame", "levels", "degrees", "pairs", "lists", "largest list", "share of pairs"), (
        (row["frame"], "4" if row["foveated"] else "1", "cut" if row["degrees"] is None else f"{row['degrees']:g}",
         *(f"{row[name]:,}" for name in ("pairs", "lists", "largest")), f"{row['overflow_share']:.4f}")
        for row in rows), left=1)


def _chunks(rows: Sequence[Row]) -> str:
    return table(("frame", "chunks", "read", "share", "points", "read", "share", "survivors"), (
        (row["frame"], f"{row['chunks']:,}", f"{row['chunks_read']:,}", f"{row['chunks_read'] / max(1, row['chunks']):.3f}",
         f"{row['points']:,}", f"{row['points_read']:,}", f"{row['points_read'] / max(1, row['points']):.3f}",
         f"{row['survivors']:,}") for row in of(rows, machine=V3_RECORDS.name, memory=LPDDR3)), left=1)


def _energy(rows: Sequence[Row]) -> str:
    lines = []
    for found in _compared(rows):
        lines.append((found[0]["frame"], " / ".join(f"{row['activates']:,}" for row in found), *(
            _beside((row["energy_mj"][part] for row in found), ".3f") for part in ("chip", "dram"))))
    return table(("frame", "activates", "chip, mJ", "DRAM, mJ"), lines, left=1)


def _photographs(content: Mapping[str, Any]) -> str:
    head = ("scene", "size", "points", "levels", "views", "`paper`, dB", "`v3`, dB", "loss, dB", "accepted", "worst view")
    found = table(head, (
        (row["scene"], row["size"], f"{row['points']:,}", row["levels"], row["views"], f"{row['paper_db']:.4f}",
         f"{row['v3_db']:.4f}", f"{row['loss_db']:+.4f}", f"{row['limit_db']:g}", f"{row['worst_view_db']:+.4f}")
        for row in content["photographs"]), left=1)
    if content["missing_runs"]:
        found += f"\n\nNo finished run in build/train: {', '.join(content['missing_runs'])}."
    return found


def _orders(means: Sequence[Row]) -> str:
    keys = ("lpddr3_gain", "ideal_gain", "bytes_gain", "chunks_read")
    return table(("order", "machine", "LPDDR3 cycles", "ideal cycles", "bytes", "chunks read, geometric mean"), (
        (row["order"], row["machine"], *(_number(row[key]) for key in keys)) for row in means), left=2)
