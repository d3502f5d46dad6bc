"""`--effects`: what of a frame's effects runs, in every command line that renders one."""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

from golden.msv2_ref import pipeline
from golden.msv2_ref.neutral import prepare
from golden.msv2_ref.quantise import GaussianWords, quantise_model
from golden.msv2_ref.stereo import StereoFrame, render_stereo
from golden.scenes.gaze import FoveationMap
from golden.scenes.probe import probe
from golden.scenes.request import Request
from golden.scenes.stereo import stereo_pair
from spec.config import AcceleratorConfig
from spec.constants import IPD_METRES
from spec.effects import EFFECTS, EffectPlan


@dataclass(frozen=True)
class Work:
    """A request as its plan wants it rendered.

    Attributes:
        request: what was asked for.
        plan: its effects.
        config: the machine that has what is active.
        words: the Gaussians for it.
        foveation: the tiles for it.
        prepare_s: seconds that the words took.
    """

    request: Request
    plan: EffectPlan
    config: AcceleratorConfig
    words: GaussianWords
    foveation: FoveationMap
    prepare_s: float

    @property
    def second_eye_forced(self) -> bool:
        """One eye is asked for, two are rendered."""
        return "stereo" in self.plan.active - self.plan.called

    def render(self, *, beta: int | None = None) -> pipeline.Frame:
        """The frame of one eye. `beta` as in `pipeline.render`."""
        return pipeline.render(self.words, self.request.camera, config=self.config, foveation=self.foveation,
                               background=self.request.background, beta=beta)

    def add_eye(self, frame: pipeline.Frame, *, beta: int | None = None) -> StereoFrame:
        """A frame of two eyes whose source is `frame`, unchanged."""
        pair = stereo_pair(self.request.camera, ipd_metres=IPD_METRES, units_per_metre=1.0)
        return render_stereo(self.words, pair, config=self.config, foveation=self.foveation,
                             background=self.request.background, beta=beta, source=frame)


def add_effect_arguments(parser: argparse.ArgumentParser) -> None:
    """The arguments that `work_for` reads."""
    group = parser.add_argument_group("effects", "what the scene and the request call for is found out and printed")
    group.add_argument("--effects", default="auto", metavar="auto|all|none|LIST",
                       help="auto runs what is called for; all, or more than that of " + ",".join(EFFECTS) + ", the rest on "
                       "neutral data, which changes no pixel; less is refused (default: auto)")
    group.add_argument("--depth", action="store_true", help="ask for a depth of every pixel")


def work_for(
    args: argparse.Namespace, request: Request, config: AcceleratorConfig, *, contention: bool = False, full: bool = False,
) -> Work:
    """Probes the request, prints the plan, prepares the data.

    Args:
        args: `effects`, `depth` and `stereo` of the command line.
        request: the resolved rest of it.
        config: the machine.
        contention: a memory with limits is simulated.
        full: the machine has all of `config`, what is not active idles; otherwise that is left out.

    Raises:
        InputError: see `spec.effects.choose_plan`.
    """
    plan = probe(request.model, request.foveation, effects=args.effects, stereo=args.stereo, depth=args.depth,
                 contention=contention)
    print("\n".join(plan.lines()))
    if plan.sh_degree > config.sh_degree:
        print(f"config {config.name!r} has harmonics up to degree {config.sh_degree}: those beyond are left out")
    begin = time.perf_counter()
    words, foveation = prepare(plan, config, quantise_model(config, request.model), request.foveation)
    machine = plan.machine(config)
    if full:
        machine = config.with_(stereo=machine.stereo, fine_depth=machine.fine_depth)
    return Work(request, plan, machine, words, foveation, time.perf_counter() - begin)
