"""Plans of joint frames of two eyes (`spec.joint`): frames of every kind among frames of one eye, and frames that end early."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from golden.msv2_ref.batches import following
from golden.msv2_ref.buckets import next_bounds, no_bounds
from golden.msv2_ref.joint import JointFrame, render_joint
from golden.msv2_ref.joint_warp import render_warped_joint
from golden.msv2_ref.supertiles import list_counts, merge_lists
from golden.scenes.gaze import Display, foveation_map
from golden.scenes.model import GaussianModel
from golden.scenes.stereo import stereo_pair
from spec.codes import ErrorCode
from spec.config import AcceleratorConfig
from spec.host_settings import settings
from spec.joint import SHIFT_MOST
from spec.memory import FIRST_PAGE_BEATS
from spec.registers import read_clients, write_clients
from spec.supertiles import BUCKET_PAIRS
from tb.top.plan_stereo import on_two_memories
from tb.top.planned import PlannedFrame, failing, failing_table, planned
from tb.top.stimuli import Case, camera_of, case, cloud, clusters, crowd
from tb.top.stimuli_stereo import aside, wall


def joint_case(
    config: AcceleratorConfig, name: str, model: GaussianModel, size: tuple[int, int], *, baseline: float = 0.1,
    source_eye: str = "left", gaze: tuple[float, float] | None = None, beta: int | None = None, obb: bool = False,
    shift: int | None = None, shared_colour: bool = False, threshold_deg: float | None = None, second_sweep: bool = True,
) -> Case:
    """The golden frame of a model. A `gaze` in pixels turns foveation on in both eyes; `baseline` is in world units. Without a
    `threshold_deg` nothing is warped; with it, `second_sweep` says whether tiles with holes are rendered."""
    foveation = None if gaze is None else foveation_map(Display(*size), gaze, model.levels)
    pair = stereo_pair(camera_of(*size), ipd_metres=baseline, source_eye=source_eye)
    how = {"config": config, "foveation": foveation, "background": (0.2, 0.5, 1.0), "beta": beta, "obb": obb, "shift": shift,
           "shared_colour": shared_colour}
    frame = render_joint(model, pair, **how) if threshold_deg is None else render_warped_joint(
        model, pair, **how, threshold_deg=threshold_deg, second_sweep=second_sweep)
    return Case(name, frame, beta, obb)


def joint_cases(config: AcceleratorConfig, seed: int) -> list[Case]:
    """Small frames of two eyes, of every kind."""
    rng, levels = np.random.default_rng(seed), config.levels
    scene, plain, solid = cloud(rng, 250, levels=levels, sh=1), cloud(rng, 120, sh=3), wall(rng, 4, levels)
    spread = clusters(rng, 40, 70, levels)

    def make(name: str, model: GaussianModel = scene, size: tuple[int, int] = (90, 60), **options: object) -> Case:
        return joint_case(config, name, model, size, **options)

    near = replace(scene, means=np.where(np.arange(len(scene))[:, None] % 5 == 0, camera_of(16, 16).position + rng.normal(
        0, 0.3, (len(scene), 3)), scene.means))
    return [
        make("gaze in the middle", solid, gaze=(45, 30)),
        make("gaze at the side, right eye first", gaze=(80, 20), source_eye="right", baseline=0.3),
        *(make(f"shift {shift}", gaze=(20, 40), shift=shift, baseline=0.5)
          for shift in (-SHIFT_MOST, -3, -1, 1, 5, SHIFT_MOST)),
        make("clusters", spread, gaze=(45, 30), baseline=0.6),
        make("clusters far apart, right eye first", spread, source_eye="right", baseline=6.0),
        make("shared colours", plain, baseline=2.0, shared_colour=True),
        make("own colours", plain, baseline=2.0),
        make("disparities beyond the frame", plain, (70, 40), baseline=30.0),
        make("seen by the target eye alone", aside(cloud(rng, 150), 100.0), (48, 33), baseline=100.0),
        make("around both cameras", near, baseline=0.8),
        *edge_cases(config, make, plain, rng),
    ]


def edge_cases(
    config: AcceleratorConfig, make: Callable[..., Case], plain: GaussianModel, rng: np.random.Generator,
) -> list[Case]:
    """Frames of unusual sizes and settings; `make` makes a frame of two eyes of a name and, where they matter, of a model and a
    size."""
    return [
        make("bounding boxes", obb=True, baseline=0.4),
        make("beta 0", beta=0), make("beta 60", beta=60),
        make("no Gaussians", cloud(rng, 0), (40, 20)),
        make("one pixel", plain, (1, 1), shift=2),
        make("odd size", plain, (17, 19), shift=-5),
        make("widest row", cloud(rng, 80), (config.row_width, 20), shift=7),
        make("one column", plain, (3, 70)),
        make("groups that spill", crowd(rng, 3 * config.sort_chunk), (48, 32)),
    ]


def good_joint_plan(config: AcceleratorConfig, seed: int) -> list[PlannedFrame]:
    """Every joint case, as `on_two_memories` plays them, in every format of pixels; then frames of several lists."""
    return on_two_memories(config, joint_cases(config, seed), seed, alternate=True) + joint_bucket_plan(config)


def after(this: Case, before: Case) -> Case:
    """A case of one eye or of two as the machine renders it with the bounds that another one leaves."""
    frame, pairs = this.frame, before.frame.pairs
    if not isinstance(frame, JointFrame):
        return replace(this, frame=following(frame, before.frame, this.beta))
    bounds, count = next_bounds(frame.config, pairs.start, pairs.depth_key), len(frame.pairs.start) - 1
    if bounds.supertiles != count:
        bounds = no_bounds(count)
    groups = merge_lists(frame.config, list_counts(frame.pairs, bounds), this.beta)
    return replace(this, frame=replace(frame, eyes=tuple(replace(eye, bounds=bounds, groups=groups) for eye in frame.eyes)))


def joint_bucket_plan(config: AcceleratorConfig) -> list[PlannedFrame]:
    """Frames of super-tiles with several lists, made by the frame before."""
    if not config.buckets:
        return []
    rng, stays = np.random.default_rng(3), {"reset": False, "poison": False}
    model = crowd(rng, 2 * BUCKET_PAIRS + 700)
    many = joint_case(config, "two bounds", model, (16, 16), beta=0, shift=1)
    return [planned(many, "none before"), planned(after(many, many), "its own bounds", "instant", **stays)]


def broken_joint_plan(config: AcceleratorConfig, seed: int) -> list[PlannedFrame]:
    """Frames that end early. Each is followed by a frame that must be correct, in turn of two eyes and of one. Where the
    machine packs frames, they are packed."""
    rng = np.random.default_rng(seed)
    scene = joint_case(config, "two eyes", wall(rng, 2, config.levels), (64, 48), shift=2)
    single = case(config, "one eye", cloud(rng, 100, sh=1), (64, 48))
    hidden = joint_case(config, "seen by the target eye alone", aside(crowd(rng, 2 * config.sort_chunk + 5), 100.0), (16, 16),
                        baseline=100.0, beta=0)
    plan: list[PlannedFrame] = []
    how = {"packed": True} if config.packed else {}

    def add(frame: PlannedFrame, reset: bool = False) -> None:
        plan.extend([frame, planned((scene, single)[len(plan) // 2 % 2], f"after: {frame.name}", reset=reset, **how)])

    least = 2 * config.point_interval * (scene.frame.counts["points"] + len(scene.frame.pairs.splat))  # no frame takes fewer
    for cycles in (1, 40, 250, least // 3, 2 * least // 3, least - 1):
        add(planned(scene, f"reset after {cycles} cycles", cut=cycles, **how), reset=True)
        add(planned(scene, f"abort after {cycles} cycles", error=ErrorCode.ABORTED, abort=cycles, **how))
    readers, writers = read_clients(config), write_clients(config)
    for region, client in (("tiles", "tiles"), ("target_tiles", "tiles"), ("supertiles", "tiles"), ("geometry", "geometry"),
                           ("chunks", "chunks"), ("colour", "colour")):
        add(failing(scene, region, ErrorCode.READ_ERROR, {"error_clients": 1 << readers.index(client)}, **how))
    for region in ("entries", "frame", "target_frame"):
        client = "frame" if "frame" in region else region
        add(failing(scene, region, ErrorCode.WRITE_ERROR, {"error_clients": 1 << 16 + writers.index(client)}, **how))
    for region in ("frame", "target_frame") if config.packed else ():
        add(failing_table(scene, {"error_clients": 1 << 16 + writers.index("frame")}, region))
    numbers = {setting.name: setting.number for setting in settings(config)}
    for value in (SHIFT_MOST + 1, -SHIFT_MOST - 1):
        registers = {"bad_setting": numbers["shift"], "cycles_render": 0}
        add(planned(scene, f"shift = {value}", error=ErrorCode.BAD_SETTING, registers=registers, changes={"shift": value}))
    add(planned(hidden, "no room for second pages", error=ErrorCode.ENTRIES_FULL, changes={"entries_beats": FIRST_PAGE_BEATS}))
    add(planned(hidden, "no room for runs", error=ErrorCode.SPILL_FULL, changes={"spill_beats": 2}))
    add(planned(hidden, "room for all"))
    return plan
