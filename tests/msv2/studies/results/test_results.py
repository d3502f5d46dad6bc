"""The results' commands: what the frames that they keep depend on, no more and no less."""

from __future__ import annotations

import sys

from msv2.studies import destination
from msv2.studies.record import OTHER_SOURCES
from msv2.studies.results import headline, study
from msv2.studies.rtl_frame import COMMAND
from spec.paths import ROOT
from spec.sources import sources_of


def test_a_frame_depends_on_what_its_command_imports_and_on_nothing_else() -> None:
    """Not on the other units' benches, training, measures of quality or studies: whatever else grows."""
    names = {path.relative_to(ROOT).as_posix() for path in (*sources_of(COMMAND), *OTHER_SOURCES[COMMAND])}
    assert {"tb/top/memory.sv", "tb/frame/whole.py", "rtl/top/machine.py", "spec/memory.py", "golden/host/rounding.py"} <= names
    assert {name.partition("/")[0] for name in names} == {"golden", "rtl", "spec", "tb"}
    assert not [name for name in names if "suite" in name or name.startswith("golden/training")]


def test_training_is_made_on_request_of_the_scenes_that_are_there(tmp_path, monkeypatch) -> None:
    commands, fern = [], tmp_path / "posed" / "fern"
    monkeypatch.setattr(study, "run", lambda *command: commands.append(command))
    monkeypatch.setattr(study, "REPORTS", tmp_path / "reports")
    monkeypatch.setattr(study, "fill", lambda *arguments, check: 0)
    monkeypatch.setenv("MSV2_DATA", str(tmp_path))
    monkeypatch.setattr(sys, "argv", ["results.py", "--only", "training"])
    monkeypatch.setattr(destination, "_told", destination._Told(keep=True))
    assert study.main() == 0
    fern.mkdir(parents=True)
    assert study.main() == 0
    monkeypatch.setattr(destination, "_told", destination._Told())
    assert study.main() == 0
    training = ("-m", "msv2.studies", "training", "embedded")
    assert commands == [(*training, "--keep", "--name", "training"), (*training, str(fern), "--keep", "--name", "training"),
                        (*training, str(fern), "--name", "training")]
    assert "training" not in study.PARTS


def test_the_headline_has_the_largest_frames_of_each_scene_at_variant_h():
    rows = [{"scene": scene, "size": size, "variant": variant, "seeds": seeds, "l1_points_of_dense": share,
             "l1_psnr_share": psnr, "cut_foveated": cut}
            for scene, size, variant, seeds, share, psnr, cut in (
                ("a", "200x133", "H", [0], 0.5, 0.9, 2.0), ("a", "400x266", "H", [0, 1], 0.1, 0.99, 8.0),
                ("a", "400x266", "M", [0], 0.1, 0.98, 9.0), ("b", "99x400", "H", [0, 1], 0.3, 1.0, 7.0),
                ("c", "99x400", "H", [0, 1], 0.1, 0.9857, 9.0))]
    left, foveated = headline._training({"training_headline": {"rows": rows}})
    assert left[2] == "10.0 % (a 400x266), 30.0 % (b 99x400), 10.0 % (c 99x400)"
    assert left[3] == "missed on b, c; at 98.57 % of the dense PSNR (H: 99 %); 2 seeds"
    assert foveated[2] == "8.00x (a 400x266), 7.00x (b 99x400), 9.00x (c 99x400)" and "missed on b;" in foveated[3]
