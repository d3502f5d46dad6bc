"""The cycles of a frame on any machine: with lists by tile (`perf.model`) or by super-tile (`perf.supertiles`)."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path

from golden.msv2_ref.eyes import StereoFrame
from golden.msv2_ref.pipeline import Frame
from golden.scenes.request import Request
from perf import model, supertiles, supertiles_trace, trace
from perf.model import FrameCycles, MemoryModel
from perf.supertiles_trace import SuperTrace
from perf.trace import FrameTrace
from spec.config import AcceleratorConfig

Trace = FrameTrace | SuperTrace


def trace_of(golden: Frame | StereoFrame, *, record: Mapping[str, object] | None = None) -> Trace:
    """The trace of a golden frame; `record` is its request as JSON-ready values."""
    if isinstance(golden, Frame) and golden.config.supertiles:
        return supertiles_trace.super_trace(golden, record=dict(record or {}))
    return trace.trace_of(golden, record=record)


def trace_request(
    args: argparse.Namespace, config: AcceleratorConfig, *, cache: Path | None = None, request: Request | None = None,
    render: Callable[[], Frame | StereoFrame] | None = None,
) -> Trace:
    """The trace of the frame that a command line requests. Arguments and errors are those of `perf.trace.trace_request`."""
    make = supertiles_trace.trace_request if config.supertiles else trace.trace_request
    return make(args, config, cache=cache, request=request, render=render)


def simulate(
    traced: Trace, config: AcceleratorConfig, *, memory: MemoryModel | None = None, merge: bool = True,
    beta: int | None = None, display: bool | None = None, packed: bool = False,
) -> FrameCycles:
    """Simulates a frame; with super-tiles, one that follows the same frame, whose bounds of depth buckets it has.

    Args:
        traced: the trace of the golden frame.
        config: the machine's configuration.
        memory, merge, beta: see `perf.model.simulate`.
        display: whether a pixel takes 4 bytes in memory instead of 16; None for frames of two eyes only.
        packed: whether the frame is packed instead; only on machines that pack frames.

    Raises:
        ValueError: the machine is not of the trace's kind or packs no frames, or see `perf.model.simulate`.
    """
    if isinstance(traced, SuperTrace):
        return supertiles.simulate_supertiles(
            traced, config, memory=memory, merge=merge, beta=beta, display=bool(display), packed=packed)
    if packed:
        raise ValueError(f"config must be a machine that packs frames, not {config.name!r}")
    return model.simulate(traced, config, memory=memory, merge=merge, beta=beta, display=display)
