"""Draws frames for the soak: any model, size, gaze, pair of eyes and memory; and frames that fail or are ended early."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from golden.msv2_ref.joint import JointFrame
from golden.msv2_ref.pipeline import Frame, render
from golden.scenes.gaze import Display, foveation_map
from golden.scenes.model import SH_REST_COUNT, GaussianModel
from golden.scenes.stereo import EYES
from spec.codes import ErrorCode
from spec.config import AcceleratorConfig
from spec.host_settings import settings
from spec.joint import SHIFT_MOST
from spec.registers import read_clients, write_clients
from tb.frame.bound import array_ops, least_cycles
from tb.top import plan_buckets, plan_joint
from tb.top.memory import MemorySpeed
from tb.top.plan_joint import joint_case
from tb.top.planned import PlannedFrame, failing, planned
from tb.top.stimuli import Case, camera_of, cloud, clusters, crowd
from tb.top.stimuli_stereo import stereo_case, wall

ONE, JOINT, WARPED = "one eye", "joint", "warped"
"""Kinds of frames."""

GOOD, ABORT, RESET, BUS, SETTING = "good", "abort", "reset", "bus error", "bad setting"
FATES = {GOOD: 0.72, ABORT: 0.1, RESET: 0.05, BUS: 0.08, SETTING: 0.05}
"""How often a frame ends in which way."""

_READERS = {"geometry": "geometry", "tiles": "tiles", "chunks": "chunks", "supertiles": "tiles"}
"""Regions of which every frame reads, and the memory client that does."""


@dataclass(frozen=True)
class Drawn:
    """A frame to play.

    Attributes:
        model: the model. size: width and height in pixels. kind: one of ONE, JOINT, WARPED.
        view: arguments of the function that renders this kind: gaze, beta and so on.
        pixels: the format of the pixels, as arguments of `planned`.
        speed: the memory. fate: one of FATES. where: in 0..1, at which cycle, region or setting the fate strikes.
    """

    model: GaussianModel
    size: tuple[int, int]
    kind: str
    view: dict[str, Any]
    pixels: dict[str, bool]
    speed: MemorySpeed
    fate: str = GOOD
    where: float = 0.0
    name: str = field(default="frame", compare=False)

    def case(self, config: AcceleratorConfig) -> Case:
        """The golden frame."""
        if self.kind == JOINT:
            return joint_case(config, self.name, self.model, self.size, **self.view)
        if self.kind == WARPED:
            return stereo_case(config, self.name, self.model, self.size, **self.view)
        view = dict(self.view)
        gaze = view.pop("gaze")
        foveation = None if gaze is None else foveation_map(Display(*self.size), gaze, self.model.levels)
        frame = render(self.model, camera_of(*self.size), config=config, foveation=foveation, **view)
        return Case(self.name, frame, self.view["beta"], self.view["obb"])


def draw(config: AcceleratorConfig, rng: np.random.Generator, name: str) -> Drawn:
    """One frame of any kind that the machine has."""
    kind = rng.choice([ONE, *[JOINT] * config.joint, *[WARPED] * config.stereo])
    size = _size(config, rng)
    view: dict[str, Any] = {
        "gaze": tuple(rng.uniform(0, size)) if config.levels > 1 and rng.random() < 0.5 else None,
        "beta": [None, None, 0, 1, int(rng.integers(2, 200)), 100_000][rng.integers(6)], "obb": bool(rng.random() < 0.1)}
    if kind == ONE:
        view["background"] = tuple(rng.uniform(0, 1, 3))
    else:
        view |= {"baseline": float(np.exp(rng.uniform(np.log(0.01), np.log(30)))), "source_eye": str(rng.choice(EYES))}
    if kind == JOINT:
        view |= {"shift": None if rng.random() < 0.5 else int(rng.integers(-SHIFT_MOST, SHIFT_MOST + 1)),
                 "shared_colour": bool(rng.random() < 0.3)}
    if kind == WARPED:
        view["threshold_deg"] = float(rng.choice([0, 10, 30, 180]))
    fate = str(rng.choice(list(FATES), p=list(FATES.values())))
    return Drawn(_model(config, rng), size, str(kind), view, _pixels(config, rng, kind), _speed(rng), fate, float(rng.random()),
                 name)


def _size(config: AcceleratorConfig, rng: np.random.Generator) -> tuple[int, int]:
    if rng.random() < 0.05:
        return config.row_width, int(rng.integers(1, 20))
    return int(rng.integers(1, 97)), int(rng.integers(1, 65))


def _model(config: AcceleratorConfig, rng: np.random.Generator) -> GaussianModel:
    levels = int(rng.integers(1, config.levels + 1))
    sh = int(rng.integers(0, min(config.sh_degree, max(SH_REST_COUNT)) + 1))
    makers: list[Callable[[], GaussianModel]] = [
        lambda: cloud(rng, int(rng.integers(0, 400)), levels=levels, sh=sh),
        lambda: cloud(rng, int(rng.integers(1, 150)), levels=levels, sh=sh, wild=True),
        lambda: clusters(rng, int(rng.integers(1, 30)), int(rng.integers(1, 80)), levels),
        lambda: wall(rng, int(rng.integers(0, 30)), levels),
        lambda: crowd(rng, int(rng.integers(1, 3 * config.sort_chunk)))]
    return makers[rng.choice(len(makers), p=(0.35, 0.15, 0.2, 0.15, 0.15))]()


def _pixels(config: AcceleratorConfig, rng: np.random.Generator, kind: str) -> dict[str, bool]:
    if kind == WARPED:
        return {}
    packed = config.packed and (kind == ONE or not config.joint) and bool(rng.random() < 0.5)
    return {"packed": True} if packed else {"display": bool(rng.random() < 0.5)}


def _speed(rng: np.random.Generator) -> MemorySpeed:
    rate = None if rng.random() < 0.4 else round(float(np.exp(rng.uniform(np.log(3), np.log(60)))), 1)
    return MemorySpeed(int(np.exp(rng.uniform(0, np.log(400)))), rate, int(rng.integers(0, 150)) if rng.random() < 0.3 else 0)


def plan(config: AcceleratorConfig, frames: Sequence[Drawn]) -> list[PlannedFrame]:
    """The frames in this order in one simulation, the first one after a reset. With depth buckets, each frame has the bounds
    that the one before it left."""
    found: list[PlannedFrame] = []
    before: Case | None = None
    for number, drawn in enumerate(frames):
        case = drawn.case(config)
        if before is not None and config.supertiles and config.buckets:
            after = plan_joint.after if isinstance(case.frame, JointFrame) else plan_buckets.after
            case = after(case, before)
        again = number == 0 or frames[number - 1].fate == RESET
        item = _fated(config, drawn, case, {"reset": again, "poison": number == 0, **drawn.pixels})
        speed = replace(drawn.speed, failing=item.run.speed.failing)
        found.append(replace(item, run=replace(item.run, speed=speed)))
        before = case if drawn.fate == GOOD else None
    return found


def _fated(config: AcceleratorConfig, drawn: Drawn, case: Case, options: dict[str, Any]) -> PlannedFrame:
    """The case with its fate."""
    if drawn.fate in (ABORT, RESET):
        cycle = 1 + int(drawn.where * _least(case))
        if drawn.fate == RESET:
            return planned(case, f"reset after {cycle} cycles", cut=cycle, **options)
        return planned(case, f"abort after {cycle} cycles", error=ErrorCode.ABORTED, abort=cycle, **options)
    if drawn.fate == BUS:
        regions = _regions(config, case)
        region, code, clients = regions[int(drawn.where * len(regions))]
        return failing(case, region, code, {"error_clients": clients}, **options)
    if drawn.fate == SETTING:
        numbers = {setting.name: setting.number for setting in settings(config)}
        bad = [(name, value) for name, value in (("near", 0), ("width", 0), ("height", 1 << 13), ("depth_scale", 1 << 27))
               if name in numbers]
        name, value = bad[int(drawn.where * len(bad))]
        return planned(case, f"{name} = {value}", error=ErrorCode.BAD_SETTING, registers={"bad_setting": numbers[name]},
                       changes={name: value}, **options)
    return planned(case, **options)


def _least(case: Case) -> int:
    """A number of cycles below those of the frame."""
    if isinstance(case.frame, Frame):
        return max(least_cycles(case.frame) - 1, 1)
    if isinstance(case.frame, JointFrame):
        points = case.frame.counts["points"] + len(case.frame.pairs.splat)
        return max(2 * case.frame.config.point_interval * points - 1, 1)
    return max(array_ops(case.frame.source) - 1, 1)


def _regions(config: AcceleratorConfig, case: Case) -> list[tuple[str, ErrorCode, int]]:
    """Regions of which the frame certainly reads or writes a beat: name, error, and bit of the client."""
    readers, writers = read_clients(config), write_clients(config)
    image = planned(case).run.image
    reads = [(name, ErrorCode.READ_ERROR, 1 << readers.index(client)) for name, client in _READERS.items()
             if name in image.regions and image.regions[name].beats and client in readers]
    first = reads if not config.chunks else [item for item in reads if item[0] != "geometry"]  # its chunks may all be skipped
    return [*first, ("frame", ErrorCode.WRITE_ERROR, 1 << 16 + writers.index("frame"))]
