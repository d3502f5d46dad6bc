"""The bench of a proof: a component, the world around it, and claims of what can never happen.

The bench gives every port of a component a partner, which it finds by the component's signature:

* To an input stream it offers any items at any time, and holds each until it is taken. This is the stream contract, as the
  sender keeps it.
* An output stream may be taken, or not, in every cycle.
* A memory answers the requests of `reads` on `data` (or `reads_x` on `data_x`) in order, after any time, and never without a
  request. `writes_idle` is high where it has completed all writes that it took.
* `start`, `begin` and other strobes may come in every cycle in which the unit is not busy.
* `clear` and `abort` do not come: they belong between two frames.
* Parts of an interface that is no stream have any value in every cycle.
* Any other input has any value, which stays the same for ever, as a setting of a frame does; inputs that are named `free` have
  any value in every cycle.

So a claim that is proven holds for all senders, receivers, settings and memories at once. Registers begin with any values, then
there is one cycle of reset.

A claim is a sentence of the form: when W, never B. It is worth nothing where W cannot happen, so its canary says that W never
happens, and has to fail. Where it does not, the proof counts for nothing.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from amaranth.hdl import Cat, ClockDomain, Const, Module, Mux, Shape, ShapeLike, Signal, Value, ValueLike
from amaranth.lib import stream, wiring

from msv2.cases.formal.circuit import KEPT

MOST_ASKED = 7
"""Requests that a memory of a bench has at most open. More wait."""


ZERO = ("clear", "forget", "abort", "clear_errors")
"""Inputs that belong between two frames; a proof is about one frame of any length."""

STROBES = ("start", "begin")
"""Inputs that may come in every cycle in which a unit with an output `busy` is not busy."""


@dataclass(frozen=True)
class End:
    """A stream of the component and what the bench does at its other side.

    Attributes:
        name: the port's name, with its position where there are several.
        port: the stream.
        moves: an item is transferred in this cycle.
    """

    name: str
    port: stream.Interface
    moves: Signal

    @property
    def item(self) -> Value:
        """The bits of the payload."""
        return Value.cast(self.port.payload)


@dataclass(frozen=True)
class Claim:
    """What can never happen.

    Attributes:
        name: what is claimed, in a few words.
        bad: one bit; the claim says that it is 0 for ever.
        canary: one bit that must become 1 sometime.
    """

    name: str
    bad: Signal
    canary: Signal


class Bench:
    """A component in the world of a proof.

    Args:
        unit: the component.
        free: inputs that have any value in every cycle.
        held: inputs that have one value, by name.
        memories: further pairs of stream names, requests and answers.
        own: names of inputs and streams that the caller drives.
        narrow: for an input stream, fields of its items of which only so many bits are used; the others are 0.
        taken: output streams whose receivers have always free space: every item is taken at once.
        loose: output streams that may change or withdraw what they offer; their docstrings have to say so.

    Raises:
        ValueError: a name is none of the unit's.
    """

    def __init__(
        self, unit: wiring.Component, *, free: Iterable[str] = (), held: Mapping[str, int] | None = None,
        memories: Iterable[tuple[str, str]] = (), own: Iterable[str] = (),
        narrow: Mapping[str, Mapping[str, int]] | None = None, taken: Iterable[str] = (), loose: Iterable[str] = (),
    ):
        self.m, self.unit = Module(), unit
        self.inputs: list[Value] = []
        self.claims: list[Claim] = []
        self.sinks: dict[str, End] = {}
        self.sources: dict[str, End] = {}
        self.strobes: list[Value] = []
        self._assumed: list[Value] = []
        self.live = Signal(reset_less=True, attrs={KEPT: 1})
        self.m.domains.sync = domain = ClockDomain("sync")
        self.inputs.append(domain.clk)  # without it Amaranth would give all registers a constant as their clock
        self.m.d.comb += domain.rst.eq(~self.live)
        self.m.d.sync += self.live.eq(1)
        self._sound, self._now, self._numbers = Signal(name="sound", init=1), Signal(name="sound_now"), 0
        self._narrow, self.taken, self.loose = dict(narrow or {}), set(taken), set(loose)
        self.m.submodules.unit = unit
        self._surround(unit, set(free), dict(held or {}), dict(memories), set(own))

    # --- what the world may do ---

    def any(self, shape: ShapeLike, name: str) -> Any:
        """A value that may be another one in every cycle."""
        found = Signal(shape, name=f"any_{name}")
        self.inputs.append(Value.cast(found))
        return found

    def some(self, shape: ShapeLike, name: str) -> Any:
        """A value that stays the same: a register that nothing sets."""
        found = Signal(Shape.cast(shape), name=f"some_{name}", reset_less=True)
        self.m.d.sync += found.eq(found)
        return found

    def assume(self, condition: ValueLike) -> None:
        """Only worlds in which a condition has always held are looked at."""
        self._assumed.append(Value.cast(condition))

    # --- what is claimed ---

    def never(self, name: str, bad: ValueLike, *, when: ValueLike) -> None:
        """Claims that `bad` never comes together with `when`. The canary is `when`."""
        place = len(self.claims)
        claim = Claim(name, Signal(name=f"bad_{place}"), Signal(name=f"canary_{place}"))
        self.m.d.comb += [claim.canary.eq(self.live & self._now & Value.cast(when).any()),
                          claim.bad.eq(claim.canary & Value.cast(bad).any())]
        self.claims.append(claim)

    # --- helpers for claims ---

    def register(self, name: str, shape: ShapeLike = 1, init: int = 0) -> Signal:
        """A register of the bench, for claims."""
        return Signal(Shape.cast(shape), name=f"{name}_{self._number()}", init=init)

    def before(self, value: ValueLike, init: int = 0) -> Signal:
        """A value as it was a cycle ago; `init` in the first cycle after reset."""
        value = Value.cast(value)
        last = Signal(value.shape(), init=init, name=f"before_{self._number()}")
        self.m.d.sync += last.eq(value)
        return last

    def count(self, up: ValueLike, down: ValueLike, most: int, name: str = "level") -> Signal:
        """A count of ups minus downs, two's complement, that neither wraps below `most` + 4 nor above -4."""
        found = Signal(Shape(max(most + 4, 8).bit_length() + 1, signed=True), name=f"{name}_{self._number()}")
        stays = (found == -4) | (found == most + 4)
        with self.m.If(~stays):
            self.m.d.sync += found.eq(found + Value.cast(up) - Value.cast(down))
        return found

    def cycles(self, condition: ValueLike, most: int) -> Signal:
        """For how many cycles in a row, before this one, a condition has held, up to `most`."""
        found = Signal(range(most + 1), name=f"cycles_{self._number()}")
        self.m.d.sync += found.eq(Mux(Value.cast(condition), Mux(found == most, most, found + 1), 0))
        return found

    def seen(self, condition: ValueLike) -> Signal:
        """Whether a condition held in an earlier cycle."""
        found = Signal(name=f"seen_{self._number()}")
        with self.m.If(condition):
            self.m.d.sync += found.eq(1)
        return found

    def _number(self) -> int:
        self._numbers += 1
        return self._numbers

    # --- the world ---

    def _surround(self, unit: wiring.Component, free: set[str], held: dict[str, int], memories: dict[str, str],
                  own: set[str]) -> None:
        ports = [(name, port, is_input) for name, port, is_input in streams(unit)
                 if name not in own and name.partition("[")[0] not in own]
        members = unit.signature.members
        names = {name for name, _, _ in streams(unit)}
        for name in (*free, *held, *memories, *memories.values(), *own, *self._narrow, *self.taken, *self.loose):
            if name not in names | set(members):
                raise ValueError(f"{type(unit).__name__} has no port {name!r}, only {', '.join(sorted(names | set(members)))}")
        memories = memories | {name: answer for name in names
                               if name.startswith("reads") and (answer := name.replace("reads", "data", 1)) in names - own}
        answers = {answer: request for request, answer in memories.items()}
        for name, port, is_input in ports:
            if not is_input:
                self.sources[name] = self._take(name, port, memories.get(name))
        for name, port, is_input in ports:
            if is_input:
                asked = self.sources[answers[name]].moves if name in answers else None
                self.sinks[name] = self._offer(name, port, asked)
        for name, member in members.items():
            if member.is_port and member.flow == wiring.In and name not in own:
                for place, port in enumerate(_all(getattr(unit, name), member.dimensions)):
                    label = f"{name}_{place}" if member.dimensions else name
                    self.m.d.comb += Value.cast(port).eq(self._input(unit, name, label, Value.cast(port).shape(), free, held))

        plain = {name for name, member in members.items() if member.is_signature and name not in own
                 and not any(other.partition("[")[0] == name for other in names)}
        for path, member, value in unit.signature.flatten(unit):
            if path[0] in plain and member.flow == wiring.In:
                self.m.d.comb += Value.cast(value).eq(self.any(Value.cast(value).shape(), "_".join(map(str, path))))

    def _input(
        self, unit: wiring.Component, name: str, label: str, shape: Shape, free: set[str], held: dict[str, int],
    ) -> Value:
        """What an input that is no stream gets."""
        if name in held:
            return Const(held[name], shape)
        if name in free:
            found = Value.cast(self.any(shape, label))
            self.strobes.append(found.any())
            return found
        if name in ZERO:
            return Const(0, shape)
        if name in STROBES and hasattr(unit, "busy"):
            self.strobes.append(self.any(1, label))
            return self.strobes[-1] & ~unit.busy
        if name == "writes_idle" and "writes" in self.sources:
            return self._completed(self.sources["writes"])
        return Value.cast(self.some(shape, label))

    def _completed(self, writes: End) -> Value:
        """Whether memory has completed the writes that it took; it may complete one in every cycle."""
        open_ = Signal(range(MOST_ASKED + 2), name="writes_open")
        completes = self.any(1, "write_completes") & (open_ != 0)
        self.assume((open_ < MOST_ASKED) | ~writes.moves)
        self.m.d.sync += open_.eq(open_ + writes.moves - completes)
        return open_ == 0

    def _offer(self, name: str, port: stream.Interface, asked: Value | None) -> End:
        """Offers any items at any time, each until it is taken; those of a memory when they have been asked for."""
        label = _plain(name)
        payload = Value.cast(port.payload)
        go, item = self.any(1, f"{label}_goes"), self.any(payload.shape(), f"{label}_item")
        waits, last = Signal(name=f"{label}_waits"), Signal(payload.shape(), name=f"{label}_last")
        moves, may = Signal(name=f"{label}_moves"), Value.cast(go)
        if asked is not None:
            open_ = Signal(range(MOST_ASKED + 2), name=f"{label}_asked")
            self.m.d.sync += open_.eq(open_ + asked - moves)
            may = may & (open_ != 0)
        self.m.d.comb += [
            port.valid.eq(waits | may), payload.eq(Mux(waits, last, item & self._mask(name, port))),
            moves.eq(port.valid & port.ready)]
        self.m.d.sync += [waits.eq(port.valid & ~port.ready), last.eq(payload)]
        return End(name, port, moves)

    def _mask(self, name: str, port: stream.Interface) -> int:
        """The bits of an item that are used."""
        used = (1 << len(Value.cast(port.payload))) - 1
        for field, bits in self._narrow.get(name, {}).items():
            place = port.payload.shape()[field]
            used &= ~(((1 << place.width) - (1 << bits)) << place.offset)
        return used

    def _take(self, name: str, port: stream.Interface, answered_by: str | None) -> End:
        """Takes items, or not, in every cycle. As a memory it takes no request while too many are open."""
        label = _plain(name)
        moves = Signal(name=f"{label}_moves")
        ready = Const(1, 1) if name in self.taken else self.any(1, f"{label}_ready")
        if answered_by is not None:
            answers = {other: end for other, end, _ in streams(self.unit)}[answered_by]
            open_ = Signal(range(MOST_ASKED + 2), name=f"{label}_open")
            self.m.d.sync += open_.eq(open_ + moves - (answers.valid & answers.ready))
            ready = ready & (open_ < MOST_ASKED)
        if not port.signature.always_ready:
            self.m.d.comb += port.ready.eq(ready)
        self.m.d.comb += moves.eq(port.valid & port.ready)
        return End(name, port, moves)

    def finish(self) -> Module:
        """The whole as a module, once all claims have been made."""
        self.m.d.comb += self._now.eq(self._sound & Cat(*(value.any() for value in self._assumed), Const(1, 1)).all())
        self.m.d.sync += self._sound.eq(self._now)
        return self.m


def streams(unit: wiring.Component) -> Iterable[tuple[str, stream.Interface, bool]]:
    """The streams of a component, those within arrays and interfaces too: name, port, and whether it is an input."""
    for name, member in unit.signature.members.items():
        if member.is_signature:
            for place, port in enumerate(_all(getattr(unit, name), member.dimensions)):
                if isinstance(port.signature, stream.Signature | wiring.FlippedSignature) and hasattr(port, "payload"):
                    label = f"{name}[{place}]" if member.dimensions else name
                    yield label, port, member.flow == wiring.In


def _all(port: Any, dimensions: tuple[int, ...]) -> list[Any]:
    """The parts of a port that is an array, in order; the port alone where it is none."""
    for _ in dimensions[1:]:
        port = [part for row in port for part in row]
    return list(port) if dimensions else [port]


def _plain(name: str) -> str:
    return name.replace("[", "_").replace("]", "")
