"""Frames through machines that have the effects of a plan and no others: every bit, and one image however it is made."""

import json

import pytest

from spec.errors import InputError
from tb.frame import __main__ as command


def frame(out, *options):
    assert command.main(["embedded", "--config", "tiny", "--size", "64x48", *options, "--out", str(out)]) == 0
    report = json.loads((out / "frame.json").read_text())
    assert report["bit_exact"] and report["counter_errors"] == report["stream_errors"] == []
    return report, (out / "frame.png").read_bytes()


@pytest.mark.long
@pytest.mark.parametrize(
    "view", [(), ("--gaze", "32,24", "--levels", "2", "--levels-from", "random")], ids=["plain", "foveated"])
def test_absent_inactive_and_forced_effects_give_one_image(tmp_path, view):
    absent, picture = frame(tmp_path / "absent", *view)
    inactive, same = frame(tmp_path / "inactive", *view, "--machine", "full")
    forced, again = frame(tmp_path / "forced", *view, "--effects", "all")
    assert picture == same == again
    states = [{name: e["state"] for name, e in r["effects"]["effects"].items()} for r in (absent, inactive, forced)]
    assert states[0] == states[1] and "absent" in states[0].values() and "forced" in states[2].values()
    assert absent["cycles"] <= inactive["cycles"]


@pytest.mark.long
def test_a_forced_second_eye_is_rendered_and_dropped(tmp_path):
    forced, picture = frame(tmp_path / "forced", "--effects", "all", "--pixels", "display")
    plain, same = frame(tmp_path / "plain", "--pixels", "display")
    assert picture == same and forced["target_entries"] > 0 and "target_entries" not in plain


def test_a_frame_without_what_it_calls_for_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"'none' are not accepted: this frame calls for more \(sh: .*contention: memory with"):
        command.main(["embedded", "--config", "tiny", "--size", "64x48", "--effects", "none", "--out", str(tmp_path)])
    assert not list(tmp_path.iterdir())
