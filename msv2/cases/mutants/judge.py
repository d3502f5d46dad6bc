"""Judges the mutants of a unit: killed by the unit's suite, equal to the sound circuit, or survived."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

from msv2.cases.mutants import equal, mutate
from msv2.cases.mutants.play import SURVIVED, Player, bench_of
from msv2.cases.mutants.targets import Target


def judge(
    target: Target, count: int, seed: int, folder: Path, tick: Callable[[int], object] = lambda number: None,
) -> dict[str, Any]:
    """Draws mutants of a unit and judges each.

    Args:
        count, seed: how many mutants, and which.
        folder: for files.
        tick: is called with the number of each mutant that has been played.

    Returns:
        JSON-ready: `drawn`, `killed`, `equal`, how many were killed in which way, in `kills`, and `survivors`, each with what
        is changed and the lines of Python that made it.

    Raises:
        RuntimeError: the suite fails without a mutant, or Yosys or the simulator do.
    """
    bench = bench_of(target, folder)
    mutants = mutate.draw(bench.text, bench.module, count, seed, folder, target.apart)
    verdicts = Player(bench, mutants, folder).play([mutant.number for mutant in mutants], tick)
    alive = [mutant for mutant in mutants if verdicts[mutant.number].result == SURVIVED]
    same = equal.equal(alive, bench.module, folder, bench.playback.verilog)
    kills = Counter(verdict.result for verdict in verdicts.values() if verdict.result != SURVIVED)
    return {
        "unit": target.name, "machine": target.machine, "suite": target.module, "drawn": len(mutants),
        "killed": sum(kills.values()), "equal": len(same), "kills": dict(sorted(kills.items())),
        "survivors": [{"number": mutant.number, "what": mutant.words, "lines": list(mutant.lines)}
                      for mutant in alive if mutant.number not in same]}
