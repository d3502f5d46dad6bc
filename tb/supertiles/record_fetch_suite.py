"""Record fetch's tests: every request, every point and every beat is compared with the golden ones."""

from __future__ import annotations

import numpy as np

from golden.msv2_ref.fetch import find_misses
from rtl.supertiles.record_fetch import LATENCY
from spec.chunks import PLACE_BITS
from spec.config import TINY_V3, V3, AcceleratorConfig
from spec.memory import BEAT_BITS, BEAT_BYTES, colour_beats, read_data, read_request
from spec.queues import HEADERS_MISSED
from spec.supertiles import HEADER_WAYS
from tb.chunks import decode_stimuli
from tb.common import exact
from tb.common.exact import Outcome, Planned, every_pattern, planned
from tb.common.scenes import traced_frames, traced_size
from tb.supertiles.record_fetch_device import MOST_DELAY, playback
from tb.supertiles.record_fetch_stimuli import (
    DIRECTED,
    Case,
    cloud_model,
    header_bytes,
    points_of,
    pooled_case,
    random_case,
    random_model,
    stored_model,
    walking_case,
)

VARIANTS: dict[str, AcceleratorConfig] = {"tiny_v3": TINY_V3, "v3": V3}
"""Configurations that can be tested."""

DISTINCT = ("tiny_v3", "v3")

PORTS = ("sorted", "data_chunks", "data_colour", "points", "beats", "reads_chunks", "reads_colour")

DELAY = 129
"""One less than the latency of the memory, in cycles, in the runs that check the rate."""

LAG = 220
"""Cycles that a point's beats wait for the colour unit in a run that checks the rate."""


class Plan:
    """Runs, and a model of what the cache holds from one run to the next.

    Attributes:
        runs: the runs added so far.
    """

    def __init__(self, config: AcceleratorConfig, seed: int):
        self.runs: list[Planned] = []
        self._config, self._rng = config, np.random.default_rng(seed)
        self._frame = 0
        self._empty()

    def _empty(self) -> None:
        """Nothing is in the cache, and nothing has been counted."""
        self._numbers, self._headers = np.empty(0, np.int64), decode_stimuli.headers(self._config, self._rng, 0, False)
        self._counted, self._wrong = [0, 0], 0

    def add(
        self, case: Case, name: str | None = None, *, clear: bool = True, reset: bool = True, delay: int = 7,
        delay_chunks: int | None = None, sh_degree: int = 0, lag: int = 0, wrong: tuple[int, ...] = (),
        wrong_headers: tuple[int, ...] = (), **options: object,
    ) -> Planned:
        """Adds the run that plays a case.

        Args:
            case: the case to play.
            name: the run's name; None for the case's name.
            clear: whether to strobe `clear` before the run, so that nothing from the previous run is found in the cache.
            reset: whether to reset the unit before the run.
            delay: the memory's latency in cycles, less one.
            delay_chunks: the same for headers, if it is another.
            sh_degree: that of the frame.
            lag: cycles that beats wait for the colour unit after their point.
            wrong, wrong_headers: numbers of the beats of `data_colour` and `data_chunks` that have an error, and any words.
            options: further arguments of `planned`.
        """
        config, rng = self._config, self._rng
        if clear:
            self._frame = (self._frame + 1) % 256
        if clear or reset:
            self._empty()
        missed, header_beats, of = self._look(case, wrong_headers)
        base_chunks, base_colour = (int(rng.integers(1 << BEAT_BITS)) for _ in range(2))
        numbers, per_pair = case.index >> PLACE_BITS, colour_beats(config, sh_degree)
        gaussian = (of["first"].astype(np.int64) + (case.index & (1 << PLACE_BITS) - 1)) % (1 << 24)
        asked = (gaussian[:, None] * per_pair + np.arange(per_pair)).ravel()
        beats = rng.integers(0, 256, (len(case.index), per_pair, BEAT_BYTES), np.uint8)
        beats[:, 0] = case.model.records[case.model.split(case.index)[1]]
        beats.reshape(-1, BEAT_BYTES)[list(wrong)] = rng.integers(0, 256, (len(wrong), BEAT_BYTES), np.uint8)
        self._wrong |= bool(wrong or wrong_headers)
        data = self._data(beats.reshape(-1, BEAT_BYTES), wrong)
        passed = data.copy()
        passed["error"] = 0
        settings = {
            "chunks_base": base_chunks, "colour_base": base_colour, "sh_degree": sh_degree, "frame": self._frame,
            "delay_chunks": delay if delay_chunks is None else delay_chunks, "delay_colour": delay, "lag": lag}
        item = planned(
            name or case.name,
            {"sorted": case.sorted(config, rng), "data_chunks": self._data(header_beats, wrong_headers), "data_colour": data},
            {"points": points_of(config, of, beats[:, 0], case.index), "beats": passed,
             "reads_chunks": self._requests(base_chunks, numbers[missed]),
             "reads_colour": self._requests(base_colour, asked)},
            reset=reset, settings=settings,
            observed={"busy": 0, "hits": self._counted[0], "misses": self._counted[1], "error": self._wrong}
            if options.get("quiet", 1) else None, **options)
        self.runs.append(item)
        return item

    def _look(self, case: Case, wrong: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(which pairs miss (P,), the headers' beats (misses, BEAT_BYTES), the header that each pair finds in its line (P,)).
        """
        config, before = self._config, len(self._numbers)
        self._numbers = np.concatenate([self._numbers, case.index >> PLACE_BITS])
        missed = find_misses(self._numbers, np.zeros_like(self._numbers), config.header_lines, HEADER_WAYS, False, False)
        missed = missed[before:]
        self._counted[0] += int((~missed).sum())
        self._counted[1] += int(missed.sum())
        loaded = case.model.chunks[case.model.split(case.index[missed])[0]]
        loaded[list(wrong)] = decode_stimuli.headers(config, self._rng, len(wrong), self._rng.random(len(wrong)) < 0.5)
        self._headers = np.concatenate([self._headers, np.zeros(len(case.index), self._headers.dtype)])
        self._headers[before:][missed] = loaded
        latest: dict[int, int] = {}  # by chunk, its last access, whose header a hit finds again
        for access, number in enumerate(self._numbers.tolist()):
            if access >= before and not missed[access - before]:
                self._headers[access] = self._headers[latest[number]]
            latest[number] = access
        return missed, header_bytes(config, loaded, self._rng), self._headers[before:]

    def _data(self, beats: np.ndarray, wrong: tuple[int, ...]) -> np.ndarray:
        out = np.zeros(len(beats), read_data(self._config).dtype)
        out["word"] = np.ascontiguousarray(beats).view("<u4")
        out["error"][list(wrong)] = 1
        return out

    def _requests(self, base: int, beats: np.ndarray) -> np.ndarray:
        out = np.zeros(len(beats), read_request(self._config).dtype)
        out["beat"] = (base + beats) % (1 << BEAT_BITS)
        return out


def unit_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Cases by hand and at random, with every pattern of pauses, latency and both kinds of frames; runs cut off; runs back to
    back with cleared and with kept cache; errors of the memory."""
    plan, rng, lines = Plan(config, seed), np.random.default_rng(seed), config.header_lines
    for k, (chunks, colour) in enumerate(((0, 0), (1, 1), (30, 5), (5, 30), (MOST_DELAY - 1, 130))):
        for i, make in enumerate(DIRECTED):
            case, degree = make(config, rng), (0, 3, 1, 2)[(k + i) % 4]
            plan.add(case, f"{case.name}, {chunks} and {colour} cycles, degree {degree}", delay=colour, delay_chunks=chunks,
                     sh_degree=degree)
        plan.add(random_case(config, "", seed * 100 + k), f"random, {chunks} and {colour} cycles", delay=colour,
                 delay_chunks=chunks, sh_degree=3 * (k % 2))
    plan.add(Case("no pair", random_model(config, rng, [3]), np.empty(0, np.int64), 4))
    for degree in (0, 3):
        case = random_case(config, "streams", seed + degree, pairs=400)
        for name, patterns in every_pattern(PORTS, seed).items():
            plan.add(case, f"{name}, degree {degree}", patterns=patterns, reset=False, delay=len(plan.runs) % 20,
                     delay_chunks=len(plan.runs) % 13, sh_degree=degree)
    for cycles in (3, lines // 8, lines // 4 + 40, lines // 4 + 150, lines // 4 + 151):
        plan.add(random_case(config, "", seed), f"cut off after {cycles} cycles", abort=cycles, sh_degree=3)
        plan.add(random_case(config, "", seed + 1), f"whole frame after a reset at {cycles}")
    for k in range(4):
        plan.add(random_case(config, "", seed + 2 + k % 2), f"back to back, cleared {k}", reset=False, quiet=0,
                 sh_degree=3 * (k % 2))
    few = random_model(config, rng, rng.integers(1, 9, lines // 2))
    for k in range(4):
        plan.add(Case("", few, few.index), f"back to back, kept {k}", reset=False, clear=k == 0, quiet=0)
    plan.add(case, "no error", reset=False)
    plan.add(random_case(config, "", seed + 6), "error of records", wrong=(3, 17, 18), reset=False, sh_degree=2)
    plan.add(random_case(config, "", seed + 6), "error stays", clear=False, reset=False)
    plan.add(random_case(config, "", seed + 7), "error cleared", reset=False)
    plan.add(random_case(config, "", seed + 8), "error of headers", wrong_headers=(0, 2, 9), reset=False)
    plan.add(random_case(config, "", seed + 9), "error of headers cleared", reset=False, sh_degree=1)
    return plan.runs


def model_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """A model from the host: points must be those of the first phase, from the records of geometry."""
    plan, rng = Plan(config, seed), np.random.default_rng(seed)
    model, points = cloud_model(config, rng, 3000)
    order = rng.permutation(len(points))
    item = plan.add(Case("model of the host", model, model.index[order]))
    assert (item.expected["points"] == points[order]).all()
    return plan.runs


def rate_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Runs that must take one pair per cycle, or one in two with harmonics, with a memory latency of DELAY + 1 cycles: only
    hits, one miss in five pairs, and with beats that wait. Where all pairs miss, HEADERS_MISSED headers are outstanding."""
    plan, pairs, more = Plan(config, seed), 3000, DELAY + LATENCY + 10
    pool = pooled_case(config, "", seed, config.header_lines)
    hits = Case("", pool.model, np.resize(pool.index, pairs))
    plan.add(pool, "before the rates", delay=DELAY)
    kept = {"clear": False, "reset": False, "delay": DELAY}
    plan.add(hits, "rate, hits", most_cycles=pairs + more, **kept)
    plan.add(hits, "rate, hits with harmonics", sh_degree=3, most_cycles=2 * pairs + more, **kept)
    plan.add(hits, f"rate, beats wait {LAG} cycles", lag=LAG, most_cycles=pairs + more + LAG, **kept)
    plan.add(hits, f"rate, beats with harmonics wait {LAG} cycles", lag=LAG, sh_degree=3, most_cycles=2 * pairs + more + LAG,
             **kept)
    start = config.header_lines // HEADER_WAYS
    plan.add(walking_case(config, "", seed, pairs, 5), "rate, a miss in five", delay=DELAY,
             most_cycles=start + pairs + more + DELAY)
    plan.add(walking_case(config, "", seed, pairs, 1), "rate, misses", delay=DELAY,
             most_cycles=start + pairs * (DELAY + 10) // HEADERS_MISSED + more + DELAY)
    return plan.runs


def traced_plan(config: AcceleratorConfig, size: str) -> list[Planned]:
    """The pairs of frames of real scenes, in rendering order; points must be those of the first phase."""
    plan = Plan(config, 0)
    for name, frame in traced_frames(config, size).items():
        model, points = stored_model(config, frame.words)
        item = plan.add(Case("", model, frame.pairs.index.astype(np.int64)), f"traced {name}", delay=DELAY,
                        sh_degree=frame.words.sh_degree)
        assert (item.expected["points"] == points[frame.pairs.splat]).all()
    return plan.runs


def quick_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs but those of real scenes."""
    return [*unit_plan(config, seed), *model_plan(config, seed), *rate_plan(config, seed)]


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """All runs."""
    return [*quick_plan(config, seed), *traced_plan(config, traced_size(config, "256x144", "128x128"))]


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """One line per run at full rate with its misses and its speed."""
    lines = []
    for item, recording in exact.at_full_rate(plan, outcome):
        pairs, misses = len(item.expected["points"]), len(item.expected["reads_chunks"])
        lines.append(f"{item.name}: {pairs} pairs, {misses / pairs:.3f} of them missed, {recording.cycles} cycles, "
                     f"{pairs / recording.cycles:.4f} pairs a cycle")
    return lines


run_plan = exact.runner(playback)
"""Plays a plan and compares all results."""
