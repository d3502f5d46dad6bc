"""Energy of DRAM: each part by hand from the data sheet's currents, and between what other published sets of currents give."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from msv2.studies.energy.dram import GROUPS, LPDDR3, Supply
from msv2.studies.energy.frame import DRAM_UNIT, WorkCounts, counter_counts, frame_energy, model_counts
from msv2.studies.energy.table import Table
from spec.config import PAPER

NO_UNITS = Table(units=(), config="paper", reference={}, node="7 nm", to_16nm=2.5, scaling="x 2.5", flop_leakage_pw=0.0,
                 commit="none")
COUNTS = WorkCounts(read_beats=3000, write_beats=2000, activates=700, refreshes=8)
CYCLES = 10_000

DRAMPOWER = replace(
    LPDDR3, ras_ns=45.0, rp_ns=15.0, rfc_ns=130.0,
    supplies=(Supply(1.8, 15, 2, 2, 5, 10, 40), Supply(1.2, 80, 38, 45, 260, 284, 160)))
"""DRAMPower's MICRON_4Gb_LPDDR3-1600_32bit_A.xml."""

DRAMSIM3 = replace(LPDDR3, ras_ns=42.5, rp_ns=18.75, supplies=(Supply(1.2, 40, 20.5, 21, 250, 245, 150),))
"""DRAMsim3's LPDDR3_8Gb_x32_1600.ini, which has one supply."""


@pytest.fixture(scope="module")
def by_dram() -> dict[str, float]:
    report = frame_energy(COUNTS, CYCLES, PAPER, NO_UNITS)
    assert report.sum_mj("dram") == pytest.approx(sum(report.by_dram().values())) == pytest.approx(report.total_mj)
    assert {row.unit for row in report.rows if row.part == "dram"} == {DRAM_UNIT + name for name in GROUPS}
    return report.by_dram()


def test_activates_by_hand(by_dram):
    """IDD0 over 60 ns, less 42 ns of IDD3N and 18 ns of IDD2N, at both supplies: pJ are mA times ns times V."""
    one = 1.2 * (60 * 60 - 34 * 42 - 26 * 18) + 1.8 * (8 * 60 - 2 * 42 - 0.8 * 18)
    assert one == pytest.approx(2731.68)
    assert by_dram["activates"] == pytest.approx(700 * one * 1e-9)
    assert LPDDR3.activate_pj / (256 * LPDDR3.read_pj_per_bit) > 2  # a row for every second beat costs as much as the beats


def test_bursts_by_hand(by_dram):
    """A burst of 256 bits takes 5 ns."""
    assert by_dram["reads"] == pytest.approx(3000 * 1.2 * (230 - 34) * 5 * 1e-9)
    assert by_dram["writes"] == pytest.approx(2000 * 1.2 * (190 - 34) * 5 * 1e-9)
    standby = LPDDR3.open_mw * 5 / 256
    assert 5.3 < LPDDR3.read_pj_per_bit + standby < 5.6 and 4.4 < LPDDR3.write_pj_per_bit + standby < 4.6  # as usually stated


def test_refresh_and_standby_by_hand(by_dram):
    """8 refreshes of 210 ns, while the channel's rows are closed; four channels for 10 us."""
    assert by_dram["refresh"] == pytest.approx(8 * 210 * (1.2 * (150 - 26) + 1.8 * (28 - 0.8)) * 1e-9)
    closed, opened = 8 * 210, 4 * 10_000 - 8 * 210
    mine = opened * (1.2 * 34 + 1.8 * 2) + closed * (1.2 * 26 + 1.8 * 0.8)
    assert by_dram["standby"] == pytest.approx(mine * 1e-9)


def test_wires_by_hand(by_dram):
    """Data: half of C V^2 for every second bit, and two strobe wires for eight data wires. A command: ten wires with two bits
    each, and a chip select. The clock: two wires at 800 MHz."""
    data, command = 0.5 * 6.5 * 1.44, 0.5 * 5.75 * 1.44
    bits, commands = 256 * 5000, 5000 + 2 * 700 + 8
    mine = bits * data * (0.5 + 0.25) + commands * command * (10 + 2) + 4 * 10_000 * command * 4 * 0.8
    assert by_dram["I/O"] == pytest.approx(mine * 1e-9)


def test_termination_by_hand(by_dram):
    """1.2 V over 274 ohm (reads) or 280 ohm (writes) while a wire is low, for 0.625 ns a bit."""
    low = 0.5 + 1 / 8
    mine = 256 * 0.625 * low * 1e3 * 1.44 * (3000 / 274 + 2000 / 280)
    assert by_dram["termination"] == pytest.approx(mine * 1e-9)
    open_ended = replace(LPDDR3, interface=replace(LPDDR3.interface, termination_ohm=None))
    without = frame_energy(COUNTS, CYCLES, PAPER, NO_UNITS, dram=open_ended).by_dram()
    assert without == {**by_dram, "termination": 0.0}


def test_every_part_names_its_source():
    for row in frame_energy(COUNTS, CYCLES, PAPER, NO_UNITS).rows:
        if row.part == "dram":
            assert any(name in row.source for name in ("EDF8132A1MC", "CACTI-IO", "RK3399")) and "JESD209-3" in row.source


def test_the_ideal_memory_has_no_commands():
    report = frame_energy(replace(COUNTS, activates=None, refreshes=None), CYCLES, PAPER, NO_UNITS)
    assert report.counts.not_counted == ("activates", "refreshes") == tuple(report.as_json()["dram_not_counted"])
    assert report.by_dram()["activates"] == report.by_dram()["refresh"] == 0
    assert not [row for row in report.rows if row.operation in ("activates", "refreshes")]
    assert report.total_mj < frame_energy(COUNTS, CYCLES, PAPER, NO_UNITS).total_mj
    with pytest.raises(ValueError, match="activates must"):
        WorkCounts(activates=-1)
    with pytest.raises(ValueError, match="points must"):
        WorkCounts(points=None)


@pytest.mark.parametrize(("activates", "known"), [(0, False), (5, True)])
def test_commands_come_from_the_model(activates, known):
    eye = SimpleNamespace(rendered=np.ones(4), survivor=np.arange(3), counts=np.arange(4))
    trace = SimpleNamespace(width=32, height=32, points_read=7, eyes=(eye,))
    cycles = SimpleNamespace(entries=6, spilled_entries=0, ops=9, reads={"geometry": 64}, writes={"frame": 32},
                             activates=activates, refreshes=0)
    counts = model_counts(trace, cycles)
    assert (counts.activates, counts.refreshes) == ((5, 0) if known else (None, None))
    assert (counts.points, counts.read_beats) == (7, 2)


def test_commands_come_from_the_bench_where_its_memory_has_them():
    frame = {"events": {"points": 5}, "tiles": 4, "dram_bytes": {"read": 96, "write": 32}, "activates": 3, "refreshes": 0}
    for memory, expected in (("lpddr3", (3, 0)), ("ideal", (None, None))):
        counts = counter_counts(frame | {"memory": memory})
        assert (counts.activates, counts.refreshes) == expected and counts.read_beats == 3


def test_other_published_currents_agree_roughly():
    assert DRAMSIM3.activate_pj < LPDDR3.activate_pj < DRAMPOWER.activate_pj < 3 * DRAMSIM3.activate_pj
    for name in ("read_pj_per_bit", "write_pj_per_bit", "refresh_pj", "open_mw"):
        mine, others = getattr(LPDDR3, name), [getattr(other, name) for other in (DRAMPOWER, DRAMSIM3)]
        assert all(0.5 < other / mine < 1.7 for other in others), (name, mine, others)
