"""Seeded faults in hardware. Some change a setting on which a guard depends; others emit the array or the whole machine without
a guard."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from unittest import mock

from amaranth.hdl import Const

from golden.msv2_ref.pipeline import Frame
from msv2.cases.case import GOLDEN
from msv2.cases.check import MACHINE, see_golden
from msv2.cases.registry import case_named
from rtl import units
from spec.config import AcceleratorConfig
from tb.common.player import play
from tb.top import planned as frames
from tb.top.device import machine
from tb.top.planned import PlannedFrame, planned
from tb.top.player import play_frames
from tb.top.stimuli import Case as Played
from tb.top.suite import run_plan
from tb.vrc_array.array_check import golden_pixels, problems, run_of
from tb.vrc_array.array_device import vrc_playback
from tb.vrc_array.traced import case_of


@dataclass(frozen=True)
class RtlFault:
    """A guard that is removed from the hardware, and the case whose frame must show it.

    Attributes:
        name: the name of the fault.
        case, shot: the case and the shot whose golden frame is played.
        settings: by register, values that are written in place of the frame's own settings.
        patches: names in rtl's modules, with their replacements while the part is emitted.
        part: "array" or "machine".
    """

    name: str
    case: str
    shot: str
    settings: Mapping[str, int] | None = None
    patches: Mapping[str, object] | None = None
    part: str = "array"

    column = "rtl"


_V = MACHINE.formats.view


def _view(value: float) -> int:
    return int(_V.quantise(value))


FAULTS = (
    RtlFault("no near plane", "depth-near-zero", "shot", {"near": _view(1e-30)}),
    RtlFault("near plane an ulp too near", "near-plane-ulp", "shot", {"near": _view(0.25) - 1}),
    RtlFault("no clamp of the Jacobian", "needle-at-the-frustum", "+1.5", {"limits_1": _view(1e30)}),
    RtlFault("principal point forgotten", "principal-point", "odd", {"centre_0": 32 << MACHINE.formats.mean2d.frac_bits}),
    RtlFault("boxes in place of ellipses", "thin-axes", "turned", {"obb": 1}),
    RtlFault("no alpha_max at level 1", "opaque-against-the-stop", "level 1",
             patches={"rtl.vrc_array.pixel_core.saturation_threshold": lambda formats: 1 << 12}),
    RtlFault("pixels do not stop", "opaque-against-the-stop", "veils",
             patches={"rtl.vrc_array.pixel_core.t_stop": lambda formats: 0}),
    RtlFault("colours wrap", "saturations-are-counted", "colours", part="machine",
             patches={"rtl.culling.views.saturate": lambda value, number: value[: number.width]}),
    RtlFault("saturated values are not counted", "saturations-are-counted", "depths", part="machine",
             patches={"rtl.culling.saturations.at_limit": lambda value, number: Const(0)}),
    RtlFault("no guard band", "veil-beyond-the-range", "right", part="machine",
             patches={"rtl.culling.projection.at_limit": lambda value, number: Const(0)}),
)
"""All faults. Those in settings are played in one simulation, each of the others in an array or a machine of its own."""


def frame_of(fault: RtlFault) -> tuple[Frame, int | None, bool]:
    """The golden frame, its merge threshold, and whether the tile test uses boxes."""
    shot = case_named(fault.case).shots(GOLDEN)[fault.shot]
    return see_golden(shot).frame, shot.beta, shot.obb


def _frames(fault: RtlFault) -> list[PlannedFrame]:
    """The case's frame as it is, and with the fault."""
    played = Played(fault.name, *frame_of(fault))
    return [planned(played, "right", reset=False, poison=False),
            planned(played, "faulty", reset=False, changes=dict(fault.settings))]


def settings_caught(faults: Sequence[RtlFault], folder: Path) -> list[tuple[bool, str]]:
    """For faults in settings: whether the correct frame passes and the faulty one fails, and the failure's message."""
    frames = [_frames(fault) for fault in faults]
    failures = run_plan(MACHINE, [frame for pair in frames for frame in pair], folder).failures
    return [_told(failures.get(right.name), failures.get(faulty.name)) for right, faulty in frames]


def emitted_without(fault: RtlFault, unit: str, config: AcceleratorConfig) -> str:
    """The Verilog of a unit, emitted with the fault's patches in place."""
    patches = [mock.patch(name, value) for name, value in fault.patches.items()]
    for patch in patches:
        patch.start()
    try:
        return units.emit(unit, config)
    finally:
        for patch in patches:
            patch.stop()


def array_caught(fault: RtlFault, folder: Path, config: AcceleratorConfig = MACHINE) -> tuple[bool, str]:
    """For a fault in the array: whether its frame fails, and the failure's message. The case's own test shows that the array
    without the fault is right."""
    case, usual = case_of(frame_of(fault)[0], fault.name), vrc_playback(config)
    verilog = emitted_without(fault, "vrc_array", config)
    if verilog == usual.verilog:
        return False, "the array is what it was"
    faulty = replace(usual, name="vrc-faulty", verilog=verilog)
    recording, = play(faulty, [run_of(config, case)], folder)
    return _told([], problems(config, case, recording, golden_pixels(config, case)))


def machine_caught(fault: RtlFault, folder: Path, config: AcceleratorConfig = MACHINE) -> tuple[bool, str]:
    """The same for a fault in another unit of the machine. The case's own frames show that the machine without it is right."""
    item, usual = planned(Played(fault.name, *frame_of(fault)), "faulty"), machine(config)
    verilog = emitted_without(fault, units.TOP, config)
    if verilog == usual.verilog:
        return False, "the machine is what it was"
    result, = play_frames(replace(usual, name=f"{usual.name}-faulty", verilog=verilog), [item.run], folder)
    return _told([], frames.problems(item, result))


def _told(right: list[str] | None, faulty: list[str] | None) -> tuple[bool, str]:
    if right:
        return False, f"fails without the fault: {right[0]}"
    return (True, faulty[0]) if faulty else (False, "the frame does not change")


def caught(folder: Path) -> dict[str, tuple[bool, str]]:
    """The results of all faults, by name."""
    in_settings = [fault for fault in FAULTS if fault.settings is not None]
    found = dict(zip((fault.name for fault in in_settings), settings_caught(in_settings, folder / "settings"), strict=True))
    for number, fault in enumerate(fault for fault in FAULTS if fault.patches is not None):
        caught_in = machine_caught if fault.part == "machine" else array_caught
        found[fault.name] = caught_in(fault, folder / f"{fault.part}{number}")
    return found
