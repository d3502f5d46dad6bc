"""Carries out the plan of a frame's effects: prepares the data that the plan needs and renders the frame.

The data lacks what an absent effect would use. Where an effect is forced that the frame does not need, the data is neutral, so
that the effect works without changing any bit of the image: SH coefficients of 0, levels that equal the first, blend parameters
below 0.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import numpy as np

from golden.host import compact
from golden.host.quantise import GaussianWords, quantise_model, with_opacities
from golden.kernels import work_clock
from golden.msv2_ref import pipeline
from golden.msv2_ref.eyes import StereoFrame, render_stereo
from golden.scenes.gaze import FoveationMap
from golden.scenes.probe import probe
from golden.scenes.request import Request
from golden.scenes.stereo import stereo_pair
from spec.compact import COARSE_BOUND, FINE_LEVELS
from spec.config import AcceleratorConfig
from spec.constants import IPD_METRES, MAX_LEVELS
from spec.effects import EffectPlan
from spec.records import gaussian_colour

_NOT_YET = (-1.0, 0.0, 0.0)
"""A blend plane whose tile lies before its blend band, so that all weights are 0."""


def with_sh_degree(words: GaussianWords, degree: int) -> GaussianWords:
    """The words with colour records of SH degree `degree`: coefficients beyond it are dropped, missing ones are 0."""
    if degree == words.sh_degree:
        return words
    colour = np.zeros(len(words.colour), gaussian_colour(words.config, degree).dtype)
    colour["dc"] = words.colour["dc"]
    if degree and words.sh_degree:
        count = min(colour["rest"].shape[1], words.colour["rest"].shape[1])
        colour["rest"][:, :count] = words.colour["rest"][:, :count]
    packed = words.compact and compact.with_sh_degree(words.compact, min(degree, words.sh_degree), present=bool(degree))
    return replace(words, colour=colour, sh_degree=degree, compact=packed)


def prepare(
    plan: EffectPlan, config: AcceleratorConfig, words: GaussianWords, foveation: FoveationMap,
) -> tuple[GaussianWords, FoveationMap]:
    """Words and tiles of a frame for the machine `plan.machine(config)`: `prepare_words` and `prepare_foveation`."""
    return prepare_words(plan, config, words), prepare_foveation(plan, config, foveation)


def prepare_words(plan: EffectPlan, config: AcceleratorConfig, words: GaussianWords) -> GaussianWords:
    """The Gaussians as the machine `plan.machine(config)` reads them; all frames with this plan share them.

    Args:
        plan: the effects.
        config: the machine with all effects; where levels are forced, as many are used as it has.
        words: the Gaussians.
    """
    words = with_sh_degree(words, min(plan.sh_degree, config.sh_degree))
    if "levels" not in plan.active:
        return replace(words, levels=1)
    if "levels" not in plan.called:  # every level equals the first, so every point belongs to all levels
        return _all_levels(words, config.levels)
    return words


def prepare_foveation(plan: EffectPlan, config: AcceleratorConfig, foveation: FoveationMap) -> FoveationMap:
    """The tiles of one frame for the machine `plan.machine(config)`.

    Args:
        plan, config: as in `prepare_words`.
        foveation: the frame's tile levels and planes.
    """
    if "levels" not in plan.active:
        return foveation
    if "levels" not in plan.called:
        foveation = replace(foveation, levels=config.levels)
    if "blend" in plan.active and "blend" not in plan.called:
        blend = foveation.tile_level + 1 < foveation.levels
        plane = np.where(blend[..., None], _NOT_YET, foveation.plane)
        foveation = replace(foveation, blend=blend, plane=plane)
    return foveation


def _all_levels(words: GaussianWords, levels: int) -> GaussianWords:
    """The words with all levels like the first. In compact records Gaussians keep the width of their fields, which their bound
    decides: those with a bound below the highest get the highest bound of fine fields, more than the frame's tiles use."""
    geometry, colour = words.geometry.copy(), words.colour.copy()
    geometry["log2_opacity"] = geometry["log2_opacity"][:, :1]
    colour["dc"] = np.tile(colour["dc"][:, :3], (1, MAX_LEVELS))
    if words.chunks is None:
        geometry["bound"] = MAX_LEVELS - 1
        return replace(words, geometry=geometry, colour=colour, levels=levels)
    coarse, chunks = words.chunks["bound"] == COARSE_BOUND, words.chunks.copy()
    chunks["bound"] = np.where(coarse | (words.compact is None), COARSE_BOUND, FINE_LEVELS - 1)
    geometry["bound"] = np.repeat(chunks["bound"], chunks["count"])
    return with_opacities(replace(
        words, geometry=geometry, colour=colour, levels=levels, chunks=chunks,
        compact=words.compact and compact.with_first_level(words.compact)))


@dataclass(frozen=True)
class Work:
    """A request together with the plan, machine and data to render it with.

    Attributes:
        request: what was asked for.
        plan: the plan of its effects.
        config: the machine that has the active effects.
        words: the Gaussians for it.
        foveation: the tiles for it.
        prepare_s: seconds that preparing the words took.
    """

    request: Request
    plan: EffectPlan
    config: AcceleratorConfig
    words: GaussianWords
    foveation: FoveationMap
    prepare_s: float

    @property
    def second_eye_forced(self) -> bool:
        """Whether two eyes are rendered although one is asked for."""
        return "stereo" in self.plan.active - self.plan.called

    def render(self, *, beta: int | None = None) -> pipeline.Frame:
        """Renders the frame of one eye. `beta` is as in `pipeline.render`."""
        return pipeline.render(self.words, self.request.camera, config=self.config, foveation=self.foveation,
                               background=self.request.background, beta=beta)

    def add_eye(self, frame: pipeline.Frame, *, beta: int | None = None) -> StereoFrame:
        """A frame of two eyes whose source is `frame`, which is not changed."""
        pair = stereo_pair(self.request.camera, ipd_metres=IPD_METRES, units_per_metre=1.0)
        return render_stereo(self.words, pair, config=self.config, foveation=self.foveation,
                             background=self.request.background, beta=beta, source=frame)


def plan_for(
    args: argparse.Namespace, request: Request, config: AcceleratorConfig, *, contention: bool = False,
) -> EffectPlan:
    """Finds out what the request calls for, and prints it.

    Args:
        args: the command line's arguments; `effects`, `depth` and `stereo` are read.
        request: the request resolved from the other arguments.
        config: the machine.
        contention: whether a memory of limited bandwidth is simulated.

    Raises:
        InputError: see `spec.effects.choose_plan`.
    """
    plan = probe(request.model, request.foveation, effects=args.effects, stereo=args.stereo, depth=args.depth,
                 contention=contention)
    print("\n".join(plan.lines()))
    if plan.sh_degree > config.sh_degree:
        print(f"config {config.name!r} has harmonics up to degree {config.sh_degree}: those beyond are left out")
    return plan


def planned_machine(plan: EffectPlan, config: AcceleratorConfig, *, full: bool = False) -> AcceleratorConfig:
    """`config` with what is active and no more; `full`: all of it, where what is not active idles."""
    machine = plan.machine(config)
    return config.with_(stereo=machine.stereo, fine_depth=machine.fine_depth) if full else machine


def planned_work(request: Request, plan: EffectPlan, config: AcceleratorConfig, *, full: bool = False) -> Work:
    """The request's data as the plan wants it, for `planned_machine`."""
    begin = work_clock()
    words, foveation = prepare(plan, config, quantise_model(config, request.model), request.foveation)
    return Work(request, plan, planned_machine(plan, config, full=full), words, foveation, work_clock() - begin)


def work_for(
    args: argparse.Namespace, request: Request, config: AcceleratorConfig, *, contention: bool = False, full: bool = False,
) -> Work:
    """The work of a request: `plan_for` and `planned_work`, whose arguments these are.

    Raises:
        InputError: see `spec.effects.choose_plan`.
    """
    return planned_work(request, plan_for(args, request, config, contention=contention), config, full=full)
