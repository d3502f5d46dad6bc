"""Stimuli of lists by super-tile: pairs in the order of arrival, and what the writer makes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from golden.msv2_ref.tile_lists import TileLists, entry_words, grouped_entries, tile_lists
from golden.msv2_ref.tile_merge import count_tiles, tile_groups
from spec.config import AcceleratorConfig
from spec.constants import ENTRY_BYTES
from spec.memory import BEAT_BITS, BEAT_ENTRIES, DIRECTORY_BEATS, WORD_BITS, WORDS, write_request
from spec.records import intersection, intersection_item
from tb.tile_lists.memory import ADDRESS_BITS
from tb.tile_lists.stimuli import random_entries

_PAIR_WORDS = 8 * ENTRY_BYTES // WORD_BITS


@dataclass(frozen=True)
class Case:
    """Consecutive frames with the same number of lists.

    Attributes:
        name: the case's name, for messages.
        lists: number of lists.
        frames: for each frame (pairs,) Intersection records in the order of arrival; `tile` is the list.
        beta: the merge threshold.
        entries_beats: the size of the memory region of pairs in beats; None for as much as is needed.
        latency: the memory's latency in cycles.
        hesitates: in how many of 256 cycles the memory accepts no request.
        bad: whether the first beat of the pairs is answered with an error.
        origin: the first beat of both regions.
    """

    name: str
    lists: int
    frames: tuple[np.ndarray, ...]
    beta: int = 100
    entries_beats: int | None = None
    latency: int = 100
    hesitates: int = 0
    bad: bool = False
    origin: int = 0x1234567
    placed: list[TileLists] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        if self.entries_beats is None:
            free = max(tile_lists(frame["tile"], self.lists, 1 << 26).beats for frame in self.frames)
            object.__setattr__(self, "entries_beats", free)
        object.__setattr__(self, "placed", [tile_lists(f["tile"], self.lists, self.entries_beats) for f in self.frames])
        used = max(where.beats for where in self.placed) + self._directory
        if used > 1 << ADDRESS_BITS - 1:
            raise ValueError(f"case must fit {1 << ADDRESS_BITS - 1} beats, not {used!r}")

    @property
    def _directory(self) -> int:
        return self.lists * DIRECTORY_BEATS

    @property
    def settings(self) -> dict[str, int]:
        """Values of the device's plain inputs."""
        entries_base = self.origin + self._directory
        return {
            "list_count": self.lists, "beta": self.beta, "entries_beats": self.entries_beats, "directory_base": self.origin,
            "entries_base": entries_base, "latency": self.latency, "hesitates": self.hesitates,
            "bad": entries_base if self.bad else 0}

    def inputs(self, config: AcceleratorConfig) -> dict[str, np.ndarray]:
        """The pairs and the frames' ends."""
        items = np.zeros(sum(len(frame) + 1 for frame in self.frames), intersection_item(config).dtype)
        items["end"][np.cumsum([len(frame) + 1 for frame in self.frames]) - 1] = 1
        for f in intersection(config).fields:
            items[f.name][items["end"] == 0] = np.concatenate([frame[f.name] for frame in self.frames])
        return {"entries": items}

    def expected(self, config: AcceleratorConfig) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Rows of the output streams, and (writes, WORDS) bool: which words of the writes mean something."""
        groups, writes, means = [], [], []
        for frame, where in zip(self.frames, self.placed, strict=True):
            rows = tile_groups(config, count_tiles(where.hits, self.lists)[0], self.lists, self.beta)
            groups.append(grouped_entries(config, frame[where.written], rows))
            rows, filled = self._writes(config, frame, where)
            writes.append(rows)
            means.append(filled)
        return {"written": np.concatenate(writes), "groups": np.concatenate(groups)}, np.concatenate(means)

    def _writes(self, config: AcceleratorConfig, frame: np.ndarray, where: TileLists) -> tuple[np.ndarray, np.ndarray]:
        """The writer's requests of a frame, and which of their words mean something, by walking through its pairs."""
        words = entry_words(config, frame)
        pages = {beat: (t, slot) for t, slot, beat in zip(
            where.page_tile.tolist(), where.page_slot.tolist(), where.page_beat.tolist(), strict=True)}
        entries_base = self.settings["entries_base"]
        requests, waiting = [], {}

        def send(beat: int, pairs: list[np.ndarray]) -> None:
            filled = np.arange(WORDS) < _PAIR_WORDS * len(pairs)
            requests.append((entries_base + beat, np.resize(np.concatenate(pairs), WORDS), (1 << WORDS) - 1, filled))

        for n in np.flatnonzero(where.written).tolist():
            beat, position = divmod(int(where.number[n]), BEAT_ENTRIES)
            if position == 0 and beat in pages:
                tile, slot = pages[beat]
                at = self.origin + tile * DIRECTORY_BEATS + slot // WORDS
                requests.append((at, np.full(WORDS, beat), 1 << slot % WORDS, np.ones(WORDS, bool)))
            _, pairs = waiting.setdefault(int(where.tile[n]), (beat, []))
            pairs.append(words[n])
            if len(pairs) == BEAT_ENTRIES:
                send(*waiting.pop(int(where.tile[n])))
        for tile in sorted(waiting, reverse=True):
            send(*waiting[tile])
        rows = np.zeros(len(requests), write_request(config).dtype)
        for row, (beat, word, strobe, _) in zip(rows, requests, strict=True):
            row["beat"], row["word"], row["strobe"] = beat % (1 << BEAT_BITS), word, strobe
        return rows, np.array([filled for *_, filled in requests], bool).reshape(-1, WORDS)

    def observed(self) -> dict[str, int]:
        """The plain outputs at the end."""
        return {"full": self.placed[-1].full, "list_error": self.bad, "writer_busy": 0, "merge_busy": 0}

    @property
    def pages(self) -> int:
        """Pages beyond first ones that all frames open."""
        return sum(len(where.page_beat) for where in self.placed)


def case(
    config: AcceleratorConfig, rng: np.random.Generator, name: str, lists: int, frames: Sequence[np.ndarray], **options: object,
) -> Case:
    """Frames given by the lists of their pairs; everything else is drawn."""
    pairs = tuple(random_entries(config, rng, np.asarray(numbers, np.int64)) for numbers in frames)
    return Case(name, lists, pairs, origin=int(rng.integers(1, 1 << 26)), **options)
