"""Dense training: from SfM points to a model of the photographs, as the field does it, with schedules for short runs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch

from golden.diff.gaussians import Gaussians
from golden.diff.render import render
from golden.metrics.ssim import Ssim
from golden.scenes.model import SH_REST_COUNT
from golden.training.densify import MIN_OPACITY, PERCENT_DENSE, ScreenGradients, densify
from golden.training.initial import initial_gaussians
from golden.training.losses import photometric
from golden.training.minisplatting import LargestAreas, reinitialised
from golden.training.optimiser import Optimiser, dense_rates
from golden.training.representable import Bounds
from golden.training.scene import MIN_EDGE, TrainingScene
from golden.training.stage import Stage
from golden.training.views import PerView, generator, view_at, views_within

SSIM_BYTES = 48
"""Bytes for each pixel that a view's target and its SSIM statistics take."""

TARGETS_BYTES = 256 << 20
"""Bytes of memory for targets; targets that do not fit are made at each use."""


@dataclass(frozen=True)
class DenseOptions:
    """Options of dense training. Times are shares of the run, so that runs of any length have the same course.

    Attributes:
        iterations: number of iterations; each uses one view.
        max_points: upper limit of the number of Gaussians.
        sh_degree: 0..3, reached one degree at a time.
        sh_every: share of the run between degrees (3DGS: 1,000 of 30,000 iterations).
        coarse_until: share of the run that is trained at half the resolution.
        densify_from, densify_until: shares of the run between which Gaussians are added.
        densify_every: iterations between additions (3DGS).
        threshold: smallest mean screen gradient, in half frames, at which a Gaussian is cloned or split (3DGS: 2e-4).
        opacity_decay: factor on opacities at each addition, in place of 3DGS's resets. Gaussians that the views do not need
            fade and are removed, and no opacity stays stuck at 1. A factor of 1 leaves opacities unchanged.
        gain, means_gain: factors on 3DGS's learning rates, which are meant for 30,000 iterations: for all fields but the means,
            and for the means.
        cooling: share of the run, at its end, over which the rates of all fields but the means fall.
        cooled: factor on these rates at the end; 3DGS keeps them constant.
        blurred: share of a frame's pixels beyond which a Gaussian that is the strongest there is split when points are added;
            None: only gradients decide.
        reinitialised: shares of the run at which all Gaussians are replaced by new ones at what pixels show.
    """

    iterations: int = 7000
    max_points: int = 60_000
    sh_degree: int = 3
    sh_every: float = 0.1
    coarse_until: float = 0.3
    densify_from: float = 0.05
    densify_until: float = 0.5
    densify_every: int = 100
    threshold: float = 2e-4
    opacity_decay: float = 0.9
    gain: float = 4.0
    means_gain: float = 2.0
    cooling: float = 0.5
    cooled: float = 0.1
    blurred: float | None = None
    reinitialised: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.iterations < 1:
            raise ValueError(f"iterations must be at least 1, not {self.iterations!r}")
        if not 0 <= self.densify_from <= self.densify_until <= 1:
            raise ValueError(f"densify_from and densify_until must be ordered in 0..1, not {self.densify_from!r}, "
                             f"{self.densify_until!r}")
        if not 0 < self.opacity_decay <= 1:
            raise ValueError(f"opacity_decay must lie above 0 and up to 1, not {self.opacity_decay!r}")
        if not (0 <= self.cooling <= 1 and 0 < self.cooled <= 1):
            raise ValueError(f"cooling must lie in 0..1 and cooled above 0 and up to 1, not {self.cooling!r}, {self.cooled!r}")
        if self.blurred is not None and not 0 < self.blurred < 1:
            raise ValueError(f"blurred must be None or lie in 0..1, not {self.blurred!r}")
        if not all(0 < share < 1 for share in self.reinitialised):
            raise ValueError(f"reinitialised must lie in 0..1, not {self.reinitialised!r}")

    def rates(self, progress: float, extent: float) -> dict[str, float]:
        """Learning rates of all fields at `progress` in 0..1 of the run, for a scene of the given extent."""
        late = max(0.0, progress - 1 + self.cooling) / self.cooling if self.cooling else 0.0
        gain, rates = self.gain * self.cooled**late, dense_rates(progress, extent)
        return {name: rate * (self.means_gain if name == "means" else gain) for name, rate in rates.items()}


@dataclass(frozen=True)
class _Target:
    """A view's photograph and its SSIM statistics."""

    image: torch.Tensor
    ssim: Ssim


class DenseStage(Stage):
    """Gradient descent on one training view at a time, with adaptive density control.

    Args:
        scene: the scene to train on.
        options: the options of dense training.
        seed: seed of the order of views, of the points that are kept, and of the positions of split Gaussians.
        device: where to train.
    """

    name = "dense"

    def __init__(self, scene: TrainingScene, options: DenseOptions, seed: int, device: torch.device | str = "cpu") -> None:
        self.options, self.seed, self.total, self.done = options, seed, options.iterations, 0
        self._fine = scene
        half = max(scene.size[0] // 2, MIN_EDGE), max(scene.size[1] // 2, MIN_EDGE)
        self._coarse = scene.resized(*half) if options.coarse_until else scene
        first = initial_gaussians(scene, seed, max_points=options.max_points, sh_degree=0)
        self._first_points = len(first)
        self._optimiser = Optimiser(first.to(device), options.rates(0.0, scene.extent))
        self._gradients, self._areas = ScreenGradients(len(first), device), LargestAreas(len(first), device)
        self._bounds = Bounds(scene)
        self._targets: PerView[_Target] | None = None
        self._targets_of: TrainingScene | None = None

    @property
    def gaussians(self) -> Gaussians:
        """The Gaussians in training."""
        return self._optimiser.gaussians

    def step(self) -> dict[str, float]:
        """Trains on one view. A loss that is not finite is returned and changes nothing."""
        progress = self.done / self.total
        self._optimiser.set_rates(self.options.rates(progress, self._fine.extent))
        self._widen(progress)
        scene = self._coarse if progress < self.options.coarse_until else self._fine
        view = view_at(scene.train, self.seed, self.name, self.done)
        target = self._target(scene, view)
        blurred = self.options.blurred is not None and progress <= self.options.densify_until
        rendering = render(self.gaussians, scene.cameras[view], usage=blurred)
        image = scene.unmasked(view, rendering.image)
        loss = photometric(image, target.ssim, target.image)
        value, record = float(loss.detach()), {}
        if math.isfinite(value):
            loss.backward()
            self._gradients.observe(rendering.index, rendering.mean2d.grad, scene.size)
            if blurred:
                self._areas.observe(rendering)
            self._optimiser.step()
            self.done += 1
            self._control_density()
            self._reinitialise()
            if self.done % self.options.densify_every == 0 or self.finished:
                record["narrowed"] = self._bounds.apply(self.gaussians)
        error = float((image.detach().clamp(0, 1) - target.image).square().mean()) / scene.shown_share(view)
        return {"loss": value, "points": len(self.gaussians), "psnr": -10 * math.log10(max(error, 1e-10)), "view": view,
                "entries": int(rendering.entries), **record}

    def result(self) -> Gaussians:
        """The Gaussians, with harmonics of the full degree."""
        self._optimiser.widen(SH_REST_COUNT[self.options.sh_degree])
        return self.gaussians.detached()

    def state(self) -> dict[str, object]:
        """See `Stage`."""
        return {"done": self.done, "optimiser": self._optimiser.state(), "gradients": self._gradients.state(),
                "areas": self._areas.share.clone()}

    def load(self, state: dict[str, object]) -> None:
        """See `Stage`."""
        self.done = state["done"]
        self._optimiser.load(state["optimiser"])
        self._gradients.load(state["gradients"])
        if "areas" in state:  # checkpoints of 0.4 have none
            self._areas.share = state["areas"].to(self.gaussians.device).clone()

    def _widen(self, progress: float) -> None:
        """Adds coefficients for the SH degree that is due. Coefficients of higher degrees do not exist before, which saves
        time."""
        every, highest = self.options.sh_every, self.options.sh_degree
        degree = min(highest, int(progress / every)) if every else highest
        if SH_REST_COUNT[degree] > self.gaussians.sh_rest.shape[1]:
            self._optimiser.widen(SH_REST_COUNT[degree])

    def _control_density(self) -> None:
        """When it is time, adds Gaussians where gradients are large and removes transparent ones."""
        options, progress = self.options, self.done / self.total
        if self.done % options.densify_every or not options.densify_from <= progress <= options.densify_until:
            return
        share = (progress - options.densify_from) / max(options.densify_until - options.densify_from, 1e-9)
        opaque = torch.sigmoid(self.gaussians.opacity.detach()) >= MIN_OPACITY
        gradient, area = self._gradients.mean[opaque], self._areas.share[opaque]
        self._optimiser.select(opaque)
        goal = self._first_points + share * (options.max_points - self._first_points)
        densify(self._optimiser, gradient, threshold=options.threshold, budget=round(goal) - len(self.gaussians),
                small=PERCENT_DENSE * self._fine.extent, random=generator(self.seed, f"{self.name} splits", self.done),
                blurred=None if options.blurred is None else torch.where(area > options.blurred, area, 0.0))
        if options.opacity_decay < 1:
            opacity = options.opacity_decay * torch.sigmoid(self.gaussians.opacity.detach())
            self.gaussians.opacity.data.copy_(torch.logit(opacity))
        self._forget()

    def _forget(self) -> None:
        """Starts new sums, because rows have changed."""
        points, device = len(self.gaussians), self.gaussians.device
        self._gradients, self._areas = ScreenGradients(points, device), LargestAreas(points, device)

    def _reinitialise(self) -> None:
        """When it is time, replaces all Gaussians by as many at the points that pixels show."""
        if self.done not in [round(share * self.total) for share in self.options.reinitialised]:
            return
        harmonics, progress = self.gaussians.sh_rest.shape[1], self.done / self.total
        made = reinitialised(self.gaussians, self._fine, len(self.gaussians), self.seed, self.done)
        self._optimiser = Optimiser(made.to(self.gaussians.device), self.options.rates(progress, self._fine.extent))
        self._optimiser.widen(harmonics)
        self._forget()

    def _target(self, scene: TrainingScene, view: int) -> _Target:
        if self._targets_of is not scene:
            device = self.gaussians.device

            def make(index: int) -> _Target:
                photograph = scene.photograph(index).to(device)
                return _Target(photograph, Ssim(photograph))

            width, height = scene.size
            self._targets = PerView(make, views_within(width * height, SSIM_BYTES, TARGETS_BYTES))
            self._targets_of = scene
        return self._targets(view)
