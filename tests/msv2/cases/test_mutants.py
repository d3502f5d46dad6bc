"""Mutants: they are drawn, told apart from the sound circuit where they differ, and killed by a suite that looks."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from amaranth.hdl import Cat, Instance, Module, Signal
from amaranth.lib import memory, wiring
from amaranth.lib.wiring import In, Out

pytest.importorskip("pyosys", reason="needs the extra `synth`")

from msv2.cases.mutants import equal, mutate, play
from msv2.cases.mutants.mutate import Mutant
from msv2.cases.mutants.targets import TARGETS, named
from msv2.studies.mutants import study
from rtl.emit import keeping_sources, to_rtlil, verilog_of
from rtl.units import emit
from spec.config import TINY
from spec.errors import InputError


class Accumulator(wiring.Component):
    """Sums what comes in and what a memory holds; one gate is there twice, and one register is always 0."""

    def __init__(self):
        super().__init__({"number": In(4), "place": In(2), "total": Out(6), "twice": Out(1)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        m.submodules.words = words = memory.Memory(shape=4, depth=4, init=[])
        write, read = words.write_port(), words.read_port()
        again = Signal()
        m.d.comb += [
            write.en.eq(self.number.any()), write.addr.eq(self.place), write.data.eq(self.number), read.addr.eq(self.place),
            again.eq(self.number[0] & self.number[1]), self.twice.eq(again | (self.number[0] & self.number[1]))]
        never = Signal(2)
        m.d.sync += [
            never.eq(Cat(never[0] & self.number[0], never[0])), self.total.eq(self.total + self.number + read.data + never)]
        return m


class Boxed(wiring.Component):
    """A gate that is there twice, beside a module that is not Amaranth's."""

    def __init__(self):
        super().__init__({"a": In(1), "b": In(1), "out": Out(1)})

    def elaborate(self, platform: object) -> Module:
        m = Module()
        back = Signal()
        m.submodules.box = Instance("box", i_a=self.a, o_back=back)
        m.d.comb += self.out.eq((self.a & self.b) | (self.b & self.a) | back)
        return m


def accumulator(folder: Path, count: int) -> list[Mutant]:
    with keeping_sources() as texts:
        to_rtlil(Accumulator(), "accumulator")
    # All of its lines are in this file, where mutants of a bench are not drawn.
    return mutate.draw(texts["accumulator"].replace("/tests/", "/rtl/"), "accumulator", count, 1, folder)


def test_sources_do_not_change_the_verilog():
    with keeping_sources() as texts:
        kept = emit("tile_merge_unit", TINY)
    assert kept == emit("tile_merge_unit", TINY) == verilog_of(texts["tile_merge_unit"])
    assert "rtl/sort_tmu/tile_merge.py" in texts["tile_merge_unit"]


def test_half_of_a_gate_that_is_there_twice_may_be_0(tmp_path: Path):
    """One of two equal ANDs may be tied to 0, and neither of them to 1."""
    mutants = accumulator(tmp_path, 200)
    text = (tmp_path / "flat.il").read_text()
    ands = re.findall(r"cell \$and (\S+)\n(?:(?!  end).*\n)*?.*connect \\A \\number \[[01]\]", text)
    same = equal.equal(mutants, "accumulator", tmp_path)
    of_output = [mutant for mutant in mutants if any(f"-cell {cell} -port Y " in mutant.command for cell in ands)]
    assert len(ands) == 2 and all(mutant.lines for mutant in mutants) and len(same) < len(mutants) / 4
    for mutant in of_output:
        assert (mutant.number in same) == ("-mode const0" in mutant.command), mutant.command
    assert any("-mode const0" in mutant.command for mutant in of_output)
    assert any("-mode const1" in mutant.command for mutant in of_output)


def test_the_input_of_a_register_that_is_always_0_may_be_tied_to_0(tmp_path: Path):
    """Mutants of registers are left out, because their initial values are not known."""
    mutants = [mutant for mutant in accumulator(tmp_path, 400) if "-port Q" not in mutant.command]
    text = (tmp_path / "flat.il").read_text()
    (cell,) = re.findall(r"cell \$and (\S+)\n(?:(?!  end).*\n)*?.*connect \\A \\never \[0\]", text)
    same = equal.equal(mutants, "accumulator", tmp_path)
    modes = {mutant.command.split()[2]: mutant.number in same for mutant in mutants if f"{cell} -port Y" in mutant.command}
    assert modes["const0"] and not modes["const1"] and not modes["inv"]


def test_a_module_in_verilog_is_cut(tmp_path: Path):
    """Half of the gate that is there twice may be 0, and what goes into the module must stay."""
    with keeping_sources() as texts:
        to_rtlil(Boxed(), "boxed")
    mutants = mutate.draw(texts["boxed"].replace("/tests/", "/rtl/"), "boxed", 60, 1, tmp_path)
    box = "module box(input a, output back);\nendmodule\n"
    same = equal.equal(mutants, "boxed", tmp_path, f"module other;\nendmodule\n{box}")
    assert 0 < len(same) < len(mutants) / 2
    assert all("const0" in mutant.command or "cnot" in mutant.command for mutant in mutants if mutant.number in same)
    with pytest.raises(ValueError, match="box"):
        equal.equal(mutants, "boxed", tmp_path, "module other;\nendmodule\n")


def test_mutants_do_not_reach_the_testbench(tmp_path: Path):
    """The lines of a module that is no unit belong to its bench, unless they are in rtl/."""
    with keeping_sources() as texts:
        to_rtlil(Accumulator(), "accumulator")
    assert mutate.draw(texts["accumulator"], "accumulator", 5, 1, tmp_path) == []


def test_a_suite_kills_mutants_of_its_unit(tmp_path: Path):
    """The handover's quick suite notices nearly all of 12 mutants, and the sound circuit passes before and after them."""
    target = named("handover")
    bench = play.bench_of(target, tmp_path)
    mutants = mutate.draw(bench.text, bench.module, 12, 3, tmp_path)
    player = play.Player(bench, mutants, tmp_path)
    verdicts = player.play([mutant.number for mutant in mutants])
    killed = [number for number, verdict in verdicts.items() if verdict.result != play.SURVIVED]
    alive = [mutant for mutant in mutants if mutant.number not in killed]
    same = equal.equal(alive, bench.module, tmp_path)
    assert len(killed) >= 9 and {mutant.number for mutant in alive} == same
    assert all(verdicts[number].run and verdicts[number].words for number in killed if verdicts[number].result == "difference")


def test_every_target_has_its_suite_and_its_plans():
    for target in TARGETS:
        assert target.machine in target.suite.VARIANTS, target.name
        assert all(callable(getattr(target.suite, name)) for name in target.plans), target.name
    assert len({target.name for target in TARGETS}) == len(TARGETS)
    with pytest.raises(InputError, match="chunk_sorter"):
        named("chunk_sorted")


def test_the_page_has_every_unit_and_survivor():
    rows = [{"unit": "a", "machine": "tiny", "suite": "s", "drawn": 10, "killed": 7, "equal": 2, "kills": {"difference": 7},
             "survivors": [{"number": 3, "what": "inv A[0] of x", "lines": ["rtl/x.py:1", "rtl/x.py:2"]}]},
            {"unit": "b", "machine": "tiny", "suite": "s", "drawn": 5, "killed": 5, "equal": 0, "kills": {}, "survivors": []}]
    assert study.total(rows) == {"drawn": 15, "equal": 2, "judged": 13, "killed": 12, "share": 0.9231}
    text = study.pages(rows, 4)
    assert "12 of 13 mutants of 2 units are killed (92.3 %)" in text and "| a | `tiny` | 10 | 2 | 7 | 87.5 % |" in text
    assert "| a | `inv A[0] of x` | rtl/x.py:2 |" in text


@pytest.mark.parametrize(("argv", "says"), [
    (["--count", "0"], "--count 0"), (["--count", "4096"], "4095"), (["--seed", "-1"], "--seed -1"),
    (["--unit", "sorter"], "sorter")])
def test_bad_requests_name_what_is_accepted(argv, says):
    with pytest.raises(InputError, match=says):
        study.main(argv)
