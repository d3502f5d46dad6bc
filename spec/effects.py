"""Effects: parts of the renderer that a frame may or may not need, and the machine that has only the needed ones.

An effect is *called for* when leaving it out could change the requested image. It is *active* when its arithmetic runs. In a
machine an effect that is not active is either *inactive* (present, but idle) or *absent* (not elaborated). With `auto` the
effects that are called for run. With `all`, or with a list, more effects may be forced to run on neutral data, which changes no
bit of the image. A list, or `none`, that leaves out an effect that is called for is refused.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

from spec.config import AcceleratorConfig
from spec.errors import InputError


@dataclass(frozen=True)
class Effect:
    """One effect.

    Attributes:
        name: name of the effect on command lines.
        doc: what it does to a frame.
        needs: names of the effects without which it makes no sense.
        without: what a frame saves that does not call for the effect.
    """

    name: str
    doc: str
    needs: tuple[str, ...] = ()
    without: str = ""


EFFECTS = {effect.name: effect for effect in (
    Effect("sh", "colour that depends on the direction", without="harmonics; two of three beats of a colour record"),
    Effect("levels", "foveation levels: each tile renders its own subset of the Gaussians",
           without="the levels' colours and splat records"),
    Effect("blend", "bands in which two levels are blended", ("levels",), "the second accumulators of every pixel"),
    Effect("enhancement", "opacities above 1", without="nothing: alpha's exponent is clipped in any case"),
    Effect("depth", "a depth for every pixel", without="a depth sum for every pixel"),
    Effect("stereo", "a second eye, warped from the first where allowed", ("depth",), "the warp unit; the second pass"),
    Effect("fill", "holes of the warped eye filled from their neighbours", ("stereo",), "the filter's comparisons"),
    Effect("rerender", "tiles of the warped eye with holes rendered", ("stereo",), "those tiles' intersections and pixels"),
    Effect("cleaning", "Gaussians with a number that is not finite dropped",
           without="nothing: the search is needed in any case"),
    Effect("contention", "memory of limited bandwidth",
           without="waiting for memory, which then reads one beat and writes one in every cycle"),
)}
"""All effects by name, in the order in which the data passes them."""

GIVEN = ("enhancement", "cleaning", "contention")
"""Effects that follow from the model's numbers, the host, or the memory. They are present or not, and cannot be forced."""

AUTO, ALL, NONE = "auto", "all", "none"


@dataclass(frozen=True)
class EffectPlan:
    """Which of EFFECTS run for a frame, and why.

    Attributes:
        wanted: what the user asked for: auto, all, none, or names.
        active: effects that run.
        called: effects that the scene and the request call for; a subset of `active`.
        reasons: why each effect is called for, or why not.
        sh_degree: degree of the harmonics that run, 0..3; 0 without `sh`.
    """

    wanted: str
    active: frozenset[str]
    called: frozenset[str]
    reasons: Mapping[str, str]
    sh_degree: int

    def machine(self, config: AcceleratorConfig) -> AcceleratorConfig:
        """`config` without the units of effects that are not active. Number formats stay those of `config`.

        The degree of the harmonics is at most that of `config`.
        """
        return machine_with(config, self.active, min(self.sh_degree, config.sh_degree))

    @property
    def record(self) -> dict[str, object]:
        """The plan as JSON-ready values."""
        return {"wanted": self.wanted, "sh_degree": self.sh_degree, "effects": {
            name: {"state": self.state(name), "reason": self.reasons[name]} for name in EFFECTS}}

    def state(self, name: str) -> str:
        """The state of an effect: "called for", "forced" (it runs on neutral data) or "absent"."""
        return "called for" if name in self.called else "forced" if name in self.active else "absent"

    def lines(self) -> list[str]:
        """One line of text per effect: its name, state and reason."""
        return [f"{name:12}{self.state(name):12}{self.reasons[name]}" for name in EFFECTS]


def with_two_eyes(config: AcceleratorConfig) -> AcceleratorConfig:
    """`config` with the warp unit, for frames of two eyes.

    Raises:
        InputError: a machine with lists by super-tile has no warp unit; it may have joint frames (`with_joint_frames`).
    """
    if config.supertiles:
        raise InputError(f"two eyes are not accepted: config {config.name!r} has lists by super-tile and warps no second eye; "
                         "config 'paper' does, and config 'v3_eyes' renders joint frames")
    return config.with_(stereo=True)


def with_joint_frames(config: AcceleratorConfig) -> AcceleratorConfig:
    """`config`, whose RTL renders joint frames of two eyes (`spec.joint`).

    Raises:
        InputError: the RTL renders one eye, or warps the second; the integer renderer has joint frames for every machine with
            super-tiles.
    """
    if not config.joint:
        raise InputError(f"two eyes are not accepted: the RTL of config {config.name!r} has no joint frames; config 'v3_eyes' "
                         "has them, and so does a machine with lists by super-tile and `joint=true`; config 'paper' warps the "
                         "second eye")
    return config


def with_packed_frames(config: AcceleratorConfig) -> AcceleratorConfig:
    """`config`, which packs frames.

    Raises:
        InputError: the machine does not pack frames.
    """
    if not config.packed:
        raise InputError(f"pixels 'packed' are not accepted: config {config.name!r} packs no frames; config 'v3_packed' does, "
                         "and so does a machine with lists by super-tile and `packed=true`")
    return config


def machine_with(config: AcceleratorConfig, active: Collection[str], sh_degree: int) -> AcceleratorConfig:
    """`config` with those effects and no others; `sh_degree` is the degree of its harmonics, 0 without the effect `sh`.

    Raises:
        InputError: see `with_two_eyes`.
    """
    config = with_two_eyes(config) if "stereo" in active else config
    levels, depth, stereo = config.levels if "levels" in active else 1, "depth" in active, "stereo" in active
    return config.with_(sh_degree=sh_degree, levels=levels, blend="blend" in active, depth=depth,
                        fine_depth=depth and not stereo, stereo=stereo)


def choose_plan(wanted: str, reasons: Mapping[str, str], called: frozenset[str], sh_degree: int) -> EffectPlan:
    """The plan for a frame, from what the user wants and what the frame calls for.

    Args:
        wanted: "auto", "all", "none" or names of effects separated by commas.
        reasons: why each effect is called for, or why not, for every effect.
        called: the effects that the frame calls for.
        sh_degree: the degree of harmonics that the frame calls for; a forced `sh` has degree 3.

    Raises:
        InputError: `wanted` names an unknown effect, names an effect without one that it needs, or leaves out an effect that
            the frame calls for.
    """
    if wanted == AUTO:
        active = called
    elif wanted == ALL:
        active = frozenset(EFFECTS) - frozenset(GIVEN) | called
    else:
        active = _listed(wanted) - (frozenset(GIVEN) - called)
    missing = [name for name in EFFECTS if name in called - active]
    if missing:
        why = "; ".join(f"{name}: {reasons[name]}" for name in missing)
        raise InputError(f"effects {wanted!r} are not accepted: this frame calls for more ({why})")
    forced = "sh" in active and (wanted != AUTO)
    return EffectPlan(wanted, active, called, dict(reasons), 3 if forced else sh_degree)


def _listed(wanted: str) -> frozenset[str]:
    names = [] if wanted == NONE else [name.strip() for name in wanted.split(",")]
    for name in names:
        if name not in EFFECTS:
            raise InputError(f"effect {name!r} is not accepted: {AUTO}, {ALL}, {NONE}, or some of {', '.join(EFFECTS)} are")
        lacking = [need for need in EFFECTS[name].needs if need not in names]
        if lacking:
            raise InputError(f"effects {wanted!r} are not accepted: {name} makes no sense without {', '.join(lacking)}")
    return frozenset(names)
