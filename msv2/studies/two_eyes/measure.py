"""Joint frames: their cycles on `v3` beside those of one eye, and their pixels beside those of each eye alone and of the
oracle."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np

from golden.host.quantise import GaussianWords, quantise_model
from golden.metrics.image import psnr_vs
from golden.msv2_ref import projection, tile_test
from golden.msv2_ref.joint import SOURCE, TARGET, JointFrame, find_joint_pairs, joint_grids, render_joint, render_joint_frame
from golden.msv2_ref.pipeline import render_frame
from golden.msv2_ref.regions import region_masks
from golden.msv2_ref.supertiles import find_pairs
from golden.oracle.render import render as render_oracle
from golden.scenes.request import ORBIT, Request, resolve
from golden.scenes.stereo import StereoPair, stereo_pair
from msv2.studies.memory import memory_arguments
from msv2.studies.performance.frames import SECOND_VIEW, request
from msv2.studies.threshold.scales import table_scale
from msv2.studies.v3.frames import CACHE, Subject, moved, total_bytes
from msv2.studies.v3.frames import traced as trace_of_paper
from perf.joint_trace import joint_trace
from perf.model import MemoryModel, simulate
from perf.supertiles import simulate_supertiles
from perf.supertiles_trace import VERSION, SuperTrace, load_trace, save_trace, super_trace
from perf.trace import trace_key
from spec.config import PAPER, V3, V3_EYES, V3_EYES_LARGE, V3_EYES_STREAMS, AcceleratorConfig
from spec.sources import fingerprint, sources_of

ARRAYS = f"{V3_EYES_STREAMS.name}, not packed"

MACHINES = {V3_EYES.name: V3_EYES, ARRAYS: V3_EYES_STREAMS.with_(packed=False), V3_EYES_STREAMS.name: V3_EYES_STREAMS,
            V3_EYES_LARGE.name: V3_EYES_LARGE}
"""The machines by name: one array, and display pixels; four arrays of a quarter of its cores each; packed frames besides; and
twice the places in a batch besides, because places of two eyes fill it twice as fast. A frame of one eye is measured on the
same machine."""

CAMERAS = (ORBIT, SECOND_VIEW)
"""The cameras from which pixels are measured. The orbit's first one looks along an axis of the captured scenes, so that the
distance between its eyes does not enter z, and both eyes have equal keys; the other one looks askew."""

ONE, TWO, SHARED = "one eye", "two eyes", "two eyes, shared colours"
"""Kinds of frames."""


def eyes_of(subject: Subject, camera: str = ORBIT) -> tuple[Request, StereoPair, dict[str, object]]:
    """The request of a frame, its cameras, and the scale that they have.

    Raises:
        InputError: the scene is missing.
    """
    asked, scale = resolve(request(subject.scene, subject.size, camera)), table_scale(subject.scene, None)
    return asked, stereo_pair(asked.camera, units_per_metre=scale["units_per_metre"]), scale


@lru_cache(maxsize=1)
def _words(scene: str) -> GaussianWords:
    return quantise_model(V3, resolve(request(scene, "640x360")).model)


@lru_cache(maxsize=1)
def rendered(subject: Subject, camera: str = ORBIT, config: AcceleratorConfig = V3) -> JointFrame:
    """The joint frame of a subject."""
    asked, pair, _ = eyes_of(subject, camera)
    return render_joint(_words(subject.scene), pair, config=config, foveation=asked.foveation, background=asked.background)


def on_machine(frame: JointFrame, config: AcceleratorConfig) -> JointFrame:
    """The frame as a machine of as many streams renders it: the pixels are the same."""
    eyes = []
    if config.streams == 1:
        return frame
    for eye in frame.eyes:
        tested = tile_test.tested_opacity(config, eye.words.geometry["log2_opacity"], eye.words.decoded.opacity)
        regions = region_masks(config, eye.projected, tested, eye.registers, eye.entries)
        eyes.append(replace(eye, config=config, regions=regions))
    return replace(frame, eyes=tuple(eyes))


def _one_eye(frame: JointFrame, joint: SuperTrace) -> SuperTrace:
    """The trace of the source's frame as a frame of one eye, whose pixels are those of the joint frame."""
    source = frame.source
    projected = projection.project(source.config, source.words, source.registers)
    pairs = find_pairs(source.registers, source.words.chunks, projected.depth_key, source.entries)
    return super_trace(replace(source, projected=projected, pairs=pairs), stop=joint.stop[:, : joint.eye_tiles])


def traces(subject: Subject, config: AcceleratorConfig) -> tuple[SuperTrace, SuperTrace]:
    """The traces of one eye and of both, from the cache if none of its inputs has changed."""
    one_array = V3.with_(row_width=config.row_width, list_heads=config.list_heads)
    config = one_array.with_(streams=config.streams)
    made = trace_key(request(subject.scene, subject.size), config)
    key = fingerprint(sources_of("perf.joint_trace"), VERSION, made, config.streams, config.row_width,
                      table_scale(subject.scene, None))
    kept = [CACHE / f"{key}-{eyes}.npz" for eyes in (1, 2)]
    found = [load_trace(path) if path.is_file() else None for path in kept]
    if None in found:
        frame = on_machine(rendered(subject, config=one_array), config)
        both = joint_trace(frame)
        found = [_one_eye(frame, both), both]
        for trace, path in zip(found, kept, strict=True):
            save_trace(trace, path)
    return found[0], found[1]


def cycle_rows(
    subject: Subject, machine: str, memory: str, config: AcceleratorConfig, clock_mhz: float = 1000.0,
) -> list[dict[str, object]]:
    """The numbers of a frame of one eye and of joint frames on a machine, by its name in the report and its configuration, with
    a memory, JSON-ready; `bytes` by client. Frames are packed where the machine can."""
    out = []
    one, two = traces(subject, config)
    for kind, trace in ((ONE, one), (TWO, two), (SHARED, two)):
        if kind == SHARED and not two.sh_degree:
            continue  # without harmonics, colours have no direction
        found = simulate_supertiles(trace, config, display=True, packed=config.packed,
                                    memory=MemoryModel(**memory_arguments(memory), clock_ns=1e3 / clock_mhz),
                                    shared_colour=kind == SHARED)
        busy = {name: stage.busy for name, stage in found.stages.items()}
        out.append({
            "frame": subject.name, "scene": subject.scene, "size": subject.size, "kind": kind, "machine": machine,
            "memory": memory, "cycles": found.total, "phases": found.phases, "busy": busy, "bytes": moved(found),
            "total_bytes": total_bytes(found), "activates": found.activates, "points_read": trace.points_read,
            "chunks_read": int(trace.chunk_read.sum()), "survivors": trace.survivors, "entries": found.entries,
            "pairs": found.pairs, "places": int(trace.places.sum(dtype=np.int64)), "lists": found.lists,
            "batches": found.batches, "visits": found.visits, "shift": trace.shift})
    return out


def paper_row(subject: Subject, memory: str) -> dict[str, object]:
    """The cycles of a frame of one eye on `paper` with a memory."""
    found = simulate(trace_of_paper(subject, PAPER), PAPER, memory=MemoryModel(**memory_arguments(memory)), display=True)
    return {"frame": subject.name, "machine": PAPER.name, "memory": memory, "cycles": found.total}


def shift_row(subject: Subject) -> dict[str, object]:
    """How many pairs a frame has: one eye, both with the median disparity's shift, with none, and with the best one."""
    frame = rendered(subject)
    source, pairs = frame.source, {}
    alone = find_pairs(source.registers, source.words.chunks, source.projected.depth_key, source.entries)
    for shift in range(-4, 5):
        registers = replace(frame.registers, shift=shift)
        found = find_joint_pairs(registers, joint_grids(registers), source.words.chunks, source.projected.depth_key, frame.eyes)
        pairs[shift] = len(found.splat)
    return {"frame": subject.name, "shift": frame.registers.shift, "one": len(alone.splat), "median": len(frame.pairs.splat),
            "unshifted": pairs[0], "best": min(pairs.values()), "best_shift": min(pairs, key=pairs.get)}


def quality_row(subject: Subject, camera: str) -> dict[str, object]:
    """The target's pixels of a joint frame beside those of the target alone and of the oracle's target, whose order is its own:
    PSNR in dB, infinite where nothing differs; and whether the source's pixels are those of the source alone."""
    asked, pair, scale = eyes_of(subject, camera)
    frame = rendered(subject, camera)
    words = frame.source.words
    alone = [render_frame(V3, words, eye) for eye in frame.registers.eyes]
    shared = render_joint_frame(V3, words, replace(frame.registers, shared_colour=True)) if words.sh_degree else frame
    oracle = render_oracle(asked.model, pair.target, foveation=frame.foveations[TARGET], background=asked.background,
                           support_sigma=V3.support_sigma, weights="plane").image
    own, got = alone[TARGET], frame.target
    both = (own.projected.reason == projection.VISIBLE) & (frame.source.projected.reason == projection.VISIBLE)
    keys = np.abs(own.projected.depth_key[both].astype(np.int64) - frame.source.projected.depth_key[both])
    changed = (got.untiled(got.pixels.colour) != own.untiled(own.pixels.colour)).any(axis=2)
    return {
        "frame": subject.name, "scene": subject.scene, "size": subject.size, "camera": camera, **scale,
        "disparity_px": float(np.median(pair.disparity(frame.source.depth[np.isfinite(frame.source.depth)]))),
        "source_equal": all(np.array_equal(a, b) for a, b in zip(frame.source.pixels, alone[SOURCE].pixels, strict=True)),
        "keys_differ": float((keys > 0).mean()), "largest_key_difference": int(keys.max(initial=0)),
        "pixels_differ": float(changed.mean()),
        "only_target": int((frame.pairs.mask[:, SOURCE] == 0).sum()), "pairs": len(frame.pairs.splat),
        "joint_vs_alone_db": psnr_vs(got.image, own.image), "alone_vs_oracle_db": psnr_vs(own.image, oracle),
        "joint_vs_oracle_db": psnr_vs(got.image, oracle),
        "shared_vs_own_db": psnr_vs(shared.target.image, got.image),
        "shared_vs_oracle_db": psnr_vs(shared.target.image, oracle)}
