"""Proofs of counting, merging of tiles, and sorting."""

from __future__ import annotations

from amaranth.hdl import Cat, Mux, Signal, Value

from msv2.cases.formal.bench import Bench
from msv2.cases.formal.contract import conserves, general, level, once, passes, progresses, tells_busy
from msv2.cases.formal.proof import SMALL, Proof
from rtl.sort_tmu.auto_beta import AutoBeta
from rtl.sort_tmu.chunk_sorter import ChunkSorter
from rtl.sort_tmu.group_tiles import GroupTiles
from rtl.sort_tmu.handover import DoubleBuffer, LineBuffer
from rtl.sort_tmu.merge_plan import MergePlan
from rtl.sort_tmu.merge_stage import Kind, MergeStage
from rtl.sort_tmu.merge_tree import MergeNode, MergeTree
from rtl.sort_tmu.run_reader import RunReader
from rtl.sort_tmu.run_writer import BeatPacker, RunWriter
from rtl.sort_tmu.spill_dispatch import SpillDispatch
from rtl.sort_tmu.swap import SwapTogether
from rtl.sort_tmu.tile_counters import TileCounters
from rtl.sort_tmu.tile_merge import TileMergeUnit

LINE, DOUBLE, WIDTH = 8, 32, 2


def handover(most: int):
    """Claims of a buffer between sorter and array with so many places; a group leaves once its last item is there."""
    def claims(bench: Bench) -> None:
        passes(bench, "sink", "source")
        inside, end = level(bench, "sink", "source", most), bench.sinks["sink"]
        last = bench.register("last")
        with bench.m.If(end.moves):
            bench.m.d.sync += last.eq(end.port.payload.last)
        progresses(bench, (inside != 0) & last & ~end.port.valid, 5, name="a whole group: an item leaves")
        waits = bench.cycles(bench.sources["source"].port.ready & ~end.port.ready & ~bench.sources["source"].port.valid, 6)
        bench.never("full and empty at once for at most 5 cycles", waits > 5, when=end.port.valid)
        tells_busy(bench, inside != 0, 3)
    return claims


def merge_stage(bench: Bench) -> None:
    """Sorted runs with their kinds come in; runs of twice the length leave, with the same items in order."""
    m, run = bench.m, bench.unit.run
    sink, source = bench.sinks["sink"], bench.sources["source"]
    arrives = _Runs(bench, sink.moves, sink.port.payload, run, "in")
    item, kind = sink.port.payload, Value.cast(sink.port.payload.kind)
    bench.assume(~sink.port.valid | Mux(
        arrives.begins, Mux(arrives.initial, kind != Kind.SECOND.value, kind == arrives.odd), kind == arrives.kind))
    bench.assume(~sink.port.valid | (kind != Kind.EMPTY.value) | item.last)
    bench.assume(~sink.port.valid | (kind != Kind.WHOLE.value) | item.last | ~arrives.ends)
    bench.assume(~sink.port.valid | arrives.begins | (item.word >= arrives.word))

    leaves, out = _Runs(bench, source.moves, source.port.payload, 2 * run, "out"), source.port.payload
    kind_out = Value.cast(out.kind)
    bench.never("a run is in order", out.word < leaves.word, when=source.moves & ~leaves.begins)
    bench.never("kinds of runs are those of their places", Mux(
        leaves.begins, Mux(leaves.initial, kind_out == Kind.SECOND.value, kind_out != leaves.odd), kind_out != leaves.kind),
        when=source.moves)
    inside = conserves(bench, "items", sink.moves, source.moves, 2 * run + 3)
    closed, closes = bench.register("closed"), bench.register("closes")
    with m.If(sink.moves):
        m.d.sync += closed.eq(item.last)
    with m.If(source.moves):
        m.d.sync += closes.eq(out.last)
    once(bench, "an item", sink.moves & item.word[0], source.moves & out.word[0], empty=inside == 0)
    bench.never("a chunk ends with its last item", ~closes, when=(inside == 0) & closed & bench.seen(source.moves))
    waits = bench.cycles(source.port.ready & (inside != 0) & closed & ~sink.port.valid & ~source.port.valid, 4)
    bench.never("a whole chunk: an item leaves within 3 cycles", waits > 3, when=(inside != 0) & closed)
    stuck = bench.cycles(source.port.ready & ~sink.port.ready & ~source.port.valid, 4)
    bench.never("full and empty at once for at most 3 cycles", stuck > 3, when=sink.port.valid & (inside != 0))


class _Runs:
    """Where in a chunk a stream of runs of up to `run` items is.

    Attributes:
        begins, ends: the item that moves is the first, or the last one of its run.
        initial, odd: the run is its chunk's first, or one with an odd number.
        kind, word: of the item before.
    """

    def __init__(self, bench: Bench, moves: Signal, item: Value, run: int, name: str):
        place, self.initial = bench.register(f"{name}_place", range(max(2, run))), bench.register(f"{name}_initial", init=1)
        self.odd, self.kind = bench.register(f"{name}_odd"), bench.register(f"{name}_kind", 2)
        self.word = bench.register(f"{name}_word", len(item.word))
        self.begins, self.ends = place == 0, (place == run - 1) | item.last
        with bench.m.If(moves):
            bench.m.d.sync += [
                place.eq(Mux(self.ends, 0, place + 1)), self.kind.eq(Value.cast(item.kind)), self.word.eq(item.word),
                self.initial.eq(Mux(self.ends, item.last, self.initial)),
                self.odd.eq(Mux(self.ends, ~item.last & ~self.odd, self.odd))]


def chunk_sorter(bench: Bench) -> None:
    """Chunks of any length come out sorted, with the same intersections."""
    sink, source = bench.sinks["chunks"], bench.sources["sorted"]
    item, out = sink.port.payload, source.port.payload
    alone, length = bench.register("alone", init=1), bench.register("length", 5)
    with bench.m.If(sink.moves):
        bench.m.d.sync += [alone.eq(item.last), length.eq(Mux(item.last, 0, Mux(length == 31, 31, length + 1)))]
    bench.assume(~sink.port.valid | ~item.empty | (item.last & alone))
    bench.assume(length < 16)
    begins, word = bench.register("begins", init=1), bench.register("word", len(Value.cast(out.index)))
    with bench.m.If(source.moves):
        bench.m.d.sync += [begins.eq(out.last), word.eq(out.index)]
    inside = bench.count(sink.moves, source.moves, 60)
    tells_busy(bench, inside != 0, 2)
    bench.never("a chunk is in order", out.index < word, when=source.moves & ~begins)
    once(bench, "an intersection", sink.moves & item.index[0], source.moves & out.index[0], empty=inside == 0)


def counters(bits: int):
    """Claims of the counters of tiles, followed for any one tile."""
    def claims(bench: Bench) -> None:
        unit, full = bench.unit, (1 << bits) - 1
        tile = bench.some(len(unit.hits.payload.tile), "tile")
        bench.assume((unit.tile_count != 0) & (unit.tile_count <= 4) & (unit.tiles_x == 2))
        hits, counts, hit, out = bench.sinks["hits"], bench.sources["counts"], unit.hits.payload, unit.counts.payload
        fresh, mine = bench.register("fresh", init=1), bench.register("mine", bits)
        lost, outside = bench.register("lost"), bench.register("outside")
        before = Mux(fresh, 0, mine)
        counted = ~hit.end & (hit.tile == tile) & (hit.tile < unit.tile_count)
        with bench.m.If(hits.moves):
            bench.m.d.sync += [
                fresh.eq(hit.end), mine.eq(Mux(counted & (before != full), before + 1, before)),
                lost.eq(~fresh & lost | counted & (before == full)),
                outside.eq(~fresh & outside | ~hit.end & (hit.tile >= unit.tile_count))]
        bench.never("the count of a tile is the number of its hits", out.count != mine, when=counts.moves & (out.tile == tile))
        following = bench.register("following", 3)
        with bench.m.If(counts.moves):
            bench.m.d.sync += following.eq(Mux(out.frame_ends, 0, following + 1))
        bench.never("counts leave in the order of tiles, each once", out.tile != following, when=counts.moves)
        final = following == unit.tile_count - 1
        bench.never("the frame ends with its last tile", out.frame_ends != final, when=counts.moves)
        bench.never("a row ends with its last tile", out.row_ends != (following[0] | final), when=counts.moves)
        bench.never("a hit that is not counted is reported", ~unit.saturated, when=unit.settled & lost)
        bench.never("a hit outside the frame is reported, and only that", outside != unit.outside, when=unit.settled & outside)
        waits = bench.cycles(counts.port.ready & unit.begin_sweep & unit.busy & fresh & ~counts.port.valid, 9)
        bench.never("a count leaves within 8 cycles of the frame's end", waits > 8, when=counts.moves)
    return claims


def tile_merge(bench: Bench) -> None:
    """Pairs are conserved: what a tile's group says is what was counted, for any one tile; and every tile leaves once."""
    unit = bench.unit
    tile = bench.some(len(unit.hits.payload.tile), "tile")
    bench.assume((unit.tile_count != 0) & (unit.tile_count <= 4) & (unit.tiles_x == 2))
    hits, groups, hit, out = bench.sinks["hits"], bench.sources["groups"], unit.hits.payload, unit.groups.payload
    busy = bench.register("busy")  # a frame is counted or leaves; the next one may not begin
    following, mine = bench.register("following", 3), bench.register("mine", 2)
    fresh = bench.register("fresh", init=1)
    bench.assume(~hits.port.valid | ~busy)
    ends = groups.moves & (following == unit.tile_count - 1)
    before = Mux(fresh, 0, mine)
    with bench.m.If(hits.moves):
        counted = ~hit.end & (hit.tile == tile) & (hit.tile < unit.tile_count)
        bench.m.d.sync += [fresh.eq(hit.end), mine.eq(Mux(counted & (before != 3), before + 1, before))]
    with bench.m.If(hits.moves & hit.end):
        bench.m.d.sync += busy.eq(1)
    with bench.m.Elif(ends):
        bench.m.d.sync += busy.eq(0)
    with bench.m.If(groups.moves):
        bench.m.d.sync += following.eq(Mux(ends, 0, following + 1))
    bench.never("the count of a tile is the number of its pairs", out.count != mine, when=groups.moves & (out.tile == tile))
    bench.never("tiles leave in order, each once", out.tile != following, when=groups.moves)
    bench.never("a group ends with its row", ~out.last, when=groups.moves & (following[0] | ends))
    group = bench.register("group", len(out.group))
    with bench.m.If(groups.moves):
        bench.m.d.sync += group.eq(Mux(ends, 0, group + out.last))
    bench.never("groups have their numbers", out.group != group, when=groups.moves)
    bench.never("busy until the last tile has left", ~unit.busy, when=busy)


def group_tiles(bench: Bench) -> None:
    """Tiles pass in order with their counts; a group ends where its row of tiles does."""
    counts, groups = bench.sinks["counts"].port.payload, bench.sources["groups"].port.payload
    moves = bench.sources["groups"].moves
    passes(bench, "counts", "groups", bit=(counts.tile[0], groups.tile[0]))
    inside = level(bench, "counts", "groups", 3)
    bench.never("busy while a tile is inside", ~bench.unit.busy, when=inside != 0)
    followed, held, ends = bench.register("followed", 2), bench.register("held", len(counts.count)), bench.register("ends")
    with bench.m.If(bench.sinks["counts"].moves & (followed == 0) & counts.tile[1]):  # the first tile with this bit
        bench.m.d.sync += [followed.eq(1), held.eq(counts.count), ends.eq(counts.row_ends)]
    with bench.m.If(moves & groups.tile[1] & (followed == 1)):
        bench.m.d.sync += followed.eq(2)
    mine = moves & groups.tile[1] & (followed == 1)
    bench.never("a tile keeps its count", groups.count != held, when=mine)
    bench.never("a group ends with its row", ~groups.last, when=mine & ends)
    last, number = bench.register("last"), bench.register("number", len(groups.group))
    with bench.m.If(moves):
        bench.m.d.sync += [last.eq(groups.last), number.eq(groups.group)]
    bench.never("groups are numbered one by one", (groups.group != number + last) & (groups.group != 0),
                when=moves & bench.seen(moves))


def merge_node(bench: Bench) -> None:
    """One sorted run from each side becomes one: in order, with the same items."""
    sinks, source = [bench.sinks[f"sinks[{n}]"] for n in range(2)], bench.sources["source"]
    out = source.port.payload
    for place, sink in enumerate(sinks):
        begins, last = bench.register(f"begins_{place}", init=1), bench.register(f"last_{place}", WIDTH)
        item = sink.port.payload
        with bench.m.If(sink.moves):
            bench.m.d.sync += [begins.eq(item.last | item.blank), last.eq(item.word)]
        bench.assume(~sink.port.valid | begins | (~item.blank & (item.word >= last)))
    begins, last = bench.register("begins", init=1), bench.register("last", WIDTH)
    with bench.m.If(source.moves):
        bench.m.d.sync += [begins.eq(out.last | out.blank), last.eq(out.word)]
    bench.never("a merged run is in order", out.word < last, when=source.moves & ~begins)
    bench.never("a blank is a run of its own", out.blank, when=source.moves & ~begins)
    real = [sink.moves & ~sink.port.payload.blank for sink in sinks]
    inside = conserves(bench, "items", real[0] + real[1], source.moves & ~out.blank, 1)
    marked = Cat(moves & sink.port.payload.word[0] for moves, sink in zip(real, sinks, strict=True))
    bench.assume(~marked.all())
    once(bench, "an item", marked.any(), source.moves & ~out.blank & out.word[0], empty=inside == 0)
    left = source.moves & (out.last | out.blank)
    ended = [bench.count(sink.moves & (sink.port.payload.last | sink.port.payload.blank), left, 2) for sink in sinks]
    for place, runs in enumerate(ended):
        bench.never(f"runs of side {place} that are ahead of the merged ones: 1 at most, and none is behind",
                    (runs < 0) | (runs > 2), when=runs == 1)


def dispatch(bench: Bench) -> None:
    """Every intersection goes to exactly one of the two outputs."""
    chunks, direct, runs = bench.sinks["chunks"], bench.sources["direct"], bench.sources["run_entries"]
    cut, inside = bench.unit.cuts, bench.register("inside")
    number = bench.register("number", len(cut.payload.number))
    with bench.m.If(chunks.moves):
        bench.m.d.sync += [number.eq(number + chunks.port.payload.last), inside.eq(~chunks.port.payload.last)]
    now = cut.valid & (cut.payload.number == number)
    # a cut arrives before its chunk: it is there when the chunk is offered first, or never
    offered = bench.before(chunks.port.valid & ~chunks.moves) | inside
    bench.assume(~offered | (now == bench.before(now)))
    bench.never("an intersection that is taken goes somewhere", ~(direct.moves | runs.moves), when=chunks.moves)
    bench.never("to one output only", direct.moves & runs.moves, when=direct.moves)
    real = runs.moves & ~runs.port.payload.nothing
    bench.never("nothing goes out that was not taken", ~chunks.moves, when=direct.moves | real)
    bench.never("a cut is used with the last intersection of its chunk", ~(chunks.moves & chunks.port.payload.last),
                when=bench.sinks["cuts"].moves)


def packer(bench: Bench) -> None:
    """Four intersections make a beat, fewer at the end of a run; none is lost, none is older than its beat."""
    sink, source, item = bench.sinks["sink"], bench.sources["source"], bench.sinks["sink"].port.payload
    full = bench.register("full", 3)
    ends = (full == 3) | item.last | item.nothing
    with bench.m.If(sink.moves):
        bench.m.d.sync += full.eq(Mux(ends, 0, full + 1))
    conserves(bench, "beats", sink.moves & ends, source.moves, 1)
    complete, begun = bench.before(sink.moves & ends), bench.before(sink.moves & ~ends)
    bench.never("a beat is there the cycle after its last intersection", ~source.port.valid, when=complete)
    bench.never("no beat before its last intersection", source.port.valid & ~bench.before(source.port.valid), when=begun)
    for place in range(4):
        word = bench.register("word", len(item.word))
        with bench.m.If(sink.moves & (full == place)):
            bench.m.d.sync += word.eq(item.word)
        there = bench.register("there")
        with bench.m.If(sink.moves):
            bench.m.d.sync += there.eq((full == place) | there & (full != 0))
        part = source.port.payload.words.word_select(place, 64)[:len(item.word)]
        bench.never(f"word {place} of a beat is its intersection {place}", part != word, when=source.moves & there)


def plan(bench: Bench) -> None:
    """Merges are reported as written when they have been ordered."""
    merges = bench.sources["merges"]
    open_ = bench.count(merges.moves & merges.port.payload.back, bench.unit.written, 16)
    bench.assume(~bench.unit.written | (open_ > 0))


def writer(bench: Bench) -> None:
    """Beats are written in order; a fence is passed when everything before it is in memory, once."""
    unit = bench.unit
    for name in ("chunks", "merged"):
        end, there = bench.sinks[name], getattr(unit, f"{name}_there")
        conserves(bench, f"fences of {name}", end.moves & (end.port.payload.fence | end.port.payload.nothing), there, 4)
    real = [end.moves & ~end.port.payload.nothing for end in bench.sinks.values()]
    conserves(bench, "beats", real[0] + real[1], bench.sources["writes"].moves, 4)
    passed = unit.chunks_there | unit.merged_there
    bench.never("a fence is passed only when memory has all writes", ~unit.writes_idle, when=passed)


def swap(bench: Bench) -> None:
    """A frame has so many tiles, and no more groups of intersections than tiles; a tile leaves after it has come."""
    unit, most = bench.unit, 4
    came, left = bench.count(unit.tile_moves, 0, most), bench.count(unit.row_ends, 0, most)
    bench.assume(~unit.tile_moves | (came < most))
    bench.assume(~unit.row_ends | (left < came))
    for end in bench.sinks.values():
        groups = bench.count(end.moves & end.port.payload.last, 0, most)
        bench.assume(~end.port.valid | (groups < came))


def divides(bench: Bench) -> None:
    """A division ends."""
    waits = bench.cycles(~bench.unit.done & ~bench.unit.start, 30)
    bench.assume(~bench.unit.start | bench.unit.done)
    bench.never("done within 29 cycles of a start", waits > 29, when=bench.seen(bench.unit.start) & bench.unit.done)


NARROW = {"index": 2, "depth_key": 0, "tile": 0}

PROOFS = (
    Proof(LineBuffer, lambda: LineBuffer(SMALL), (general, handover(LINE)), f"{LINE} places"),
    Proof(DoubleBuffer, lambda: DoubleBuffer(SMALL), (general, handover(DOUBLE)), f"{DOUBLE} places", seconds=4),
    Proof(MergeStage, lambda: MergeStage(WIDTH, 1), (general, merge_stage), "runs of 1, words of 2 bits"),
    Proof(MergeStage, lambda: MergeStage(WIDTH, 2), (general, merge_stage), "runs of 2, words of 2 bits", seconds=8),
    Proof(ChunkSorter, lambda: ChunkSorter(SMALL), (general, chunk_sorter), "chunks of 16",
          {"narrow": {"chunks": NARROW}}, seconds=4),
    Proof(MergeNode, lambda: MergeNode(WIDTH), (general, merge_node), "words of 2 bits", quick=True),
    Proof(MergeTree, lambda: MergeTree(WIDTH, 4), (general,), "4 ways"),
    Proof(TileCounters, lambda: TileCounters(SMALL, count_bits=2), (general, counters(2)), "4 tiles, 2 bits",
          {"free": ("begin_sweep",), "held": {"tiles_x": 2}}),
    Proof(GroupTiles, lambda: GroupTiles(SMALL), (general, group_tiles), "4 tiles"),
    Proof(TileMergeUnit, lambda: TileMergeUnit(SMALL, count_bits=2), (general, tile_merge), "4 tiles, 2 bits",
          {"held": {"tiles_x": 2, "auto": 0}}),
    Proof(AutoBeta, lambda: AutoBeta(SMALL), (divides,), "", {"free": ("start",)}),
    Proof(SpillDispatch, lambda: SpillDispatch(SMALL), (general, dispatch), "", {"held": {"freed": 0}, "taken": ("parts",)}),
    Proof(BeatPacker, lambda: BeatPacker(SMALL), (general, packer), ""),
    Proof(RunWriter, lambda: RunWriter(SMALL, depth=4), (general, writer), "4 places"),
    Proof(MergePlan, lambda: MergePlan(SMALL), (plan, general), "", {"free": ("written",)}),
    Proof(RunReader, lambda: RunReader(SMALL, way_beats=8), (general,), "8 beats a way"),
    Proof(SwapTogether, lambda: SwapTogether(SMALL.with_(incremental=False, lockstep=True)), (swap, general), "",
          {"free": ("tile", "tile_moves", "row_ends")}),
)
