"""Frames that follow each other on a machine with depth buckets, so that the lists of each have the bounds of the one before.

Bounds that suit a frame, bounds of another scene, none, and those of another number of super-tiles: pixels are the same with
all of them, and lists and groups are those of the golden renderer.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from golden.msv2_ref.batches import following
from spec.codes import ErrorCode
from spec.config import AcceleratorConfig
from spec.supertiles import BUCKET_PAIRS, BUCKETS
from tb.top.planned import PlannedFrame, planned
from tb.top.stimuli import Case, case, crowd


def after(this: Case, before: Case) -> Case:
    """A case as the machine renders it right after another one."""
    return replace(this, frame=following(this.frame, before.frame, this.beta))


def bucket_plan(config: AcceleratorConfig) -> list[PlannedFrame]:
    """The frames, which must be played in one simulation; empty where the machine has no depth buckets."""
    if not (config.supertiles and config.buckets):
        return []
    rng = np.random.default_rng(3)
    model = crowd(rng, 2 * BUCKET_PAIRS + 700)
    many = case(config, "two bounds", model, (16, 16), beta=0)
    nearer = case(config, "nearer", replace(model, means=0.8 * model.means), (16, 16), beta=0)
    few = case(config, "few", crowd(rng, 40), (16, 16), beta=0)
    wide = case(config, "two super-tiles", crowd(rng, 300), (140, 16), beta=0)
    stays = {"reset": False, "poison": False}
    return [
        planned(many, "no bounds"),
        planned(after(many, many), "its own bounds", "instant", **stays),
        planned(after(nearer, many), "bounds that are too far away", "instant", **stays),
        planned(after(few, nearer), "more bounds than it needs", **stays),
        planned(after(many, few), "none, because the frame before had few pairs", "instant", **stays),
        planned(after(wide, many), "none, because the frame before had one super-tile", **stays),
        planned(after(many, wide), "none, because the frame before had two super-tiles", "instant", **stays),
        planned(after(many, many), "aborted", "instant", error=ErrorCode.ABORTED, abort=5000, **stays),
        planned(many, "none, because the frame before failed", "instant", **stays),
        *most_lists(config),
    ]


def most_lists(config: AcceleratorConfig) -> list[PlannedFrame]:
    """A super-tile of as many lists as there can be, all of them longer than the first pages, so that the list reader has no
    space for the pages of all of them. The frame before, which follows a reset, makes its bounds."""
    rng, stays = np.random.default_rng(5), {"reset": False, "poison": False}
    before = case(config, "many pairs", crowd(rng, BUCKETS * BUCKET_PAIRS), (16, 16), beta=0)
    most = case(config, "as many lists as there can be", crowd(rng, 360 * BUCKETS), (16, 16))
    return [
        planned(before, "for their bounds", "instant"),
        planned(after(most, before), **stays),
        planned(after(most, most), "its own bounds", "instant", **stays)]
