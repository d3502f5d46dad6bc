"""Plans of joint frames with a warped target (`spec.joint_warp`): frames of every kind among joint frames and frames of one
eye, and frames that end early."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from golden.msv2_ref.joint_warp import WarpedJointFrame, swept
from golden.scenes.model import GaussianModel
from spec.codes import ErrorCode
from spec.config import AcceleratorConfig
from spec.host_settings import settings
from spec.joint import SHIFT_MOST
from spec.memory import FIRST_PAGE_BEATS
from spec.registers import read_clients, write_clients
from spec.stereo import clear_cycles
from spec.supertiles import BUCKET_PAIRS
from tb.top.plan_joint import after, edge_cases, joint_case
from tb.top.plan_stereo import on_two_memories
from tb.top.planned import PlannedFrame, failing, planned
from tb.top.stimuli import Case, case, cloud, clusters, crowd
from tb.top.stimuli_stereo import aside, wall


def warped_case(
    config: AcceleratorConfig, name: str, model: GaussianModel, size: tuple[int, int], *, threshold_deg: float = 12.0,
    **options: Any,
) -> Case:
    """The golden frame of a model with a warped target; the options are those of `joint_case`."""
    return joint_case(config, name, model, size, threshold_deg=threshold_deg, **options)


def warped_cases(config: AcceleratorConfig, seed: int) -> list[Case]:
    """Small frames of every kind."""
    rng, levels = np.random.default_rng(seed), config.levels
    scene, plain, solid = cloud(rng, 250, levels=levels, sh=1), cloud(rng, 120, sh=3), wall(rng, 4, levels)
    spread = clusters(rng, 40, 70, levels)

    def make(name: str, model: GaussianModel = scene, size: tuple[int, int] = (90, 60), **options: object) -> Case:
        return warped_case(config, name, model, size, **options)

    return [
        make("gaze in the middle", solid, gaze=(45, 30)),
        make("gaze at the side, right eye first", gaze=(80, 20), source_eye="right", baseline=0.3),
        make("holes stay", gaze=(20, 40), second_sweep=False),
        make("all tiles known", gaze=(45, 30), threshold_deg=180.0),
        make("no tile known", gaze=(45, 30), threshold_deg=0.0),
        make("no tile known, holes stay, right eye first", solid, threshold_deg=0.0, second_sweep=False, source_eye="right"),
        *(make(f"shift {shift}", gaze=(20, 40), shift=shift, baseline=0.5) for shift in (-SHIFT_MOST, -3, 5, SHIFT_MOST)),
        make("clusters far apart, right eye first", spread, source_eye="right", baseline=6.0),
        make("a far side of a wide wall", wall(rng, 8, levels), (200, 100), gaze=(10, 10), baseline=0.2),
        make("shared colours", plain, baseline=2.0, shared_colour=True, threshold_deg=20.0),
        make("own colours", plain, baseline=2.0, threshold_deg=20.0),
        make("disparities beyond the frame", plain, (70, 40), baseline=30.0),
        make("seen by the target eye alone", aside(cloud(rng, 150), 100.0), (48, 33), baseline=100.0),
        *edge_cases(config, make, plain, rng),
    ]


def good_joint_warp_plan(config: AcceleratorConfig, seed: int) -> list[PlannedFrame]:
    """Every case as `on_two_memories` plays them; joint frames of which nothing is warped between them; then frames of several
    lists."""
    rng = np.random.default_rng(seed)
    plan = on_two_memories(config, warped_cases(config, seed), seed)
    scene = cloud(rng, 150, levels=config.levels, sh=1)
    whole = joint_case(config, "nothing warped", scene, (90, 60), gaze=(45, 30), baseline=0.3)
    for n in reversed(range(0, len(plan), 9)):
        plan.insert(n + 1, planned(whole, f"after: {plan[n].name}", reset=False, poison=False, display=n % 2 == 0))
    return plan + warped_bucket_plan(config)


def warped_bucket_plan(config: AcceleratorConfig) -> list[PlannedFrame]:
    """Frames of super-tiles with several lists, made by the frame before."""
    if not config.buckets:
        return []
    rng, stays = np.random.default_rng(3), {"reset": False, "poison": False}
    many = warped_case(config, "two bounds", crowd(rng, 2 * BUCKET_PAIRS + 700), (40, 16), beta=0, shift=1, threshold_deg=0.0)
    return [planned(many, "none before"), planned(warped_after(many, many), "its own bounds", "instant", **stays)]


def warped_after(this: Case, before: Case) -> Case:
    """A case with a warped target as the machine renders it with the bounds that another one leaves."""
    frame: WarpedJointFrame = this.frame
    both = (replace(case, frame=case.frame.joint) for case in (this, before))
    return replace(this, frame=replace(swept(after(*both).frame), threshold_deg=frame.threshold_deg))


def broken_joint_warp_plan(config: AcceleratorConfig, seed: int) -> list[PlannedFrame]:
    """Frames that end early, in both sweeps. Each is followed by a frame that must be correct, in turn of two eyes and of
    one."""
    rng = np.random.default_rng(seed)
    veil = cloud(rng, 120, levels=config.levels, sh=1)
    scene = warped_case(config, "warped", veil, (64, 48), gaze=(10, 10), baseline=0.2, shift=2)
    if not scene.frame.holes.any():
        raise ValueError(f"seed must be one whose scene has holes, not {seed!r}")
    single = case(config, "one eye", cloud(rng, 100, sh=1), (64, 48))
    plan: list[PlannedFrame] = []

    def add(frame: PlannedFrame, reset: bool = False) -> None:
        plan.extend([frame, planned((scene, single)[len(plan) // 2 % 2], f"after: {frame.name}", reset=reset)])

    joint = scene.frame.joint
    least = config.point_interval * (2 * joint.counts["points"] + len(joint.pairs.splat))  # no frame takes fewer
    begun = clear_cycles(config)
    for late, cycles in ((False, 1), (False, 250), (False, begun + least // 2), (False, least - 1), (True, 1), (True, 300)):
        when = f"after {cycles} cycles{' of the second sweep' * late}"
        add(planned(scene, f"reset {when}", cut=cycles, late=late), reset=True)
        add(planned(scene, f"abort {when}", error=ErrorCode.ABORTED, abort=cycles, late=late))
    readers, writers = read_clients(config), write_clients(config)
    for region, client in (("target_tiles", "tiles"), ("supertiles", "tiles"), ("colour", "colour")):
        add(failing(scene, region, ErrorCode.READ_ERROR, {"error_clients": 1 << readers.index(client)}))
    add(failing(scene, "frame", ErrorCode.WRITE_ERROR, {"error_clients": 1 << 16 + writers.index("frame")}))
    unknown = warped_case(config, "no tile known", wall(rng, 2, config.levels), (64, 48), threshold_deg=0.0)
    add(failing(unknown, "target_frame", ErrorCode.WRITE_ERROR, {"error_clients": 1 << 16 + writers.index("warp")}))
    hidden = warped_case(config, "seen by the target eye alone", aside(crowd(rng, 2 * config.sort_chunk + 5), 100.0), (16, 16),
                         baseline=100.0, beta=0)
    add(planned(hidden, "no room for second pages", error=ErrorCode.ENTRIES_FULL, changes={"entries_beats": FIRST_PAGE_BEATS}))
    add(planned(hidden, "no room for runs", error=ErrorCode.SPILL_FULL, changes={"spill_beats": 2}))
    numbers = {setting.name: setting.number for setting in settings(config)}
    for name, value in (("display", 0), ("joint", 0), ("shift", SHIFT_MOST + 1)):
        registers = {"bad_setting": numbers[name], "cycles_render": 0}
        add(planned(scene, f"{name} = {value}", error=ErrorCode.BAD_SETTING, registers=registers, changes={name: value}))
    return plan
