"""`msv2 train embedded --ship`: what it chooses, what it writes, what it refuses."""

import json

import pytest

pytest.importorskip("torch")

from golden.scenes.embedded import trained
from golden.train import main, parse_arguments
from golden.training import run, ship
from spec.errors import InputError


@pytest.fixture
def shipped(tmp_path, monkeypatch):
    """The package's file and record, in a folder of the test's."""
    monkeypatch.setattr(trained, "FILE", tmp_path / "trained.npz")
    monkeypatch.setattr(trained, "RECORD", tmp_path / "trained.json")
    monkeypatch.setattr(run, "write_report", lambda *args, **kwargs: {
        "psnr_dense": 0.0, "psnr_l1": 0.0, "seconds": {"total": 12.3}})  # its renderers take long to compile
    return tmp_path


TINY = ["--ship", "--size", "48x48", "--iterations", "20", "--max-points", "300", "--views", "9", "--device", "cpu"]


def test_a_small_model_is_shipped(shipped, capsys):
    assert main([*TINY, "--out", str(shipped / "out")]) == 0
    record = json.loads((shipped / "trained.json").read_text())
    assert record == trained.record() and record["options"]["views"] == 9 and record["training_seconds"] == 12
    assert record["views"] == {"train": 5, "validation": 2, "test": 2}
    model = trained.load_trained(shipped / "trained.npz")
    assert len(model) == record["levels"][0]["points"] and model.levels == 4
    assert record["sha256"][:12] in capsys.readouterr().out


def test_a_model_that_is_too_large_leaves_the_old_file(shipped, monkeypatch):
    monkeypatch.setattr(ship, "MAX_BYTES", 1000)
    (shipped / "trained.npz").write_bytes(b"old")
    with pytest.raises(InputError, match="up to 1,000 are shipped"):
        main([*TINY, "--out", str(shipped / "out")])
    assert (shipped / "trained.npz").read_bytes() == b"old" and not (shipped / "trained.json").exists()


def test_settings_that_are_not_given_are_the_shipped_models():
    args = parse_arguments(["--ship", "--iterations", "99"])
    ship.take_ship_arguments(args)
    assert args.iterations == 99 and args.out.name == "embedded_trained"
    assert all(getattr(args, name) == value for name, value in ship.PRESET.items() if name != "iterations")
    plain = parse_arguments([])
    ship.take_ship_arguments(plain)
    assert vars(plain) == vars(parse_arguments([]))


@pytest.mark.parametrize(("argv", "says"), [
    (["fern", "--ship"], "--ship is not accepted with the scene fern"), (["fern", "--views", "9"], "--views is not accepted"),
    (["--views", "2"], "views 2 is not accepted: 3 or more"),
    (["--ship", "--baseline", "smfr"], "baseline 'smfr' is not accepted"),
])
def test_what_is_refused(argv, says):
    with pytest.raises(InputError, match=says):
        main(argv)
