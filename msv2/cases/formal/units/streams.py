"""Proofs of the buffers of streams and of the ports of memory."""

from __future__ import annotations

from amaranth.hdl import Cat, Mux
from amaranth.lib import data

from msv2.cases.formal.bench import Bench
from msv2.cases.formal.contract import accepts, conserves, general, level, passes, progresses
from msv2.cases.formal.proof import SMALL, Proof
from rtl.axi.read_port import ReadQueue
from rtl.cache_tags import CacheTags
from rtl.stream import Broadcast, Buffer, Fork, Skid
from rtl.supertiles.header_cache import CacheLines


def buffer(bench: Bench) -> None:
    """Two places, none of which makes an item wait."""
    passes(bench, "sink", "source")
    inside = level(bench, "sink", "source", 2)
    progresses(bench, inside, 0)
    accepts(bench, "sink", 1)


def skid(bench: Bench) -> None:
    """One place, which takes an item only where the receiver does not; an item that the receiver takes passes at once."""
    passes(bench, "sink", "source")
    inside = level(bench, "sink", "source", 1)
    sink, source = bench.sinks["sink"], bench.sources["source"]
    bench.never("nothing waits for a register", ~source.port.valid, when=sink.port.valid)
    bench.never("ready unless an item is inside", sink.port.ready != (inside == 0), when=sink.port.valid)
    progresses(bench, inside, 0)
    accepts(bench, "sink", 1)


def fork(bench: Bench) -> None:
    """Every consumer gets every item; they are at most two items apart."""
    for source in bench.sources:
        passes(bench, "sink", source)
        level(bench, "sink", source, 2)
    accepts(bench, "sink", 1)


def broadcast(bench: Bench) -> None:
    """Between two items that leave the sender, every wanted consumer has taken the item once, and no other one has."""
    leaves, wanted = bench.sinks["sink"].moves, bench.unit.wanted
    for place, end in enumerate(bench.sources.values()):
        got = bench.register(f"got_{place}")
        bench.m.d.sync += got.eq(Mux(leaves, 0, got | end.moves))
        bench.never(f"{end.name}: no item twice", got, when=end.moves)
        bench.never(f"{end.name}: only what it wants", ~wanted[place], when=end.moves)
        bench.never(f"{end.name}: no item left out", ~(got | end.moves), when=leaves & wanted[place])
        bench.never(f"{end.name}: the item of the sender", end.item != bench.sinks["sink"].item, when=end.moves)
    accepts(bench, "sink", 0)


def read_queue(bench: Bench) -> None:
    """There is free space for every answer that was asked for."""
    passes(bench, "reads", "requests")
    passes(bench, "beats", "data")
    waiting = conserves(bench, "places for answers", bench.sources["requests"].moves, bench.sources["data"].moves, 3)
    inside = level(bench, "beats", "data", 3)
    bench.never("no more answers than places", waiting < inside, when=inside != 0)
    bench.never("the request is passed on unchanged", bench.sources["requests"].item != bench.sinks["reads"].item,
                when=bench.sources["requests"].moves)
    taken = Cat(end.port.ready for end in bench.sources.values()).all()
    waits = taken & (inside != 0) & ~bench.sources["data"].moves
    bench.never("an answer leaves within 2 cycles", bench.cycles(waits, 3) > 2, when=inside != 0)


REQUEST = data.StructLayout({"index": 3, "mark": 2})


def cache_tags(bench: Bench) -> None:
    """A hit names the line that was filled for this index, and that nobody else has been given since."""
    unit = bench.unit
    passes(bench, "wanted", "found", bit=(unit.wanted.payload.mark[0], unit.found.payload.wanted.mark[0]))
    inside = level(bench, "wanted", "found", 1)
    bench.never("busy while a request is inside", ~unit.busy, when=inside != 0)
    index, found = bench.some(3, "index"), unit.found.payload
    mine, line, known = found.wanted.index == index, bench.register("line", 2), bench.register("known")
    with bench.m.If(bench.sources["found"].moves & found.missed):
        with bench.m.If(mine):
            bench.m.d.sync += [line.eq(found.line), known.eq(1)]
        with bench.m.Elif(found.line == line):
            bench.m.d.sync += known.eq(0)
    hit = bench.sources["found"].moves & mine & ~found.missed
    bench.never("a hit is on a line that holds what was asked for", ~known | (found.line != line), when=hit)
    idle = bench.cycles(~unit.wanted.ready & unit.found.ready, 5)
    bench.never("ready within 4 cycles", idle > 4, when=unit.wanted.valid)


def cache_lines(bench: Bench) -> None:
    """Every item finds what its line was filled with last: any line, followed from its first fill on."""
    unit, item = bench.unit, bench.unit.items.payload
    passes(bench, "items", "found", bit=(item.carried.mark, unit.found.payload.carried.mark))
    inside = level(bench, "items", "found", 2)
    bench.never("busy while an item is inside", ~unit.busy, when=inside != 0)
    fills, missed = bench.sinks["fills"].moves, bench.sinks["items"].moves & item.missed
    bench.never("a fill is taken with the item that missed", ~missed, when=fills)
    bench.never("an item that missed brings its fill", ~fills, when=missed)


LINES = 4

PROOFS = (
    Proof(Buffer, lambda: Buffer(3), (general, buffer), quick=True),
    Proof(Skid, lambda: Skid(3), (general, skid), quick=True),
    Proof(Fork, lambda: Fork(2, 2), (general, fork), quick=True),
    Proof(Broadcast, lambda: Broadcast(2, 3), (general, broadcast), quick=True),
    Proof(ReadQueue, lambda: ReadQueue(SMALL, 3), (general, read_queue), "3 places",
          {"memories": [("requests", "beats")]}, quick=True),
    Proof(CacheTags, lambda: CacheTags(REQUEST, lines=LINES, ways=2), (general, cache_tags), "4 lines of 2 ways"),
    Proof(CacheLines, lambda: CacheLines(data.StructLayout({"content": 2}), LINES, data.StructLayout({"mark": 1})),
          (general, cache_lines), "4 lines"),
)
