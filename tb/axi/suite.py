"""The tests of the bus: the AXI master on memories of many behaviours, the register file under a host, and the bus's speed."""

from __future__ import annotations

import json
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

from spec.config import TINY, AcceleratorConfig
from spec.overrides import config_record
from tb.axi.device import DEPTH, IN_FLIGHT, READERS, WRITERS, master_design, register_design
from tb.common.exact import Outcome
from tb.common.patterns import Pattern
from tb.common.runner import Waves, simulate

VARIANTS: dict[str, AcceleratorConfig] = {
    "tiny": TINY, "without_counters": TINY.with_(counters=False), "stereo": TINY.with_(stereo=True),
    "memories": TINY.with_(bank_memories=True)}
"""Configurations that can be tested. Only `counters`, `stereo`, `bank_memories` and the number formats matter here; the formats
are the same in every configuration."""

DISTINCT = ("tiny", "without_counters", "stereo", "memories")

REGISTER_SCENARIOS = ("identity", "unmapped", "settings", "crowd", "frames", "bad_settings", "interrupts", "aborts", "counters")
"""The names of the scenarios in `tb.axi.registers`."""

FULL_RATE = 0.98
"""Beats per cycle that the bus must carry in each direction when nothing pauses, not counting start and end."""


@dataclass(frozen=True)
class Scenario:
    """A simulation run of the master.

    Attributes:
        name: the run's name, for messages.
        kind: the memory model: `memory` (`tb.axi.memory`) or `ram` (cocotbext-axi's).
        reads, writes: the number of requests of each client.
        seed: the seed of the traffic and of the memory's behaviour.
        pattern: the pause pattern of the clients.
        temper: the memory's behaviour, see `tb.axi.memory.Temper`; the model `ram` uses only its pauses.
        cut: earlier traffic is started and aborted after this many cycles; 0 for none.
        reset_at: earlier traffic is started and ended by a reset of everything after this many cycles; 0 for none.
        fair: whether to check that all clients are served in turn.
        most_cycles: the largest permitted number of cycles until the last answer; None for no limit.
    """

    name: str
    kind: str
    reads: tuple[int, ...]
    writes: tuple[int, ...]
    seed: int
    pattern: str = Pattern.NEVER.value
    temper: dict[str, object] = field(default_factory=dict)
    cut: int = 0
    reset_at: int = 0
    fair: bool = False
    most_cycles: int | None = None


@dataclass(frozen=True)
class Registers:
    """A simulation run of the register file: one of REGISTER_SCENARIOS with a host that pauses in the fraction `pauses` of
    cycles.

    `config` is the configuration as a record (`spec.overrides.config_record`), because the run is sent to another process.
    """

    name: str
    scenario: str
    pauses: float
    seed: int
    config: dict[str, object]


Planned = Scenario | Registers


@dataclass
class BusOutcome(Outcome):
    """The outcome of a plan, with the number of cycles of every run by its name."""

    cycles_of: dict[str, int] = field(default_factory=dict)


def _temper(
    share: float = 0.0, latency: tuple[int, int] = (1, 1), shuffled: bool = False, failing: int = 0, **pauses: float,
) -> dict[str, object]:
    channels = dict.fromkeys(("ar", "r", "aw", "w", "b"), share) | pauses
    return {"pauses": channels, "latency": latency, "shuffled": shuffled, "failing": failing}


def _traffic(reads: int, writes: int) -> dict[str, tuple[int, ...]]:
    return {"reads": (reads,) * READERS, "writes": (writes,) * WRITERS}


def master_plan(seed: int, count: int) -> list[Scenario]:
    """Runs at full rate, with every memory behaviour, with errors, with single clients and with aborts. `count` is the number
    of requests of a client in long runs."""
    some, often = _traffic(count // 4, count // 4), Pattern.RANDOM.value
    steady = {**_traffic(count, count * READERS // WRITERS), "fair": True}
    most = round(count * READERS / FULL_RATE) + 20
    plan = [
        Scenario("full rate", "memory", **steady, seed=seed, temper=_temper(latency=(4, 4)), most_cycles=most),
        Scenario(f"full rate, {IN_FLIGHT - 6} cycles of latency", "memory", **_traffic(count, 0), seed=seed,
                 temper=_temper(latency=(IN_FLIGHT - 6, IN_FLIGHT - 6)), most_cycles=most + 2 * IN_FLIGHT),
        Scenario("one reader alone", "memory", reads=(0, 0, count, 0, 0), writes=(0, 0, 0), seed=seed,
                 temper=_temper(latency=(DEPTH - 5, DEPTH - 5)), most_cycles=round(count / FULL_RATE) + DEPTH + 20),
        Scenario("one writer alone", "memory", reads=(0,) * READERS, writes=(0, count, 0), seed=seed,
                 temper=_temper(latency=(IN_FLIGHT - 6, IN_FLIGHT - 6)), most_cycles=round(count / FULL_RATE) + IN_FLIGHT + 20),
        Scenario("more than may wait for answers", "memory", **_traffic(IN_FLIGHT, 3 * IN_FLIGHT), seed=seed,
                 temper=_temper(latency=(5 * IN_FLIGHT, 5 * IN_FLIGHT))),
        Scenario("late answers in order", "memory", **some, seed=seed, temper=_temper(latency=(1, 90))),
        Scenario("late answers out of order", "memory", **some, seed=seed, temper=_temper(latency=(1, 90), shuffled=True)),
        Scenario("slow everywhere", "memory", **some, seed=seed, pattern=often,
                 temper=_temper(0.5, (1, 30), shuffled=True)),
        Scenario("errors", "memory", **some, seed=seed, temper=_temper(0.2, (1, 20), shuffled=True, failing=3)),
        Scenario("everything fails", "memory", **_traffic(20, 20), seed=seed, temper=_temper(0.2, (1, 9), failing=1)),
    ]
    plan += [
        Scenario(f"{channel.upper()} slow", "memory", **_traffic(count // 8, count // 8), seed=seed,
                 temper=_temper(latency=(1, 12), shuffled=True, **{channel: 0.9}))
        for channel in ("ar", "r", "aw", "w", "b")]
    plan += [
        Scenario(f"{pattern.value} pauses of the clients", "memory", **some, seed=seed, pattern=pattern.value,
                 temper=_temper(latency=(1, 20), shuffled=True)) for pattern in (Pattern.ALWAYS, Pattern.BURSTY)]
    tempers = (_temper(latency=(1, 1)), _temper(0.5, (1, 40), shuffled=True), _temper(0.0, (60, 60)), _temper(0.8, (1, 5)))
    plan += [
        Scenario(f"after an abort at {cut}, temper {number}", "memory", **_traffic(30, 30), seed=seed + cut,
                 temper=temper, cut=cut) for number, temper in enumerate(tempers) for cut in (3, 20 + number, 71)]
    plan += [
        Scenario(f"after a reset at {cycles}", "memory", **_traffic(30, 30), seed=seed + cycles,
                 temper=_temper(0.3, (1, 40), shuffled=True), reset_at=cycles) for cycles in (4, 25, 90)]
    plan += [
        Scenario("cocotbext's memory", "ram", **some, seed=seed, temper=_temper()),
        Scenario("cocotbext's memory, pausing", "ram", **some, seed=seed + 1, pattern=often, temper=_temper(0.5)),
        Scenario("cocotbext's memory, address first", "ram", **some, seed=seed + 2, temper=_temper(w=0.9, r=0.5)),
        Scenario("cocotbext's memory, data first", "ram", **some, seed=seed + 3, temper=_temper(aw=0.9, b=0.5)),
    ]
    return plan


def register_plan(config: AcceleratorConfig, seed: int) -> list[Registers]:
    """Every register scenario, once without pauses and once with."""
    return [
        Registers(f"registers: {scenario}, {pauses:.0%} pauses", scenario, pauses, seed + i, config_record(config))
        for scenario in REGISTER_SCENARIOS for i, pauses in enumerate((0.0, 0.5))]


def full_plan(config: AcceleratorConfig, seed: int, count: int = 400) -> list[Planned]:
    """The runs of both units. The master's runs are included for one variant only, since it is the same in all."""
    return [*(master_plan(seed, count) if config.counters and not config.stereo else ()), *register_plan(config, seed)]


def run_plan(
    config: AcceleratorConfig, plan: Sequence[Planned], folder: Path, *, waves: Waves | None = None, progress: bool = False,
) -> BusOutcome:
    """Runs a plan with one simulation per unit. Waves are kept from the last one. Raises SimulationError where one does not
    end."""
    begin, outcome = time.perf_counter(), BusOutcome()
    units = (
        (Scenario, "tb.axi.master", master_design, ("memory", "ram")),
        (Registers, "tb.axi.registers", register_design, ("registers",)))
    for kind, module, design, reports in units:
        orders = [item for item in plan if isinstance(item, kind)]
        if not orders:
            continue
        place = (folder / module).resolve()
        place.mkdir(parents=True, exist_ok=True)
        (place / "orders.json").write_text(json.dumps([asdict(order) for order in orders]))
        simulate(design(config), module, place, waves=waves, env={"AXI_FOLDER": str(place)})
        results = [result for report in reports for result in json.loads((place / f"{report}.json").read_text())]
        by_name = {result["name"]: result for result in results}
        for order in orders:
            _judge(order, by_name[order.name], outcome)
    outcome.seconds = time.perf_counter() - begin
    return outcome


def _judge(order: Planned, result: dict, outcome: BusOutcome) -> None:
    problems = list(result["problems"])
    most = getattr(order, "most_cycles", None)
    if most is not None and result["cycles"] > most:
        problems.append(f"{result['cycles']} cycles, more than {most}")
    if problems:
        outcome.failures[order.name] = problems
    outcome.runs += 1
    outcome.cycles_of[order.name] = result["cycles"]
    outcome.items += result["beats"]
    outcome.cycles += result["cycles"]


def figures(config: AcceleratorConfig, plan: Sequence[Planned], outcome: BusOutcome) -> list[str]:
    """What the runs at full rate held."""
    timed = [item for item in plan if isinstance(item, Scenario) and item.most_cycles]
    return [f"{item.name}: {sum(item.reads)} reads and {sum(item.writes)} writes in {outcome.cycles_of[item.name]} cycles"
            for item in timed]
