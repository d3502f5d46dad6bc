"""Formal proofs: quick ones are proven, faults that are built in are found, and no component of rtl/ is forgotten."""

from __future__ import annotations

from pathlib import Path

import pytest
from amaranth.hdl import Module, Mux, Signal
from amaranth.lib import memory, stream, wiring
from amaranth.lib.wiring import In, Out

pytest.importorskip("pyosys", reason="needs the extra `synth`")

from msv2.cases.formal import registry
from msv2.cases.formal.bench import Bench, streams
from msv2.cases.formal.circuit import without_contents
from msv2.cases.formal.contract import accepts, general, level, passes, progresses, tells_busy
from msv2.cases.formal.proof import SMALL, Proof, judge
from rtl.stream import Buffer
from rtl.top.controller import FrameController
from rtl.units import UNITS
from spec.config import TINY, TINY_EYES, TINY_STREAMS, TINY_V3
from spec.errors import InputError

QUICK = [proof for proof in registry.PROOFS if proof.quick]
ITEMS = stream.Signature(2)
MACHINES = (TINY, TINY_V3, TINY_STREAMS, TINY_EYES)


def results(proof: Proof, folder: Path) -> dict[str, str]:
    """The result of every claim by its name."""
    return {each.claim: each.result for each in judge(proof, folder)}


@pytest.mark.parametrize("proof", QUICK, ids=lambda proof: proof.folder_name)
def test_a_quick_proof_is_proven(proof: Proof, tmp_path: Path):
    found = results(proof, tmp_path)
    assert found and set(found.values()) == {"proven"}, found


def test_every_component_has_a_proof_or_a_reason():
    """A new component of rtl/ belongs in `units`, or with a reason in `registry.UNPROVEN`."""
    assert registry.unexplained() == []
    proven = {proof.unit.__name__ for proof in registry.PROOFS}
    assert not proven & set(registry.UNPROVEN)
    assert proven | set(registry.UNPROVEN) == set(registry.components())


@pytest.mark.parametrize("name", [name for name in UNITS if name != "msv2_top"])
def test_every_unit_of_the_registry_is_one_of_these_components(name: str):
    made = next(unit for unit in (_made(name, config) for config in MACHINES) if unit)
    assert type(made).__name__ in registry.components()


def _made(name, config):
    try:
        return UNITS[name].make(config)
    except ValueError:
        return None


def test_names_of_proofs_differ():
    folders = [proof.folder_name for proof in registry.PROOFS]
    assert len(folders) == len(set(folders))


class Faulty(wiring.Component):
    """A register between two streams, with a fault."""

    def __init__(self, fault: str = ""):
        self.fault = fault
        super().__init__({"sink": In(ITEMS), "source": Out(ITEMS), "busy": Out(1)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        sink, source = self.sink, self.source
        there, item = Signal(reset_less=self.fault == "no reset"), Signal(2)
        often = Signal(3)
        m.d.sync += often.eq(often + 1)
        free = ~there | source.ready
        if self.fault == "stuck":
            free = ~there | (source.ready & often.any())
        if self.fault == "overwrites":
            free = free | often.all()
        m.d.comb += [sink.ready.eq(free), source.valid.eq(there), source.payload.eq(item), self.busy.eq(there)]
        if self.fault == "changes":
            m.d.comb += source.payload.eq(Mux(often == 5, item + 1, item))
        if self.fault == "withdraws":
            m.d.comb += source.valid.eq(there & ~(often == 5))
        if self.fault == "late":
            m.d.comb += source.valid.eq(there & (often == 5))
            m.d.comb += sink.ready.eq(~there)
        if self.fault == "lies":
            m.d.comb += self.busy.eq(there & ~(often == 5))
        if self.fault == "stays busy":
            m.d.comb += self.busy.eq(1)
        with m.If(free):
            m.d.sync += [there.eq(sink.valid), item.eq(sink.payload)]
            if self.fault == "loses":
                with m.If(often == 6):
                    m.d.sync += there.eq(0)
            if self.fault == "twice":
                with m.If((often == 6) & there):
                    m.d.sync += [there.eq(1), item.eq(item)]
                    m.d.comb += sink.ready.eq(0)
        if self.fault == "late":
            with m.If(there & source.valid & source.ready):
                m.d.sync += there.eq(0)
        return m


def claims(bench: Bench) -> None:
    """All general claims that a register meets."""
    general(bench)
    passes(bench, "sink", "source")
    inside = level(bench, "sink", "source", 1)
    progresses(bench, inside != 0, 0)
    accepts(bench, "sink", 1)
    tells_busy(bench, inside != 0, 1)


def test_a_sound_register_meets_every_claim(tmp_path: Path):
    assert set(results(Proof(Faulty, Faulty, (claims,)), tmp_path).values()) == {"proven"}


@pytest.mark.parametrize("fault, part", [
    ("changes", "payload stays"), ("withdraws", "valid stays"), ("loses", "in order"), ("twice", "in order"),
    ("overwrites", "in order"), ("late", "leaves within"), ("lies", "busy while anything"), ("stays busy", "not busy"),
    ("no reset", "nothing before"),
])
def test_a_fault_is_found(fault: str, part: str, tmp_path: Path):
    found = results(Proof(Faulty, lambda: Faulty(fault), (claims,)), tmp_path)
    assert [result for name, result in found.items() if part in name] == ["fails"], found


def test_a_claim_of_what_never_happens_is_empty(tmp_path: Path):
    def impossible(bench: Bench) -> None:
        bench.never("nothing", 1, when=bench.sinks["sink"].moves & ~bench.sinks["sink"].port.valid)

    assert results(Proof(Buffer, lambda: Buffer(2), (impossible,), seconds=1), tmp_path) == {"nothing": "empty"}


def test_an_assumption_leaves_only_worlds_in_which_it_has_always_held(tmp_path: Path):
    def calm(bench: Bench) -> None:
        bench.assume(~bench.sinks["sink"].port.valid | (bench.sinks["sink"].item == 2))
        bench.never("another item", bench.sources["source"].item != 2, when=bench.sources["source"].moves)
        bench.never("an item", bench.sources["source"].moves, when=bench.sources["source"].moves)

    assert results(Proof(Buffer, lambda: Buffer(2), (calm,)), tmp_path) == {"another item": "proven", "an item": "fails"}


class Powered(wiring.Component):
    """A register that reset leaves alone, a memory that is written, and a table."""

    def __init__(self) -> None:
        super().__init__({"go": In(1), "address": In(2), "kept": Out(1), "word": Out(1), "entry": Out(2)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        held = Signal(reset_less=True)
        m.submodules.words = words = memory.Memory(shape=1, depth=4, init=[0, 0, 0, 0])
        m.submodules.table = table = memory.Memory(shape=2, depth=4, init=[1, 2, 1, 2])
        write = words.write_port()
        m.d.comb += [write.addr.eq(self.address), write.data.eq(0), write.en.eq(self.go)]
        with m.If(self.go):
            m.d.sync += held.eq(0)
        m.d.comb += [self.kept.eq(held)]
        for port, out in ((words.read_port(domain="comb"), self.word), (table.read_port(domain="comb"), self.entry)):
            m.d.comb += [port.addr.eq(self.address), out.eq(port.data)]
        return m


def test_power_brings_any_value_but_tables_are_kept(tmp_path: Path):
    """Initial values of the simulation would hide what a register without reset, or a memory, holds."""
    def claim(bench: Bench) -> None:
        unit = bench.unit
        bench.never("the register is 0", unit.kept, when=bench.seen(1))
        bench.never("the memory is 0", unit.word, when=bench.seen(1))
        bench.never("the table has its entries", unit.entry != Mux(unit.address[0], 2, 1), when=bench.seen(1))

    found = results(Proof(Powered, Powered, (claim,), world={"free": ("go", "address")}), tmp_path)
    assert found == {"the register is 0": "fails", "the memory is 0": "fails", "the table has its entries": "proven"}


def test_contents_of_written_memories_are_forgotten_by_module():
    cell = '  cell ${kind} ${number}\n    parameter \\MEMID "\\\\{name}"\n  end\n'
    def module(*cells: tuple[str, str]) -> str:
        body = "".join(cell.format(kind=kind, number=n, name=name) for n, (kind, name) in enumerate(cells))
        return f"module \\m\n{body}end\n"

    rom, ram = module(("meminit_v2", "a"), ("memrd_v2", "a")), module(("meminit_v2", "a"), ("memwr_v2", "a"))
    found = without_contents(rom + ram)
    assert found.count("$meminit_v2") == 1 and found.index("$meminit_v2") < found.index("$memwr_v2")


def test_streams_are_found_by_the_signature():
    names = {name: is_input for name, _, is_input in streams(registry.named("AxiMaster")[0].make())}
    assert names == {
        "reads[0]": True, "reads[1]": True, "beats[0]": False, "beats[1]": False, "writes[0]": True, "writes[1]": True}


def test_an_unknown_port_is_answered_with_those_that_exist():
    with pytest.raises(ValueError, match=r"FrameController has no port 'sart', only .*start"):
        Bench(FrameController(SMALL), free=("sart",))


def test_an_unknown_unit_is_answered_with_the_nearest():
    with pytest.raises(InputError, match="did you mean 'LineBuffer'"):
        registry.named("LineBufer")
