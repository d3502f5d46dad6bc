"""Simulates a golden frame of two eyes, joint or with a warped eye, on the whole machine, and computes the cost of warping."""

from __future__ import annotations

from pathlib import Path

from golden.msv2_ref.eyes import StereoFrame
from golden.msv2_ref.joint import JointFrame
from golden.msv2_ref.joint_warp import WarpedJointFrame
from golden.scenes.pictures import kinds_picture, save_png
from spec.records import frame_tiles
from spec.stereo import clear_cycles
from tb.common.runner import Waves
from tb.frame.whole import compared, joint_performance, joint_warp_performance, performance, picture, played
from tb.top.check_joint import joint_counter_errors, joint_mismatches, joint_run
from tb.top.check_joint_warp import joint_warp_counter_errors, joint_warp_mismatches, joint_warp_run
from tb.top.check_stereo import stereo_counter_errors, stereo_mismatches, stereo_run
from tb.top.device import Machine
from tb.top.memory import MemorySpeed
from tb.top.player import FrameResult


def simulate_eyes(
    frame: StereoFrame, machine: Machine, folder: Path, *, beta: int | None, speed: MemorySpeed, waves: Waves | None = None,
) -> tuple[dict[str, object], FrameResult]:
    """The numbers of frame.json, and the machine's output.

    Raises:
        SimulationError: the build fails, or the machine does not finish its frame.
    """
    source, target, config = frame.source, frame.target, frame.source.config
    cleared = frame_tiles(config) + clear_cycles(config)  # cycles once after a reset, which do not belong to the frame
    run = stereo_run(frame, beta, speed, settle=cleared)
    (result,), build_s = played(machine, [run], folder, waves)
    wrong, r = stereo_mismatches(frame, result), result.registers
    numbers = {
        **compared([source, target], result, wrong, stereo_counter_errors(frame, result)),
        "source_entries": len(source.entries.splat), "target_entries": len(target.entries.splat),
        **performance(source, result, speed, second=target),
        "target_cycles": r["cycles_target"], "source_cycles": r["cycles_total"] - r["cycles_target"],
        **{f"stereo_{name}": r[name] for name in frame.events},
        "shares": frame.shares,
        "build_s": build_s,
    }
    numbers["stereo_overhead"] = overhead(numbers)
    return numbers, result


def simulate_joint(
    frame: JointFrame, machine: Machine, folder: Path, *, beta: int | None, speed: MemorySpeed, display: bool,
    packed: bool = False, waves: Waves | None = None,
) -> tuple[dict[str, object], FrameResult]:
    """The same of a joint frame, whose pixels may have every format.

    Raises:
        SimulationError: the build fails, or the machine does not finish its frame.
    """
    (result,), build_s = played(machine, [joint_run(frame, beta, speed, display=display, packed=packed)], folder, waves)
    numbers = {
        **compared(frame.eyes, result, joint_mismatches(frame, result), joint_counter_errors(frame, result)),
        "groups": int(frame.source.groups[-1]) + 1,
        "source_entries": len(frame.source.entries.splat), "target_entries": len(frame.target.entries.splat),
        "pairs": len(frame.pairs.splat), "shift": frame.registers.shift, "lists": frame.bounds.lists,
        **joint_performance(frame, result, speed), "build_s": build_s}
    return numbers, result


def simulate_joint_warp(
    frame: WarpedJointFrame, machine: Machine, folder: Path, *, beta: int | None, speed: MemorySpeed,
    waves: Waves | None = None,
) -> tuple[dict[str, object], FrameResult]:
    """The same of a joint frame with a warped target.

    Raises:
        SimulationError: the build fails, or the machine does not finish its frame.
    """
    run = joint_warp_run(frame, beta, speed, settle=clear_cycles(frame.config))
    (result,), build_s = played(machine, [run], folder, waves)
    numbers = {
        **compared(frame.sweeps.eyes, result, joint_warp_mismatches(frame, result), joint_warp_counter_errors(frame, result)),
        "groups": frame.groups, "source_entries": len(frame.source.entries.splat),
        "target_entries": len(frame.target.entries.splat), "pairs": len(frame.joint.pairs.splat), "pairs_again": frame.again,
        "shift": frame.registers.shift, "lists": frame.joint.bounds.lists, "shares": frame.shares,
        "sweep_cycles": result.registers["cycles_target"], **joint_warp_performance(frame, result, speed), "build_s": build_s}
    return numbers, result


def save_joint(frame: JointFrame, result: FrameResult, out: Path) -> None:
    """Writes left.png and right.png as the machine rendered them."""
    pictures = [picture(eye, pixels) for eye, pixels in zip(frame.eyes, (result.pixels, result.target), strict=True)]
    for name, image in zip(("left", "right"), frame.pair.left_right(*pictures), strict=True):
        save_png(out / f"{name}.png", image)


def overhead(numbers: dict) -> float:
    """The cycles of both eyes divided by those of a machine in which warping is free. The latter are the cycles of the geometry
    phase and those of the busiest stage for the rendered intersections."""
    return round(numbers["cycles"] / (numbers["geometry_cycles"] + numbers["bound_cycles"]), 4)


def save_eyes(frame: StereoFrame | WarpedJointFrame, result: FrameResult, out: Path) -> None:
    """Writes left.png and right.png as the machine rendered them, and right_source.png or left_source.png, which shows how each
    pixel of the target eye was obtained."""
    source, target = (pixels.colour.astype("uint8") for pixels in (result.pixels, result.target))
    left, right = frame.pair.left_right(source, target)
    for name, image in (("left", left), ("right", right),
                        (f"{frame.pair.target_eye}_source", kinds_picture(target, frame.origin))):
        save_png(out / f"{name}.png", image)
