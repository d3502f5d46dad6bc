"""Frames to play, each with its expected results."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from golden.host.memory_image import PackedPixels
from golden.msv2_ref.eyes import StereoFrame
from golden.msv2_ref.joint import JointFrame
from golden.msv2_ref.joint_warp import WarpedJointFrame
from golden.msv2_ref.pipeline import Frame
from spec.codes import ErrorCode
from spec.config import AcceleratorConfig
from spec.memory import BEAT_BYTES
from spec.packed import table_beat
from tb.top.check import counter_errors, frame_run, mismatches
from tb.top.check_joint import joint_counter_errors, joint_mismatches, joint_run
from tb.top.check_joint_warp import joint_warp_counter_errors, joint_warp_mismatches, joint_warp_run
from tb.top.check_stereo import stereo_counter_errors, stereo_mismatches, stereo_run
from tb.top.memory import MemorySpeed
from tb.top.player import FrameResult, FrameRun
from tb.top.stimuli import Case

SPEEDS = {
    "usual": MemorySpeed(), "instant": MemorySpeed(1, None), "far": MemorySpeed(400, None), "slow": MemorySpeed(30, 6.4),
    "pauses": MemorySpeed(20, None, 100)}
"""The memories on which frames are played in turn."""

_SHOWN = 5


@dataclass(frozen=True)
class PlannedFrame:
    """A frame and its expected results.

    Attributes:
        run: the run to play.
        frame: the golden frame; for two eyes, the source eye's.
        error: the error code with which the frame must end.
        registers: the values that registers must hold at the end, by name.
        warped: the golden frame of both eyes, where they have one set of lists and the second is warped on top.
        stereo, joint: the golden frame of both eyes, where there are two and the second is warped, or where they have one set
            of lists.
    """

    run: FrameRun
    frame: Frame
    error: ErrorCode = ErrorCode.NONE
    registers: dict[str, int] = field(default_factory=dict)
    stereo: StereoFrame | None = None
    joint: JointFrame | None = None
    warped: WarpedJointFrame | None = None

    @property
    def name(self) -> str:
        """The run's name, for reports."""
        return self.run.name


def pixels_of(config: AcceleratorConfig, number: int) -> dict[str, bool]:
    """The format of frame number `number`, as arguments of `planned`: every other frame has display pixels. Where the machine
    packs frames, every other frame is packed, and every other one of the rest has display pixels."""
    if config.packed:
        return {"packed": number % 2 == 1, "display": number % 4 == 2}
    return {"display": number % 2 == 1}


def planned(case: Case, name: str = "", speed: str = "usual", error: ErrorCode = ErrorCode.NONE,
            registers: dict[str, int] | None = None, **options: object) -> PlannedFrame:
    """A case on the memory SPEEDS[speed]; `options` are further arguments of `frame_run`, `stereo_run`, `joint_run` or
    `joint_warp_run`."""
    frame = case.frame
    plays = {StereoFrame: stereo_run, JointFrame: joint_run, WarpedJointFrame: joint_warp_run}
    play = plays.get(type(frame), frame_run)
    run = play(frame, case.beta, SPEEDS[speed], ", ".join(filter(None, (case.name, name))), obb=case.obb, **options)
    return PlannedFrame(run, frame if isinstance(frame, Frame) else frame.source, error, registers or {},
                        frame if isinstance(frame, StereoFrame) else None, frame if isinstance(frame, JointFrame) else None,
                        frame if isinstance(frame, WarpedJointFrame) else None)


def failing(case: Case, region: str, error: ErrorCode, registers: dict[str, int], **options: object) -> PlannedFrame:
    """A case in which the memory region of this name answers with errors; `options` as of `planned`."""
    item = planned(case, f"{region} fails", error=error, registers=registers, **options)
    base, beats = item.run.image.regions[region]
    where = (BEAT_BYTES * base, BEAT_BYTES * (base + beats))
    return replace(item, run=replace(item.run, speed=replace(item.run.speed, failing=where)))


def failing_table(case: Case, registers: dict[str, int], region: str = "frame") -> PlannedFrame:
    """A packed frame in which only the table of its blocks' entries answers with errors, which comes behind every block; in
    joint frames the table of the eye whose frame lies in this region."""
    item = planned(case, f"table of a packed {region} fails", error=ErrorCode.WRITE_ERROR, registers=registers, packed=True)
    image = item.run.image
    base, end = image.regions[region].base + table_beat(image.width, image.height), image.regions[region].end
    where = (BEAT_BYTES * base, BEAT_BYTES * end)
    return replace(item, run=replace(item.run, speed=replace(item.run.speed, failing=where)))


def problems(item: PlannedFrame, result: FrameResult) -> list[str]:
    """Descriptions of everything that is wrong with a result; empty when every bit and every counter is right."""
    found = list(result.errors)
    if item.run.cut is not None:
        return found
    if result.error is not item.error or result.done != (item.error is ErrorCode.NONE):
        return [*found, f"ended with {result.error.name}, done {result.done}, instead of {item.error.name}"]
    found += [f"register {name} must be {wanted:#x}, not {result.registers[name]:#x}"
              for name, wanted in item.registers.items() if result.registers[name] != wanted]
    if isinstance(result.pixels, PackedPixels) and item.run.poison and item.error is not ErrorCode.NONE:
        eyes = [eye for eye in (result.pixels, result.target) if isinstance(eye, PackedPixels)]
        found += ["the frame ended early, but all blocks are whole"] * (not any(eye.errors.any() for eye in eyes))
    if item.error is ErrorCode.NONE:
        wrong, counters = _compared(item, result)
        found += [_told(m) for m in wrong[:_SHOWN]]
        found += [f"and {len(wrong) - _SHOWN} more values"] * (len(wrong) > _SHOWN)
        found += counters
    return found


def _compared(item: PlannedFrame, result: FrameResult) -> tuple[list[dict[str, object]], list[str]]:
    """The values and the counters in which a frame that ended well differs from the golden one."""
    if item.stereo is not None:
        return stereo_mismatches(item.stereo, result), stereo_counter_errors(item.stereo, result)
    if item.warped is not None:
        return joint_warp_mismatches(item.warped, result), joint_warp_counter_errors(item.warped, result)
    if item.joint is not None:
        return joint_mismatches(item.joint, result), joint_counter_errors(item.joint, result)
    return mismatches(item.frame, result.pixels), counter_errors(item.frame, result)


def _told(wrong: dict[str, object]) -> str:
    eye = f"{wrong['eye']} eye, " if "eye" in wrong else ""
    return "{eye}tile {tile} pixel ({x}, {y}): {field} is {rtl}, golden {golden}".format(**{**wrong, "eye": eye})
