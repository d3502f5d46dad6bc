"""Effects: what a frame may call for beyond opaque enough Gaussians before a background, and the machine that has just those.

An effect is *called for* when leaving it out could change the requested image, *active* when its arithmetic runs, and, in a
machine, *absent* (not elaborated), *inactive* (there, but idle) or active. Auto runs what is called for; all, or a list, forces
more on neutral data, which changes no bit of the image. A list or none that leaves out what is called for is refused.
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
        name: as on command lines.
        doc: what it does to a frame.
        needs: effects without which it makes no sense.
        without: what a frame saves that does not call for it.
    """

    name: str
    doc: str
    needs: tuple[str, ...] = ()
    without: str = ""


EFFECTS = {effect.name: effect for effect in (
    Effect("sh", "colour that depends on the direction", without="harmonics; two of three beats of a colour record"),
    Effect("levels", "foveation levels: each tile renders its own subset", without="the levels' colours and views"),
    Effect("blend", "bands in which two levels are blended", ("levels",), "the second accumulators of every pixel"),
    Effect("enhancement", "opacities above 1", without="nothing: the clip of alpha is that of its exponent"),
    Effect("depth", "a depth for every pixel", without="a depth sum for every pixel"),
    Effect("stereo", "a second eye, warped where it may be", ("depth",), "the warp unit; the second pass"),
    Effect("fill", "holes of the warped eye filled from their neighbours", ("stereo",), "the filter's comparisons"),
    Effect("rerender", "tiles of the warped eye with holes rendered", ("stereo",), "their entries and pixels"),
    Effect("cleaning", "points with a number that is not finite dropped", without="nothing: finding none is all of the work"),
    Effect("contention", "memory of limited bandwidth", without="waiting for it: a beat read and one written in every cycle"),
)}
"""By name, in the order of the way through the machine."""

GIVEN = ("enhancement", "cleaning", "contention")
"""Effects of the model's numbers, of the host, and of the memory: they are there or not, and cannot be forced."""

AUTO, ALL, NONE = "auto", "all", "none"


@dataclass(frozen=True)
class EffectPlan:
    """What of EFFECTS runs for a frame, and why.

    Attributes:
        wanted: as asked for: auto, all, none, or names.
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
        """`config` with what is not active left out; a machine without levels, too, has the numbers of those it has.

        Harmonics of a higher degree than the configuration's stay left out.
        """
        return machine_with(config, self.active, min(self.sh_degree, config.sh_degree))

    @property
    def record(self) -> dict[str, object]:
        """The plan as JSON-ready values."""
        return {"wanted": self.wanted, "sh_degree": self.sh_degree, "effects": {
            name: {"state": self.state(name), "reason": self.reasons[name]} for name in EFFECTS}}

    def state(self, name: str) -> str:
        """Of an effect: called for, forced on neutral data, or absent."""
        return "called for" if name in self.called else "forced" if name in self.active else "absent"

    def lines(self) -> list[str]:
        """A line for every effect, for people."""
        return [f"{name:12}{self.state(name):12}{self.reasons[name]}" for name in EFFECTS]


def machine_with(config: AcceleratorConfig, active: Collection[str], sh_degree: int) -> AcceleratorConfig:
    """`config` with those effects and no others; `sh_degree`: of its harmonics, 0 without `sh`."""
    levels, depth, stereo = config.levels if "levels" in active else 1, "depth" in active, "stereo" in active
    return config.with_(sh_degree=sh_degree, levels=levels, blend="blend" in active, depth=depth,
                        fine_depth=depth and not stereo, stereo=stereo)


def choose_plan(wanted: str, reasons: Mapping[str, str], called: frozenset[str], sh_degree: int) -> EffectPlan:
    """The plan for what a user wants of what a frame calls for.

    Args:
        wanted: "auto", "all", "none" or names of effects separated by commas.
        reasons: for every effect.
        called: what the frame calls for.
        sh_degree: that it calls for; a forced `sh` has degree 3.

    Raises:
        InputError: an effect that there is not, one without what it needs, or one left out that the frame calls for.
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
