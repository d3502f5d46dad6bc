"""The testbench's own tests: a unit with selectable faults, each of which must be found, and a good one that must pass."""

import numpy as np
import pytest

from spec.packing import pack, unpack
from tb.common import runner
from tb.common.patterns import Pattern
from tb.common.playback import ERRORS
from tb.common.player import Run, play
from tb.common.runner import Design, SimulationError, Waves, build, simulate
from tests.helpers.faulty_unit import CHANGES, DOUBLES, RECORD, REPEATS, STOPS, SWALLOWS, WITHDRAWS, faulty_playback

COUNT, KEY = 50, 0xA5


def run_with(fault: int = 0, pattern: Pattern = Pattern.NEVER, **options) -> Run:
    rng = np.random.default_rng(fault)
    rows = np.zeros((2, COUNT), RECORD.dtype)
    rows["number"] = np.arange(COUNT)
    rows["values"] = rng.integers(-(2**20), 2**20, (2, COUNT, 9))
    patterns = {name: (pattern, seed) for seed, name in enumerate(("left", "right", "out"))}
    inputs, settings = {"left": rows[0], "right": rows[1]}, {"key": KEY, "fault": fault}
    return Run(f"fault {fault}", inputs, {"out": COUNT}, settings, patterns, **options)


def expected_rows(run: Run) -> np.ndarray:
    patterns = pack(RECORD, run.inputs["left"]) ^ pack(RECORD, run.inputs["right"])
    patterns[:, 0] ^= KEY
    return unpack(RECORD, patterns)


RUNS = {
    **{pattern.value: run_with(pattern=pattern) for pattern in Pattern},
    "cut off": run_with(abort=20),
    "after the reset": run_with(),
    "without a reset": run_with(reset=False, quiet=0),
    "changes": run_with(CHANGES, Pattern.RANDOM),
    "withdraws": run_with(WITHDRAWS, Pattern.RANDOM),
    "swallows": run_with(SWALLOWS),
    "doubles": run_with(DOUBLES),
    "stops": run_with(STOPS),
    "repeats for ever": run_with(REPEATS),
    "after the faults": run_with(),
}


@pytest.fixture(scope="module")
def recordings(tmp_path_factory):
    played = play(faulty_playback(), list(RUNS.values()), tmp_path_factory.mktemp("playback"), watchdog=2000)
    return dict(zip(RUNS, played, strict=True))


@pytest.mark.parametrize("name", [*(p.value for p in Pattern), "after the reset", "without a reset", "after the faults"])
def test_a_good_unit_passes(recordings, name):
    recording = recordings[name]
    assert recording.errors == ()
    assert recording.items == {"left": COUNT, "right": COUNT, "out": COUNT}
    assert (recording.outputs["out"] == expected_rows(RUNS[name])).all()
    assert recording.observed["count"] == COUNT * (2 if name == "without a reset" else 1)


def test_pauses_cost_cycles(recordings):
    assert recordings["never"].cycles <= COUNT + 3
    assert recordings["never"].stalls == {"left": 0, "right": 0, "out": 0}
    assert recordings["always"].cycles >= 2 * COUNT
    assert recordings["bursty"].stalls["out"] > 0


@pytest.mark.parametrize(
    ("name", "bits"),
    [("changes", 1), ("withdraws", 1), ("swallows", 2), ("doubles", 4), ("stops", 2 | 8), ("repeats for ever", 4)])
def test_faults_are_caught(recordings, name, bits):
    assert set(recordings[name].errors) >= {text for bit, text in ERRORS.items() if bit & bits}


@pytest.mark.parametrize(("fault", "wrong"), [(0, None), (CHANGES, "changed an offer"), (SWALLOWS, "AssertionError")])
def test_sources_and_sinks_in_python(fault, wrong, tmp_path):
    playback = faulty_playback()
    wires = [f"{port}__{wire}" for port in ("left", "right", "out") for wire in ("payload", "valid", "ready")]
    design = Design("faulty-alone", "faulty_unit", (("dut.v", playback.verilog),), ("clk", "rst", "key", "fault", *wires))
    arguments = (design, "tests.helpers.streams_in_simulator", tmp_path)
    if wrong is None:
        simulate(*arguments, env={"UNIT_FAULT": str(fault)})
    else:
        with pytest.raises(SimulationError, match=wrong):
            simulate(*arguments, env={"UNIT_FAULT": str(fault)})


def test_an_unchanged_design_is_not_built_again(recordings, monkeypatch):
    folder = build(faulty_playback().design())
    monkeypatch.setattr(runner, "_build", lambda *_: pytest.fail("built again"))
    assert build(faulty_playback().design()) == folder


def test_verilog_that_does_not_build_says_why():
    with pytest.raises(SimulationError, match="syntax error"):
        build(Design("broken", "broken", (("dut.v", "module broken(input clk; endmodule"),), ("clk",)))


def test_missing_tools_are_named(monkeypatch):
    monkeypatch.setattr(runner.shutil, "which", lambda program: None if program == "perl" else f"/usr/bin/{program}")
    with pytest.raises(SimulationError, match=r"perl not found: install with `apt-get install perl`"):
        runner.check_tools()


@pytest.mark.parametrize("window", [(5, 5), (-1, 3)])
def test_windows_that_hold_nothing_are_refused(window):
    with pytest.raises(ValueError, match="not"):
        Waves(*window)


@pytest.mark.long
def test_waves_hold_the_window_and_the_scopes_only(tmp_path):
    sizes = []
    for waves in (Waves(), Waves(10, 20), Waves(10, 20, ("tb.dut*",))):
        play(faulty_playback(), [RUNS["bursty"]], tmp_path, waves=waves)
        sizes.append((tmp_path / "dump.fst").stat().st_size)
    assert sizes[0] > sizes[1] > sizes[2] > 200
