"""A memory model for the AXI master. It pauses, and it answers late, out of order and with errors; it also checks the master.

The model changes its wires at falling clock edges and reads the master's wires after they have settled at the same edge. If
the master's wires do not move then, no output of the master depends combinationally on READY or on an answer.
"""

from __future__ import annotations

import random
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

from cocotb.triggers import FallingEdge, ReadOnly

from rtl.axi.bus import Response
from spec.memory import BEAT_BYTES, WORDS

_CHANNELS = {
    "aw": ("id", "addr", "len", "size", "burst", "cache", "prot"), "w": ("data", "strb", "last"),
    "ar": ("id", "addr", "len", "size", "burst", "cache", "prot")}
_FIXED = {"len": 0, "size": 5, "burst": 1, "last": 1, "cache": 2, "prot": 0}


@dataclass(frozen=True)
class Temper:
    """The behaviour of a memory.

    Attributes:
        pauses: the fraction of cycles in which a channel pauses, by channel name.
        latency: the least and the largest number of cycles until an answer.
        shuffled: whether answers of different IDs may overtake each other; otherwise all keep the order of their requests.
        failing: every beat address that is a multiple of this number answers with an error; 0 for none.
    """

    pauses: dict[str, float] = field(default_factory=dict)
    latency: tuple[int, int] = (1, 1)
    shuffled: bool = False
    failing: int = 0

    def fails(self, beat: int) -> bool:
        """Whether a request for this beat address answers with an error."""
        return bool(self.failing) and beat % self.failing == 0


@dataclass
class Answer:
    """A transaction that waits for its answer.

    Attributes:
        id: its AXI ID.
        beat: its address in beats.
        due: the first cycle in which it may be answered.
        words, strobe: for a write, the data and the byte strobes.
    """

    id: int
    beat: int
    due: int
    words: int = 0
    strobe: int = 0


def fresh(beat: int) -> int:
    """The content of a beat that nobody has written."""
    return sum((beat * 0x9E3779B1 + word * 0x85EBCA6B + 1 & 0xFFFFFFFF) << 32 * word for word in range(WORDS))


class Memory:
    """The memory model that the module describes.

    Attributes:
        stored: the written beats by address; a write takes effect when it is answered.
        problems: descriptions of the protocol violations.
        cycle: the number of cycles so far.
        reads, writes: the cycles in which each answer on R, or on B, was given.
        turns: the IDs of the addresses accepted on AR and on AW, in order.
    """

    def __init__(self, dut: object, temper: Temper, seed: int, ids: dict[str, int]):
        self._dut, self._temper, self._rng, self._ids = dut, temper, random.Random(seed), ids
        self.stored: dict[int, int] = {}
        self.problems: list[str] = []
        self.cycle, self.reads, self.writes = 0, [], []
        self.turns: dict[str, list[int]] = {"ar": [], "aw": []}
        self._waiting: dict[str, deque[Answer]] = {"r": deque(), "b": deque()}
        self._addresses: deque[tuple[int, int]] = deque()
        self._words: deque[tuple[int, int]] = deque()
        self._offered: dict[str, tuple[int, ...] | None] = dict.fromkeys(_CHANNELS)

    def _wire(self, name: str) -> object:
        return getattr(self._dut, f"m_axi_{name}")

    def _seen(self, channel: str) -> tuple[int, ...] | None:
        """The values that the master offers on a channel, or None where it offers nothing."""
        if not self._wire(f"{channel}valid").value:
            return None
        return tuple(int(self._wire(channel + name).value) for name in _CHANNELS[channel])

    async def run(self) -> None:
        """Answers the master without end."""
        for name in ("arready", "awready", "wready", "rvalid", "bvalid"):
            self._wire(name).value = 0
        while True:
            await FallingEdge(self._dut.clk)
            before = {channel: self._seen(channel) for channel in _CHANNELS}
            ready = {channel: self._rng.random() >= self._temper.pauses.get(channel, 0) for channel in _CHANNELS}
            for channel, value in ready.items():
                self._wire(f"{channel}ready").value = value
            answers = {channel: self._answer(channel) for channel in ("r", "b")}
            await ReadOnly()
            self.cycle += 1
            for channel in _CHANNELS:
                offer = self._seen(channel)
                self._check(channel, before[channel], offer)
                self._offered[channel] = None if ready[channel] else offer
                if ready[channel] and offer is not None:
                    self._take(channel, offer)
            for channel, answer in answers.items():
                if answer is not None:
                    if not self._wire(f"{channel}ready").value:
                        self.problems.append(f"{channel.upper()} was not taken at once")
                    self._done(channel, answer)

    def _check(self, channel: str, before: tuple[int, ...] | None, offer: tuple[int, ...] | None) -> None:
        if before != offer:
            self.problems.append(f"{channel.upper()} depends on READY or on an answer in the same cycle")
        if self._offered[channel] not in (None, offer):
            self.problems.append(f"{channel.upper()} was changed or withdrawn before it was taken")
        if offer is None:
            return
        values = dict(zip(_CHANNELS[channel], offer, strict=True))
        wrong = [name for name, value in _FIXED.items() if values.get(name, value) != value]
        if wrong or values.get("addr", 0) % BEAT_BYTES or values.get("id", 0) >= self._ids.get(channel, 1):
            self.problems.append(f"{channel.upper()} is not a transaction of one aligned beat of a client: {values}")

    def _take(self, channel: str, offer: tuple[int, ...]) -> None:
        due = self.cycle + self._rng.randint(*self._temper.latency)
        if channel == "ar":
            self._waiting["r"].append(Answer(offer[0], offer[1] // BEAT_BYTES, due))
        elif channel == "aw":
            self._addresses.append(offer[:2])
        else:
            self._words.append(offer[:2])
        if channel in self.turns:
            self.turns[channel].append(offer[0])
        while self._addresses and self._words:
            (client, address), (words, strobe) = self._addresses.popleft(), self._words.popleft()
            self._waiting["b"].append(Answer(client, address // BEAT_BYTES, due, words, strobe))

    def _candidates(self, channel: str) -> Iterator[Answer]:
        """The answers that may be given now: each is due, and is the first one that waits with its ID."""
        seen = set()
        for answer in self._waiting[channel]:
            if answer.due <= self.cycle and answer.id not in seen:
                yield answer
            if not self._temper.shuffled:
                return
            seen.add(answer.id)

    def _answer(self, channel: str) -> Answer | None:
        """Drives the wires of R or B with the next answer and returns it, or None where there is none."""
        paused = self._rng.random() < self._temper.pauses.get(channel, 0)
        candidates = [] if paused else list(self._candidates(channel))
        self._wire(f"{channel}valid").value = bool(candidates)
        if not candidates:
            return None
        answer = self._rng.choice(candidates)
        self._waiting[channel].remove(answer)
        failed = self._temper.fails(answer.beat)
        self._wire(f"{channel}id").value = answer.id
        self._wire(f"{channel}resp").value = self._rng.choice((Response.SLVERR, Response.DECERR)) if failed else Response.OKAY
        if channel == "r":
            self._wire("rlast").value = 1
            self._wire("rdata").value = self._rng.getrandbits(8 * BEAT_BYTES) if failed else self.at(answer.beat)
        return answer

    def _done(self, channel: str, answer: Answer) -> None:
        (self.reads if channel == "r" else self.writes).append(self.cycle)
        if channel == "b" and not self._temper.fails(answer.beat):
            self.stored[answer.beat] = merged(self.at(answer.beat), answer.words, answer.strobe)

    def at(self, beat: int) -> int:
        """The content of a beat."""
        return self.stored.get(beat, fresh(beat))


def merged(old: int, new: int, strobe: int) -> int:
    """The beat `old` with the bytes selected by the strobe replaced by those of `new`."""
    mask = sum(0xFF << 8 * byte for byte in range(BEAT_BYTES) if strobe >> byte & 1)
    return old & ~mask | new & mask
