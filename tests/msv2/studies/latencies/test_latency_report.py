"""The latencies of docs/units.md are those of today's RTL."""

from __future__ import annotations

import json
from collections.abc import Callable

import pytest
from amaranth.hdl import Module, Signal
from amaranth.lib import stream, wiring
from amaranth.lib.wiring import In, Out

from msv2.studies.latencies.study import MEASURES, REPORT, latency, to
from msv2.studies.results import tables
from msv2.studies.results.units import units_table
from spec.config import PAPER


class Delay(wiring.Component):
    """Of what comes in, 3 leaves a number of cycles later; taken every other cycle."""

    def __init__(self, cycles: int) -> None:
        self.cycles = cycles
        super().__init__({"sink": In(stream.Signature(4)), "source": Out(stream.Signature(4))})

    def elaborate(self, platform: object) -> Module:
        m, turn, valid = Module(), Signal(), Signal()
        m.d.sync += turn.eq(~turn)
        m.d.comb += [self.sink.ready.eq(turn), valid.eq(self.sink.valid & turn & (self.sink.payload == 3))]
        for _ in range(self.cycles):
            later = Signal()
            m.d.sync += later.eq(valid)
            valid = later
        m.d.comb += self.source.valid.eq(valid)
        return m


@pytest.mark.parametrize("cycles", [0, 1, 6])
@pytest.mark.parametrize("words", [[3], [1, 2, 1, 3]])
def test_it_counts_from_the_last_words_transfer(cycles: int, words: list[int]) -> None:
    dut = Delay(cycles)
    assert latency(dut, to(dut.sink, *words), dut.source.valid, high=[dut.source.ready]) == cycles


class Asker(wiring.Component):
    """Asks once, some cycles after its reset; `right` tells that the answer is offered later than that."""

    def __init__(self) -> None:
        super().__init__({"reads": Out(stream.Signature(1)), "data": In(stream.Signature(1)), "right": Out(1)})

    def elaborate(self, platform: object) -> Module:
        m, clock, asked = Module(), Signal(5), Signal()
        m.d.sync += clock.eq(clock + 1)
        m.d.comb += [self.reads.valid.eq((clock == 20) & ~asked), self.data.ready.eq(1), self.right.eq(self.data.valid & asked)]
        with m.If(self.reads.valid & self.reads.ready):
            m.d.sync += asked.eq(1)
        return m


def test_an_answer_comes_behind_its_request() -> None:
    dut = Asker()
    assert latency(dut, to(dut.data, 0, after=dut.reads), dut.right, high=[dut.reads.ready]) == 0


def test_what_gives_nothing_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("msv2.studies.latencies.study.LIMIT", 50)
    dut = Delay(0)
    with pytest.raises(ValueError, match="50 cycles"):
        latency(dut, to(dut.sink, 1), dut.source.valid, high=[dut.source.ready])


@pytest.mark.parametrize("measure", MEASURES, ids=lambda measure: measure.__name__)
def test_the_report_is_of_the_units_of_today(measure: Callable) -> None:
    report = json.loads(REPORT.read_text())
    found = measure(PAPER)
    assert report["config"] == PAPER.name and found
    assert found == {name: report["cycles"][name] for name in found}, "run: make results ONLY=latencies KEEP=1"


def test_the_table_names_nothing_that_is_not_known() -> None:
    shown = units_table(tables.load_reports(REPORT.parent))
    assert "?" not in shown and "66 cycles" in shown
    assert "? cycles" in units_table({})
