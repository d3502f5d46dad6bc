"""Plans of frames of two eyes: frames of every kind, and every way in which one of the two passes ends early."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from spec.codes import ErrorCode
from spec.config import AcceleratorConfig
from spec.host_settings import settings
from spec.memory import FIRST_PAGE_BEATS
from spec.registers import CHUNK_READ_CLIENTS, read_clients, write_clients
from spec.stereo import clear_cycles
from tb.frame.bound import array_ops
from tb.top.planned import SPEEDS, PlannedFrame, failing, pixels_of, planned
from tb.top.stimuli import Case, case, cloud, crowd
from tb.top.stimuli_stereo import aside, stereo_case, stereo_cases, wall


def good_stereo_plan(config: AcceleratorConfig, seed: int) -> list[PlannedFrame]:
    """Every case of two eyes, as `on_two_memories` plays them; all have display pixels."""
    return on_two_memories(config, stereo_cases(config, seed), seed)


def on_two_memories(
    config: AcceleratorConfig, cases: Sequence[Case], seed: int, *, alternate: bool = False,
) -> list[PlannedFrame]:
    """Every case on two memories, the second time without a reset and without clearing the memory of the previous frame.

    Every third frame is followed, without a reset, by one of one eye, in the one or the other pixel format.

    Args:
        config: the machine. cases: frames of two eyes. seed: of the frame of one eye.
        alternate: whether frames of two eyes have the formats of `pixels_of` in turn; otherwise all are as `planned` makes
            them.
    """
    rng, names = np.random.default_rng(seed), list(SPEEDS)
    single = case(config, "one eye", cloud(rng, 120, levels=config.levels, sh=1), (64, 48), gaze=(20, 20))
    plan: list[PlannedFrame] = []
    for second in (False, True):
        for n, item in enumerate(cases):
            speed, pixels = names[1 + n % 4] if second else "usual", pixels_of(config, n + second) if alternate else {}
            plan.append(planned(item, f"{speed} memory{', back to back' * second}", speed, reset=not second, poison=not second,
                                **pixels))
            if n % 3 == 0:
                plan.append(planned(single, f"after: {plan[-1].name}", reset=False, poison=False,
                                    **pixels_of(config, n // 3 + 1)))
    return plan


def broken_stereo_plan(config: AcceleratorConfig, seed: int) -> list[PlannedFrame]:
    """Frames with a pass that ends early. Each is followed by a frame that must be correct, in turn of two eyes and of one."""
    rng = np.random.default_rng(seed)
    scene = stereo_case(config, "two eyes", wall(rng, 2, config.levels), (64, 48), threshold_deg=180)
    mixed = stereo_case(config, "warped in part", wall(rng, 2, config.levels), (48, 33), gaze=(10, 10), baseline=0.2)
    single = case(config, "one eye", cloud(rng, 100, sh=1), (64, 48))
    chunk = config.sort_chunk
    hidden = stereo_case(config, "seen by the target eye alone", aside(crowd(rng, 2 * chunk + 5), 100.0), (16, 16),
                         baseline=100.0, threshold_deg=180, beta=0)
    plan: list[PlannedFrame] = []

    def add(frame: PlannedFrame, reset: bool = False) -> None:
        plan.extend([frame, planned((mixed, single)[len(plan) // 2 % 2], f"after: {frame.name}", reset=reset)])

    cleared = clear_cycles(config)  # the warp unit clears its ring buffer after a reset
    for late, frame in ((False, scene.frame.source), (True, scene.frame.target)):
        least, begun = array_ops(frame), 0 if late else cleared  # no pass takes fewer cycles
        for cycles in (1, 250, begun + least // 2, begun + 7 * least // 8):
            when = f"after {cycles} cycles{' of the target eye' * late}"
            add(planned(scene, f"reset {when}", cut=cycles, late=late), reset=True)
            add(planned(scene, f"abort {when}", error=ErrorCode.ABORTED, abort=cycles, late=late))
    reading = [("tiles", "tiles"), ("target_tiles", "tiles"), ("geometry", "geometry")]
    for region, client in (*reading, *((name, name) for name in CHUNK_READ_CLIENTS if config.chunks)):
        clients = {"error_clients": 1 << read_clients(config).index(client)}
        add(failing(scene, region, ErrorCode.READ_ERROR, clients))
    for region, client in (("frame", "frame"), ("target_frame", "warp"), ("views", "views")):
        clients = {"error_clients": 1 << 16 + write_clients(config).index(client)}
        add(failing(mixed, region, ErrorCode.WRITE_ERROR, clients))
    numbers = {setting.name: setting.number for setting in settings(config)}
    for name, value in (("display", 0), ("width", 0)):
        registers = {"bad_setting": numbers[name], "cycles_render": 0}
        add(planned(scene, f"{name} = {value}", error=ErrorCode.BAD_SETTING, registers=registers, changes={name: value}))
    add(planned(hidden, "no room for second pages", error=ErrorCode.ENTRIES_FULL, changes={"entries_beats": FIRST_PAGE_BEATS}))
    add(planned(hidden, "no room for runs", error=ErrorCode.SPILL_FULL, changes={"spill_beats": 2}))
    add(planned(hidden, "room for all"))
    return plan
