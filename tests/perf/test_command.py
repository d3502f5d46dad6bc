"""`msv2 perf` as a user meets it: the machine that it models, what it writes, what it refuses."""

import json
from pathlib import Path

import pytest

from golden.scenes.save import save_model
from perf import __main__ as command
from spec.errors import InputError
from tests.helpers.golden_samples import ball


@pytest.fixture(scope="module")
def scene(tmp_path_factory) -> Path:
    """A ball of splats whose colours do not depend on the direction."""
    path = tmp_path_factory.mktemp("scene") / "ball.ply"
    save_model(ball(), path)
    return path


@pytest.fixture
def perf(scene, tmp_path, monkeypatch):
    """Runs the command on the scene and returns perf.json."""
    monkeypatch.setattr(command, "CACHE", tmp_path / "traces")

    def run(*argv: str) -> dict:
        out = tmp_path / "out"
        assert command.main([str(scene), "--size", "48x32", "--config", "tiny", "--out", str(out), *argv]) == 0
        assert (out / "perfetto.json").stat().st_size > 100
        return json.loads((out / "perf.json").read_text())

    return run


def active(found: dict) -> set[str]:
    return {name for name, effect in found["effects"]["effects"].items() if effect["state"] != "absent"}


def test_the_machine_is_the_one_that_the_scene_calls_for(perf, capsys):
    scene, full = perf(), perf("--machine", "full")
    assert (scene["machine"], full["machine"]) == ("scene", "full")
    assert active(scene) == active(full) == {"contention"}
    assert scene["entries"] == full["entries"] and scene["total"] < full["total"]
    assert "sh          absent" in capsys.readouterr().out


def test_effects_are_forced_as_in_frame(perf):
    plain, forced = perf("--bandwidth", "unlimited"), perf("--bandwidth", "unlimited", "--effects", "sh")
    assert active(plain) == set() and active(forced) == {"sh"}
    assert forced["entries"] == plain["entries"]
    assert forced["dram_bytes"]["reads"]["colour"] > plain["dram_bytes"]["reads"]["colour"]
    deep = perf("--bandwidth", "unlimited", "--depth")
    assert active(deep) == {"depth"}


def test_a_kept_trace_gives_the_same_frame(perf, tmp_path):
    first = perf("--gaze", "20,10", "--levels", "2", "--levels-from", "random")
    kept = list((tmp_path / "traces").iterdir())
    again = perf("--gaze", "20,10", "--levels", "2", "--levels-from", "random")
    assert list((tmp_path / "traces").iterdir()) == kept and len(kept) == 1
    assert first["total"] == again["total"] and first["effects"] == again["effects"]
    # the scene has no harmonics: the same machine
    perf("--gaze", "20,10", "--levels", "2", "--levels-from", "random", "--set", "sh_degree=1")
    assert list((tmp_path / "traces").iterdir()) == kept
    perf("--gaze", "20,10", "--levels", "2", "--levels-from", "random", "--set", "support_sigma=2.5")
    assert len(list((tmp_path / "traces").iterdir())) == 2
    perf("--gaze", "20,10", "--levels", "2", "--levels-from", "spread")  # other levels: another trace
    assert len(list((tmp_path / "traces").iterdir())) == 3


def test_the_memory_is_lpddr3_unless_the_ideal_one_is_asked_for(perf):
    real, bound, slow = perf(), perf("--memory", "ideal"), perf("--bandwidth", "6.4")
    assert [found["memory"] for found in (real, bound, slow)] == ["lpddr3", "ideal", "ideal"]
    assert bound["total"] < slow["total"] and real["activates"] > 0 == bound["activates"] == slow["activates"]
    assert (bound["bytes_per_cycle"], slow["bytes_per_cycle"], real["bytes_per_cycle"]) == (25.6, 6.4, None)


def test_changed_machines_are_modelled_and_recorded(perf):
    found = perf("--set", "sort_buffer_bytes=512", "--pipeline", "0", "--merge", "0")
    assert found["configuration"]["sort_buffer_bytes"] == 512 and found["config"].startswith("tiny_x")
    assert (found["pipeline"], found["merge"]) == (False, False)


def test_machines_with_super_tiles_have_their_own_stages_and_traces(perf, tmp_path):
    tile, supertile = perf(), perf("--config", "tiny_v3")
    assert supertile["pairs"] > 0 and "pairs" not in tile and tile["entries"] == supertile["entries"]
    assert supertile["stages"]["batch"]["busy"] > 0 and "views" not in supertile["dram_bytes"]["reads"]
    assert len(list((tmp_path / "traces").iterdir())) == 2


def test_the_clock_matters_to_dram_alone(perf):
    ideal = [perf("--memory", "ideal", *clock)["total"] for clock in ((), ("--clock-mhz", "500"))]
    assert ideal[0] == ideal[1]
    fast, slow = (perf("--memory", "lpddr3", *clock) for clock in ((), ("--clock-mhz", "500")))
    assert (fast["clock_mhz"], slow["clock_mhz"]) == (1000, 500) and slow["total"] < 0.9 * fast["total"]
    assert fast["latency"] is fast["bytes_per_cycle"] is None and fast["memory"] == "lpddr3"


@pytest.mark.parametrize(("argv", "says"), [
    (["--machine", "half"], "machine 'half'"),
    (["--memory", "ddr5"], "memory 'ddr5' is not accepted: choose one of ideal, lpddr3"),
    (["--clock-mhz", "0.5"], "clock of 0.5 MHz is not accepted: 1..100,000 MHz are"),
    (["--stereo"], "two eyes are not accepted: config 'default' has .*; config 'paper' does"),
    (["--stereo", "--config", "fast"], "two eyes are not accepted: config 'fast'"),
    (["--stereo", "--pixels", "wide"], "pixels 'wide' is not accepted with --stereo"), (["--config", "huge"], "config 'huge'"),
    (["--effects", "fog"], "effect 'fog'"), (["--size", "0x1"], "'0x1'"),
])
def test_bad_requests_are_named_and_write_nothing(scene, tmp_path, argv, says):
    with pytest.raises(InputError, match=says):
        command.main([str(scene), "--out", str(tmp_path / "out"), *argv])
    assert not (tmp_path / "out" / "perf.json").exists()
