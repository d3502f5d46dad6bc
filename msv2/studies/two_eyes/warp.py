"""`msv2 study run two_eyes_warp`: what warping the second eye gives on top of joint frames, what the second sweep over the
lists costs, and what the warped eye loses against the oracle: two_eyes_warp.{json,md}.

examples:
  msv2 study run two_eyes_warp                              all frames
  msv2 study run two_eyes_warp embedded --size 320x180      one frame
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache

import numpy as np

from golden.metrics.image import psnr_vs
from golden.msv2_ref.frame_memory import display_pixels
from golden.msv2_ref.joint import SOURCE, TARGET, render_joint_frame
from golden.msv2_ref.joint_warp import WarpedJointFrame, render_warped_joint, swept
from golden.oracle.render import render as render_oracle
from golden.scenes.load import EMBEDDED
from golden.scenes.request import make_folder
from msv2.studies.memory import MEMORY_NAMES, memory_arguments
from msv2.studies.page import write_page
from msv2.studies.performance.frames import scene_file
from msv2.studies.progress import Progress
from msv2.studies.record import write_report
from msv2.studies.two_eyes.measure import eyes_of, on_machine
from msv2.studies.two_eyes.warp_page import ALL_HOLES, JOINT, NO_SWEEP, WARPED, page, summary
from msv2.studies.v3 import frames
from msv2.studies.v3.frames import Subject, moved, total_bytes
from perf.joint_trace import joint_trace
from perf.model import MemoryModel
from perf.supertiles import simulate_supertiles
from perf.supertiles_trace import SuperTrace
from perf.warp_trace import WarpedTrace, warped_trace
from spec.config import V3_EYES_WARP, AcceleratorConfig
from spec.constants import ECC_THRESHOLD_DEG

MACHINES = {V3_EYES_WARP.name: V3_EYES_WARP, "four arrays": V3_EYES_WARP.with_(streams=4)}
"""The machines by name."""

THRESHOLDS = {WARPED: (ECC_THRESHOLD_DEG, True), NO_SWEEP: (ECC_THRESHOLD_DEG, False), ALL_HOLES: (0.0, True)}
"""Kinds of frames with a warped eye: the threshold in degrees, and whether there is a second sweep."""


@lru_cache(maxsize=3)
def rendered(subject: Subject, kind: str) -> WarpedJointFrame:
    """The frame of a subject with a warped eye."""
    asked, pair, _ = eyes_of(subject)
    threshold, second = THRESHOLDS[kind]
    words = asked.model if kind == WARPED else rendered(subject, WARPED).source.words
    return render_warped_joint(words, pair, config=V3_EYES_WARP, foveation=asked.foveation, background=asked.background,
                               threshold_deg=threshold, second_sweep=second)


def traces(subject: Subject, config: AcceleratorConfig) -> dict[str, SuperTrace | WarpedTrace]:
    """The trace of the joint frame and those of the frames with a warped eye."""
    joint, out = None, {}
    for kind in THRESHOLDS:
        frame = rendered(subject, kind)
        drawn = swept(on_machine(frame.joint, config))
        joint = joint or joint_trace(replace(drawn.joint, registers=replace(drawn.registers, warping=None)))
        out[kind] = warped_trace(drawn, joint)
    return {JOINT: joint, **out}


def cycle_rows(subject: Subject, machine: str, config: AcceleratorConfig) -> list[dict[str, object]]:
    """The numbers of a subject's frames on a machine, with every memory, JSON-ready."""
    out = []
    for kind, trace in traces(subject, config).items():
        for memory in MEMORY_NAMES:
            found = simulate_supertiles(trace, config, display=True, memory=MemoryModel(**memory_arguments(memory)))
            out.append({
                "frame": subject.name, "scene": subject.scene, "size": subject.size, "kind": kind, "machine": machine,
                "memory": memory, "cycles": found.total, "phases": found.phases, "sweep_cycles": found.sweep_cycles,
                "bytes": moved(found), "total_bytes": total_bytes(found), "pairs": found.pairs, "pairs_again": found.again,
                "entries": found.entries, "ops": found.ops, "batches": found.batches, "visits": found.visits})
    return out


def tile_row(subject: Subject, kind: str) -> dict[str, object]:
    """Which of the target's tiles are rendered, and which pairs the lists have for warped tiles alone."""
    frame = rendered(subject, kind)
    pairs, tiles = frame.joint.pairs, frame.joint.grids[TARGET].tile
    known = (frame.known[tiles] & (tiles >= 0)) @ (1 << np.arange(tiles.shape[1]))
    warped_only = (pairs.mask[:, SOURCE] == 0) & (pairs.mask[:, TARGET] & known[pairs.supertile] == 0)
    return {"frame": subject.name, "kind": kind, **frame.shares, "super_tiles_again": float(
        np.isin(np.arange(len(tiles)), frame.joint.grids[TARGET].supertile[frame.holes]).mean()),
            "warped_only": float(warped_only.mean()), "pairs_again": frame.again / max(1, len(pairs.splat))}


def quality_row(subject: Subject) -> dict[str, object]:
    """The target's PSNR in dB against the oracle, of the joint frame and of frames with a warped eye, all of 8 bits a
    channel."""
    asked, pair, scale = eyes_of(subject)
    frame = rendered(subject, WARPED)
    oracle = render_oracle(asked.model, pair.target, foveation=frame.joint.foveations[TARGET], background=asked.background,
                           support_sigma=V3_EYES_WARP.support_sigma, weights="plane").image
    joint = render_joint_frame(V3_EYES_WARP, frame.source.words, replace(frame.registers, warping=None))
    pictures = {JOINT: display_pixels(joint.target), **{kind: rendered(subject, kind).target_pixels for kind in THRESHOLDS}}
    return {"frame": subject.name, **scale,
            **{f"{kind}_db": psnr_vs(pixels["colour"] / 255.0, oracle) for kind, pixels in pictures.items()}}


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line.

    Raises:
        InputError: a scene that the command line names is missing.
    """
    args = frames.frame_arguments("two_eyes_warp", __doc__, argv)
    out, (todo, missing) = make_folder(args.out), frames.chosen(args)
    rows, tiles, quality = [], [], []
    progress = Progress("two_eyes_warp", [subject.name for subject in todo])
    for subject in todo:
        with progress.step(subject.name):
            for machine, config in MACHINES.items():
                rows += cycle_rows(subject, machine, config)
            tiles += [tile_row(subject, kind) for kind in THRESHOLDS]
            if subject.size == todo[0].size:
                quality.append(quality_row(subject))
    content = {"missing": missing, "summary": summary(rows), "tiles": tiles, "quality": quality, "frames": rows}
    scenes = [scene_file(scene) for scene in args.scene or frames.SCENES if scene != EMBEDDED]
    write_report(out / "two_eyes_warp.json", content, [__name__], {"arguments": args, "machines": MACHINES},
                 [*filter(None, scenes)])
    write_page(out / "two_eyes_warp.md", page(content))
    for name, gains in content["summary"].items():
        print(f"{name}: " + ", ".join(f"{kind} {gain:.3f}" for kind, gain in gains.items() if gain is not None))
    return 0
