"""The batch buffer's tests: visits and entries must be those that `spec.supertiles` wants, less what belongs to tiles that have
stopped."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from golden.msv2_ref.batches import FrameBatches
from golden.msv2_ref.joint import JointFrame
from golden.msv2_ref.joint_batches import JointBatches
from golden.msv2_ref.pipeline import Frame
from rtl.supertiles.batch_buffer import LATENCY
from rtl.supertiles.batch_masks import mask_places, mask_words
from spec.config import TINY_EYES, TINY_V3, V3, V3_EYES, AcceleratorConfig
from spec.constants import MAX_LEVELS, SUPER_TILES
from spec.memory import SHIFT_BITS
from spec.supertiles import SEQUENCE_BITS
from tb.common import exact
from tb.common.exact import Outcome, every_pattern
from tb.common.playback import ERRORS
from tb.common.player import Recording, Run
from tb.common.runner import Waves
from tb.common.scenes import traced_frames, traced_joint_frames, traced_size
from tb.supertiles.batch_device import LATE, Mode, playback
from tb.supertiles.batch_stimuli import (
    DIRECTED,
    EVERY,
    Batch,
    Case,
    Tiles,
    Visit,
    case_of,
    few_entries,
    place_behind_word,
    random_case,
    wanted_batches,
    wanted_visits,
)
from tb.supertiles.joint_stimuli import JOINT, random_joint_case

VARIANTS: dict[str, AcceleratorConfig] = {
    "tiny_v3": TINY_V3, "16-places": TINY_V3.with_(batch_places=16), "v3": V3, "tiny_eyes": TINY_EYES,
    "16-places-eyes": TINY_EYES.with_(batch_places=16), "v3_eyes": V3_EYES}
"""Configurations that can be tested."""

DISTINCT = tuple(VARIANTS)
"""Configurations with different units: two words of masks a tile, half a word, and 16 words, for one eye and for two."""

PORTS = ("supertiles", "places", "visits", "entries")

EXCESS = ERRORS[4]

BETWEEN = 2
"""Cycles without a place between two batches."""

MOST_ENTRIES = 4
"""Most entries of a tile that leave after the one with which it stops: those between the memory of masks and the port."""

MOST_VISITS = 5
"""Most visits that follow the one in which a tile stopped, and were chosen before."""


@dataclass(frozen=True)
class Planned(exact.Planned):
    """A run with the visits that are wanted where no tile stops, and when tiles stop."""

    visits: list[Visit] = field(default_factory=list)
    mode: Mode = Mode.NEVER
    limit: int = 0


def settings_of(config: AcceleratorConfig, case: Case, mode: Mode, limit: int, frame: int) -> dict[str, int]:
    """The settings of a run."""
    joint = {"joint": int(case.joint), "shift": case.shift % (1 << SHIFT_BITS)} if config.joint else {}
    return {"mode": int(mode), "limit": limit, "frame": frame} | joint


class Plan:
    """Runs, and the number of the next super-tile.

    Attributes:
        runs: the runs added so far.
    """

    def __init__(self, config: AcceleratorConfig):
        self.runs: list[Planned] = []
        self._config, self._frame, self._sequence = config, 0, 0

    def add(
        self, case: Case, name: str | None = None, *, mode: Mode = Mode.NEVER, limit: int = 0, reset: bool = True,
        most_cycles: int | None = None, least_rate: Mapping[str, float] | None = None, **options: object,
    ) -> None:
        """Adds the run that plays a case; further options are those of `Run`. Where tiles stop, the number of items is not
        known beforehand: the run ends when nothing has left for a while, and `problems` judges what came."""
        self._frame = (self._frame + 1) % 256
        first = 0 if reset else self._sequence
        visits = wanted_visits(self._config, case, first)
        self._sequence = (first + len(case.supertiles) // case.eyes) % (1 << SEQUENCE_BITS)
        exactly = mode in (Mode.NEVER, Mode.STALE)
        expected = {"visits": np.array([visit.row for visit in visits]),
                    "entries": np.concatenate([visit.entries for visit in visits])} if exactly else {}
        counts = {"visits": len(expected["visits"]), "entries": len(expected["entries"])} if exactly else {
            "visits": 0, "entries": 0}
        observed = {"batches": len(wanted_batches(self._config, case)), "busy": 0}
        if exactly:
            observed["visits_count"] = len(visits)
        quiet = options.pop("quiet", 200 if exactly else 400)
        run = Run(name or case.name, {"supertiles": case.supertiles, "places": case.places}, counts,
                  settings_of(self._config, case, mode, limit, self._frame), reset=reset, quiet=quiet, **options)
        self.runs.append(Planned(run, expected, observed if quiet else {}, least_rate or {}, most_cycles, visits, mode, limit))


def most_cycles(config: AcceleratorConfig, case: Case, stream: int = 0) -> int:
    """Cycles of a run without pauses in which no tile stops, at most; of several streams, only `stream` may have many entries.

    A batch is filled at a place a cycle once its half is free and the batch before it is complete. It is dealt at an item a
    cycle once it is complete and the batch before it is dealt. It is complete when the masks of its last group of places have
    moved on (`group_wait`).
    """
    dealt: Counter[int] = Counter()
    for visit in wanted_visits(config, case, stream=stream):
        dealt[visit.batch] += len(visit.entries)
    filled = left = 2
    free = [0, 0]
    for number, batch in enumerate(wanted_batches(config, case)):
        filled = max(filled + BETWEEN + case.joint, free[number % 2]) + len(batch.places)
        filled += group_wait(config, case, batch)
        left = max(left, filled + LATENCY - 1) + dealt[number]
        free[number % 2] = left
    return left


def group_wait(config: AcceleratorConfig, case: Case, batch: Batch) -> int:
    """Cycles for which the masks of a batch's last group of places wait for those of the group before. These are written a tile
    in a cycle while the last group comes, a place in a cycle."""
    size, count = mask_places(config), len(batch.places)
    last = (count - 1) % size + 1
    before = case.places[batch.places[: count - last][-size:]]
    tiles: list[set[tuple[int, int]]] = [set() for _ in range(config.streams)]
    for place, masks in zip(before, before["mask"].reshape(len(before), config.streams), strict=True):
        eye = int(place["eye"]) if config.joint else 0
        levels = case.supertiles["level"][batch.supertile * case.eyes + eye]
        for own, mask in zip(tiles, masks.tolist(), strict=True):
            own |= {(eye, tile) for tile in range(SUPER_TILES) if mask >> tile & 1 and levels[tile] == place["level"]}
    return max(0, *(len(own) - last for own in tiles))


def cleared(entries: np.ndarray) -> np.ndarray:
    """Entries whose ends have 0 in the fields that mean nothing."""
    cleared = np.zeros_like(entries)
    cleared["end"] = entries["end"]
    cleared[entries["end"] == 0] = entries[entries["end"] == 0]
    return cleared


def problems(item: Planned, recording: Recording, most_entries: int = MOST_ENTRIES) -> list[str]:
    """What is wrong with a recording. `most_entries` is the number of entries of a tile that may leave after it has stopped."""
    recording = replace(recording, outputs={**recording.outputs, "entries": cleared(recording.outputs["entries"])})
    if item.mode in (Mode.NEVER, Mode.STALE):
        return exact.problems(item, recording)
    left = replace(recording, errors=tuple(error for error in recording.errors if error != EXCESS))
    return [*exact.problems(item, left), *_stopped_problems(item, recording, most_entries)]


def tile_of(visit: np.void) -> int:
    """The number of a visit's tile among those of both eyes."""
    eye = int(visit["eye"]) if "eye" in visit.dtype.names else 0
    return SUPER_TILES * eye + int(visit["place"])


def _stopped_problems(item: Planned, recording: Recording, most_entries: int) -> list[str]:
    """What is wrong where tiles stop: every visit and every entry that is missing must be one of a tile that has stopped, and
    no more of them may come than were on their way."""
    rows, entries = recording.outputs["visits"], recording.outputs["entries"]
    ends = np.flatnonzero(entries["end"]) + 1
    if len(ends) != len(rows) or not len(ends) or ends[-1] != len(entries):
        return [f"{len(rows)} visits have {len(ends)} ends"]
    late = LATE if item.mode is Mode.LATE else 0
    wanted, found = deque(item.visits), []
    counts, stopped = Counter(), {}  # by tile: its entries in this super-tile; the visit in which it stopped
    for number, (row, mine) in enumerate(zip(rows, np.split(entries, ends[:-1]), strict=True)):
        if number and row["sequence"] != rows[number - 1]["sequence"]:
            counts, stopped = Counter(), {}
        while wanted and wanted[0].row.tobytes() != row.tobytes():
            missing = wanted.popleft().row
            if missing["final"] or missing["fresh"] or tile_of(missing) not in stopped:
                found.append(f"a visit before visit {number} is missing: {missing}")
        if not wanted:
            return [*found, f"visit {number} is not wanted: {row}"]
        whole, tile = wanted.popleft().entries, tile_of(row)
        limit, before, count = item.limit + tile, counts[tile], len(mine) - 1
        counts[tile] += count
        beyond = count if before >= limit else 0 if item.mode is Mode.AT_END else counts[tile] - limit
        if len(mine) > len(whole) or (mine[:-1] != whole[:count]).any():
            found.append(f"visit {number} has other entries than it should have")
        if len(mine) < len(whole) and (before if item.mode is Mode.AT_END else counts[tile]) < limit:
            found.append(f"visit {number} has {count} entries, not {len(whole) - 1}, and its tile has not stopped")
        if beyond > most_entries + late:
            found.append(f"visit {number} has {beyond} entries of a tile that has stopped")
        if tile in stopped and not row["final"] and number - stopped[tile] > MOST_VISITS + late:
            found.append(f"visit {number} is of a tile that stopped in visit {stopped[tile]}")
        if counts[tile] >= limit:
            stopped.setdefault(tile, number)
    found += [f"a visit is missing at the end: {visit.row}" for visit in wanted]
    if recording.observed["visits_count"] != len(rows):
        found.append(f"visits_count is {recording.observed['visits_count']}, not {len(rows)}")
    return found


def add_cases(plan: Plan, config: AcceleratorConfig, seed: int, ports: Sequence[str]) -> None:
    """Adds cases by hand and at random, with every pattern of pauses at `ports`, cut off, and back to back. `plan` may be that
    of `tb.supertiles.stream_suite`, too."""
    places = config.batch_places
    for make in (*DIRECTED, place_behind_word):
        plan.add(make(config))
    for k in range(4):
        plan.add(random_case(config, f"random {k}", seed * 100 + k))
    case = random_case(config, "streams", seed, supertiles=6)
    for name, patterns in every_pattern(ports, seed).items():
        plan.add(case, name, patterns=patterns)
    for cycles in (3, places // 2, places + 20, 3 * places):
        plan.add(random_case(config, "", seed), f"cut off after {cycles} cycles", abort=cycles)
        plan.add(random_case(config, "", seed + 1, supertiles=3), f"whole frame after a reset at {cycles}")
    for k in range(4):
        plan.add(random_case(config, "", seed + 2 + k % 2, supertiles=5), f"back to back {k}", reset=k == 0, quiet=0)
    plan.add(random_case(config, "tiles of the super-tile before have stopped", seed), mode=Mode.STALE)
    if config.joint:
        _add_joint_cases(plan, config, seed, ports)


def _add_joint_cases(plan: Plan, config: AcceleratorConfig, seed: int, ports: Sequence[str]) -> None:
    """Adds joint frames, between frames of one eye, too."""
    places = config.batch_places
    for make in JOINT:
        plan.add(make(config))
    for k in range(4):
        plan.add(random_joint_case(config, f"joint {k}", seed * 100 + k))
    case = random_joint_case(config, "joint streams", seed, supertiles=6)
    for name, patterns in every_pattern(ports, seed).items():
        plan.add(case, f"joint, {name}", patterns=patterns)
    for cycles in (3, places + 20):
        plan.add(random_joint_case(config, "", seed), f"joint, cut off after {cycles} cycles", abort=cycles)
        plan.add(random_joint_case(config, "", seed + 1, supertiles=3), f"whole joint frame after a reset at {cycles}")
    for k in range(6):
        make = random_case if k % 3 == 1 else random_joint_case
        plan.add(make(config, "", seed + 2 + k % 2, supertiles=5), f"joint, back to back {k}", reset=k == 0, quiet=0)
    plan.add(random_joint_case(config, "joint, tiles of the super-tile before have stopped", seed), mode=Mode.STALE)


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """The cases of `add_cases`, one in which places must not wait, and those of tiles that stop."""
    plan = Plan(config)
    add_cases(plan, config, seed, PORTS)
    if mask_words(config) > 1:
        case = few_entries(config)
        stalls = BETWEEN * len(wanted_batches(config, case)) + BETWEEN
        plan.add(case, mode=Mode.AT_ONCE, limit=1, least_rate={"places": len(case.places) / (len(case.places) + stalls)})
    return [*plan.runs, *stop_plan(config, seed)]


def stop_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Runs in which tiles stop: at their first entry, in the first batch of many, and late; without and with pauses."""
    plan, places = Plan(config), config.batch_places
    dense = case_of(config, "dense", [
        Tiles([EVERY] * places * 3), Tiles([1] * places * 3, inside=1), Tiles([]), Tiles([0x8001] * places * 2),
        Tiles([EVERY] * (places // 2))], seed)
    last = places - MAX_LEVELS  # last place of a full batch; the word of a batch's last tile is written last
    masks = [EVERY if place == last - batch else EVERY >> 1 for batch in range(12) for place in range(last + 1)]
    plan.add(case_of(config, "only the last tile goes on", [Tiles(masks)], seed), mode=Mode.AT_ONCE, limit=1)
    for mode in (Mode.AT_ONCE, Mode.AT_END, Mode.LATE):
        for limit in (1, 2, places // 2, 2 * places):
            plan.add(dense, f"dense, {mode.name.lower()} after {limit}", mode=mode, limit=limit)
            case = random_case(config, "", seed + limit, supertiles=5, mean_pairs=4 * places, density=0.4)
            plan.add(case, f"random, {mode.name.lower()} after {limit}", mode=mode, limit=limit)
        case = random_case(config, "", seed, supertiles=4, mean_pairs=2 * places, density=0.4)
        for name, patterns in every_pattern(PORTS, seed).items():
            plan.add(case, f"{mode.name.lower()}, {name}", mode=mode, limit=places // 3, patterns=patterns)
        for limit in (1, places // 2) if config.joint else ():
            case = random_joint_case(config, "", seed + limit, supertiles=5, mean_pairs=3 * places, density=0.4)
            plan.add(case, f"joint, {mode.name.lower()} after {limit}", mode=mode, limit=limit)
    return plan.runs


def rate_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Runs that must keep up a place and an entry a cycle: few tiles a pair, where filling limits, and many."""
    plan = Plan(config)
    for density, supertiles in ((0.0, 6), (0.1, 6), (0.4, 4), (1.0, 3)):
        case = random_case(config, f"rate, {density} of the tiles", seed, supertiles=supertiles,
                           mean_pairs=5 * config.batch_places, density=density)
        plan.add(case, most_cycles=most_cycles(config, case))
        if config.joint:
            case = random_joint_case(config, f"rate, {density} of the tiles of both eyes", seed, supertiles=supertiles,
                                     mean_pairs=3 * config.batch_places, density=density)
            plan.add(case, most_cycles=most_cycles(config, case))
    for make in (*DIRECTED, *(JOINT if config.joint else ())):
        case = make(config)
        plan.add(case, f"rate, {case.name}", most_cycles=most_cycles(config, case))
    return plan.runs


def traced_plan(config: AcceleratorConfig, frames: Mapping[str, Frame]) -> list[Planned]:
    """Rendered frames, compared with the golden renderer's own visits, and once more with tiles that stop as in Mode.AT_ONCE
    after as many entries as half of a tile's have. Raises AssertionError where the golden renderer and the suite want different
    visits."""
    plan = Plan(config)
    for name, frame in frames.items():
        golden = FrameBatches(frame)
        case = Case(f"traced {name}", golden.supertile_records, golden.place_records)
        plan.add(case, most_cycles=most_cycles(config, case))
        for port, rows in (("visits", golden.visit_records), ("entries", golden.entry_records)):
            assert np.array_equal(plan.runs[-1].expected[port], rows), f"{name}: {port} are not those of the golden renderer"
        limit = len(golden.entry_records) // (2 * len(np.unique(golden.visits.tile)))
        plan.add(case, f"tiles stop, {name}", mode=Mode.AT_ONCE, limit=limit)
    return plan.runs


def joint_traced_plan(config: AcceleratorConfig, frames: Mapping[str, JointFrame]) -> list[Planned]:
    """Rendered joint frames, compared as those of `traced_plan`."""
    plan = Plan(config)
    for name, frame in frames.items():
        golden = JointBatches(frame)
        case = Case(f"traced {name}", golden.supertile_records, golden.place_records, True, frame.registers.shift)
        plan.add(case, most_cycles=most_cycles(config, case))
        for port, rows in zip(("visits", "entries"), golden.stream_records(), strict=True):
            assert np.array_equal(plan.runs[-1].expected[port], rows), f"{name}: {port} are not those of the golden renderer"
        plan.add(case, f"tiles stop, {name}", mode=Mode.AT_ONCE, limit=20)
    return plan.runs


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    frames = traced_frames(config, traced_size(config, "256x144", "128x128"))
    joint = joint_traced_plan(config, traced_joint_frames(config, "128x128")) if config.joint else []
    return [*unit_plan(config, seed), *rate_plan(config, seed), *traced_plan(config, frames), *joint]


def run_plan(
    config: AcceleratorConfig, plan: Sequence[Planned], folder: Path, *, waves: Waves | None = None, progress: bool = False,
) -> Outcome:
    """Plays a plan and compares all results."""
    return exact.run_plan(playback(config), plan, folder, waves=waves, progress=progress, judge=problems)


def figures(config: AcceleratorConfig, plan: Sequence[Planned], outcome: Outcome) -> list[str]:
    """One line per run at full rate with its speed, and one per run with stops with the share of entries that were left out."""
    lines = []
    for item, recording in exact.recorded(plan, outcome):
        entries, places = recording.items["entries"], recording.items["places"]
        if item.most_cycles is not None:
            lines.append(f"{item.name}: {places} places, {recording.items['visits']} visits, {entries} entries and ends, "
                         f"{recording.cycles} cycles of at most {item.most_cycles}")
        elif item.visits and item.mode not in (Mode.NEVER, Mode.STALE) and not item.run.patterns:
            whole = sum(len(visit.entries) for visit in item.visits)
            lines.append(f"{item.name}: {1 - entries / whole:.3f} of {whole} entries and ends were left out")
    return lines
