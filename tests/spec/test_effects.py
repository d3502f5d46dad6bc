"""Plans of effects: what runs, what is refused, which machine comes of it."""

import pytest

from spec.config import PAPER, TINY
from spec.effects import EFFECTS, GIVEN, choose_plan
from spec.errors import InputError

REASONS = {name: f"because of {name}" for name in EFFECTS}


def plan(wanted, *called, degree=0):
    return choose_plan(wanted, REASONS, frozenset(called), degree)


def test_auto_runs_what_is_called_for():
    got = plan("auto", "sh", "levels", degree=2)
    assert got.active == {"sh", "levels"} and got.sh_degree == 2
    assert [got.state(name) for name in ("sh", "levels", "blend")] == ["called for", "called for", "absent"]


def test_all_forces_the_rest():
    got = plan("all", "levels")
    assert got.active == set(EFFECTS) - set(GIVEN) and got.called == {"levels"} and got.sh_degree == 3
    assert got.state("sh") == "forced" and got.state("levels") == "called for"


def test_what_a_frame_has_or_has_not_is_not_forced():
    assert plan("all", "cleaning").state("cleaning") == "called for" and plan("all").state("contention") == "absent"
    assert plan("sh,contention,enhancement", "contention").active == {"sh", "contention"}


def test_a_list_is_what_it_says():
    assert plan("sh, depth", "depth").active == {"sh", "depth"}
    assert plan("none").active == frozenset()


@pytest.mark.parametrize(("wanted", "called", "says"), [
    ("none", {"sh"}, r"'none' are not accepted: this frame calls for more \(sh: because of sh\)"),
    ("depth", {"depth", "stereo"}, "stereo: because of stereo"),
    ("fog", set(), r"effect 'fog' is not accepted: auto, all, none, or some of sh, levels"),
    ("", set(), "effect '' is not accepted"),
    ("blend", set(), "blend makes no sense without levels"),
    ("depth,fill", set(), "fill makes no sense without stereo"),
])
def test_refused_with_the_reason(wanted, called, says):
    with pytest.raises(InputError, match=says):
        plan(wanted, *called)


def test_the_machine_has_what_is_active_and_no_more():
    bare = plan("auto").machine(PAPER)
    assert (bare.sh_degree, bare.levels, bare.blend, bare.depth, bare.stereo) == (0, 1, False, False, False)
    assert not bare.fine_depth and plan("auto", "depth").machine(PAPER).fine_depth
    assert bare.level_banks == 1 and bare.name == "paper" and bare.culling_units == PAPER.culling_units
    everything = plan("all").machine(TINY)
    assert everything == TINY.with_(stereo=True)
    sharp = plan("auto", "levels").machine(TINY)
    assert sharp.levels == 4 and sharp.level_banks == 1


def test_the_record_names_every_effect_with_its_reason():
    record = plan("all", "sh").record
    assert list(record["effects"]) == list(EFFECTS) and record["effects"]["sh"] == {
        "state": "called for", "reason": "because of sh"}
    assert len(plan("auto").lines()) == len(EFFECTS)
