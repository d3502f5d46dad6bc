"""Claims that hold of any component with streams. Each is stated once here, and used for every unit to which it applies."""

from __future__ import annotations

from amaranth.hdl import Cat, Mux, Signal, Value, ValueLike

from msv2.cases.formal.bench import Bench


def holds(bench: Bench) -> None:
    """Of every output stream: what is offered stays offered, and unchanged, until it is taken."""
    for name, end in bench.sources.items():
        if not end.port.signature.always_ready and name not in bench.taken | bench.loose:
            keeps(bench, name, end.port.valid, end.port.ready, end.item)


def keeps(bench: Bench, name: str, valid: ValueLike, ready: ValueLike, payload: ValueLike) -> None:
    """Of a channel with valid and ready: what is offered stays offered, and unchanged, until it is taken."""
    valid, ready, payload = (Value.cast(value) for value in (valid, ready, payload))
    waits = bench.before(valid & ~ready)
    bench.never(f"{name}: valid stays until ready", ~valid, when=waits)
    if len(payload):
        bench.never(f"{name}: the payload stays until ready", payload != bench.before(payload), when=waits & valid)


def silent(bench: Bench) -> None:
    """Nothing is offered from reset on until something has come: no register brings an item with it when the power comes on."""
    comes = Cat(*(end.port.valid for end in bench.sinks.values()), *bench.strobes)
    quiet = ~(bench.seen(comes.any()) | comes.any()) if len(comes) else bench.before(0)
    for name, end in bench.sources.items():
        bench.never(f"{name}: nothing before anything has come", end.port.valid, when=quiet & bench.seen(1))


def offers_busily(bench: Bench) -> None:
    """A unit that tells whether it is busy is so while it offers an item."""
    if "busy" in bench.unit.signature.members:
        for name, end in bench.sources.items():
            bench.never(f"{name}: busy while an item is offered", ~bench.unit.busy, when=end.port.valid)


def general(bench: Bench) -> None:
    """All claims that hold of any unit."""
    holds(bench)
    silent(bench)
    offers_busily(bench)


def passes(bench: Bench, sink: str, source: str, *, bit: tuple[ValueLike, ValueLike] | None = None) -> None:
    """Items go from `sink` to `source` in order; none is lost, none comes twice.

    Two neighbouring items, any two, are marked in one bit of the payload that the unit only carries: `bit` has it at the sink
    and at the source, by default it is the lowest one. At the source only neighbours may be marked, two at most, and none
    may come between or go missing.
    """
    at, to = bench.sinks[sink], bench.sources[source]
    given, taken = bit or (at.item[0], to.item[0])
    marked, found = Signal(2, name=f"marked_{sink}_{source}"), Signal(2, name=f"found_{sink}_{source}")
    given, taken = Value.cast(given), Value.cast(taken)
    bench.assume(~at.port.valid | ((marked == 0) | (given == (marked == 1))))
    with bench.m.If(at.moves & given):
        bench.m.d.sync += marked.eq(marked + 1)
    with bench.m.If(to.moves & taken):
        bench.m.d.sync += found.eq(Mux(found == 3, 3, found + 1))
    bench.never(f"{sink} to {source}: in order, nothing lost, nothing twice", Mux(taken, found >= 2, found == 1), when=to.moves)


def level(bench: Bench, sink: str, source: str, most: int) -> Signal:
    """How many items are inside; claims that there are never fewer than none nor more than `most`, and that `most` occur."""
    return conserves(bench, f"{sink} to {source}", bench.sinks[sink].moves, bench.sources[source].moves, most)


def progresses(bench: Bench, inside: ValueLike, within: int, *, name: str = "an item leaves") -> None:
    """While something is inside and every receiver takes, an item leaves within so many cycles."""
    outs = bench.sources.values()
    waits = Value.cast(inside).any() & Cat(end.port.ready for end in outs).all() & ~Cat(end.moves for end in outs).any()
    bench.never(f"{name} within {within} cycles", bench.cycles(waits, within + 1) > within, when=inside)


def accepts(bench: Bench, sink: str, within: int) -> None:
    """While every receiver takes, the input becomes ready within so many cycles."""
    waits = Cat(end.port.ready for end in bench.sources.values()).all() & ~bench.sinks[sink].port.ready
    bench.never(f"{sink}: ready within {within} cycles", bench.cycles(waits, within + 1) > within,
                when=bench.sinks[sink].port.valid)


def tells_busy(bench: Bench, inside: ValueLike, within: int) -> None:
    """The unit's `busy` is high while something is inside, and low so many cycles after all has left and nothing came."""
    busy, inside = Value.cast(bench.unit.busy), Value.cast(inside).any()
    bench.never("busy while anything is inside", ~busy, when=inside)
    given = Cat(end.port.valid for end in bench.sinks.values()).any()
    still = bench.cycles(~inside & ~given, within + 1)
    bench.never(f"not busy {within} cycles after the last item has left", busy, when=still > within)


def conserves(bench: Bench, name: str, comes: ValueLike, goes: ValueLike, most: int) -> Signal:
    """What goes out has come in: there is never more out than in, and never more than `most` inside. Returns how many are.

    Args:
        comes, goes: how many come and go in a cycle.
    """
    inside = bench.count(comes, goes, most)
    bench.never(f"{name}: none that did not come", inside < 0, when=bench.before(goes))
    bench.never(f"{name}: at most {most} inside", inside > most, when=inside == most)
    return inside


def once(bench: Bench, name: str, comes: ValueLike, goes: ValueLike, *, empty: ValueLike) -> None:
    """One item, any one, is marked: it never leaves before it came, nor twice, and where the unit is `empty` it has left.

    Args:
        comes, goes: the marked item comes, or leaves, in this cycle.
    """
    came, left = bench.seen(comes), bench.seen(goes)
    bench.assume(~(came & Value.cast(comes)))
    bench.never(f"{name} does not come from nowhere", ~(came | Value.cast(comes)), when=goes)
    bench.never(f"{name} does not leave twice", left, when=goes)
    bench.never(f"{name} is not lost", ~left, when=Value.cast(empty) & came)
