"""The cocotb side of `msv2.cases.mutants.play`: a simulation that forks once for each mutant.

The simulator starts once. Every mutant is played by a copy of the process, so that none finds what another one left behind,
and one that crashes or does not end takes nothing with it. The copy of number 0, the sound circuit, is played first. A mutant
stops at the first run whose outputs differ from the sound circuit's, unless the orders tell it to play all runs.

This module runs in the simulator's process. It reads orders.json, and writes a file for each mutant.
"""

from __future__ import annotations

import json
import os
import resource
import shutil
import time
from pathlib import Path

import cocotb
from cocotb.clock import Clock
from cocotb.triggers import ClockCycles

from msv2.cases.mutants.mutate import SELECT
from tb.common.recordings import finish, result, start
from tb.common.runner import CLOCK_NS

_FILE_BYTES = 64 << 20


@cocotb.test()
async def mutants(dut: object) -> None:
    """Plays all mutants of the orders, one after the other."""
    folder = Path(os.environ["PLAYBACK_FOLDER"])
    orders = json.loads((folder / "orders.json").read_text())
    sound: list[dict] = []
    if 0 not in orders["mutants"]:
        sound = _sound(folder, orders)
    for number in orders["mutants"]:
        child = os.fork()
        if child == 0:
            await _play(dut, folder, orders, number, sound)
            os._exit(0)
        _, status = os.waitpid(child, 0)
        if status:
            code = os.waitstatus_to_exitcode(status)
            (folder / "mutants" / f"{number}.json").write_text(json.dumps({"died": code}))
        if number == 0 and not status:
            sound = _sound(folder, orders)


def _sound(folder: Path, orders: dict) -> list[dict]:
    """The sound circuit's results of all runs, with the bytes of its outputs."""
    kept = json.loads((folder / "mutants" / "0.json").read_text())["runs"]
    return [{**kept[str(n)], "bytes": _bytes(folder / "mutants" / "0" / str(n), run)} if run["abort"] is None else {}
            for n, run in enumerate(orders["runs"])]


def _bytes(folder: Path, run: dict) -> list[bytes]:
    return [(folder / f"{name}.out").read_bytes() for name in run["expected"]]


async def _play(dut: object, folder: Path, orders: dict, number: int, sound: list[dict]) -> None:
    """Plays the runs with one mutant, and writes the results of those that differ; all of them for the sound circuit."""
    resource.setrlimit(resource.RLIMIT_CPU, (orders["seconds"], orders["seconds"]))
    resource.setrlimit(resource.RLIMIT_FSIZE, (_FILE_BYTES, _FILE_BYTES))
    begin = time.process_time()
    found: dict[int, dict] = {}
    owner = dut
    for name in orders["scope"]:
        owner = getattr(owner, name)
    getattr(owner, SELECT).value = number
    dut.active.value, dut.rst.value, dut.watchdog.value = 0, 1, orders["watchdog"]
    cocotb.start_soon(Clock(dut.clk, CLOCK_NS, "ns").start())
    for n, run in enumerate(orders["runs"]):
        await start(dut, n, run)
        if run["abort"] is None:
            await finish(dut, list(run["expected"]))
        else:
            await ClockCycles(dut.clk, run["abort"])
            dut.rst.value = 1
            await ClockCycles(dut.clk, 1)
        got = {**result(dut, orders["ports"], orders["observed"]), "seconds": 0.0}
        dut.active.value = 0
        await ClockCycles(dut.clk, 1)
        if run["abort"] is not None:
            continue
        wrong = number == 0 or _differs(folder / str(n), run, got, sound[n])
        if wrong:
            found[n] = got
            place = folder / "mutants" / str(number) / str(n)
            place.mkdir(parents=True, exist_ok=True)
            for name in run["expected"]:
                shutil.copyfile(folder / str(n) / f"{name}.out", place / f"{name}.out")
        if wrong == "outputs" and number not in orders["insist"]:
            break
    (folder / "mutants" / f"{number}.json").write_text(json.dumps({"runs": found, "cpu": time.process_time() - begin}))


def _differs(folder: Path, run: dict, got: dict, sound: dict) -> str:
    """"outputs", "timing", or nothing where a run gave what the sound circuit gave."""
    if got["errors"] != sound["errors"] or got["observed"] != sound["observed"] or _bytes(folder, run) != sound["bytes"]:
        return "outputs"
    return "timing" if any(got[key] != sound[key] for key in ("cycles", "items", "stalls")) else ""
