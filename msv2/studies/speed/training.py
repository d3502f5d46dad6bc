"""Compares training iterations per second of our renderer with those of a plain torch tile renderer, with all else equal.

An iteration is that of dense training on one view: forward pass, the loss of 3DGS, backward pass, and a step of Adam on every
field. All trainings start from the same Gaussians, which are those of the model with dimmed colours, see the same camera, and
train towards the oracle's picture of the model. Each uses one thread or all threads, whichever was faster at first: torch's
threads wait for each other after every operation, which costs more than it gains for small tensors or shared cores. The module
needs torch, which is an optional dependency.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from tqdm import tqdm

from golden import threads as parallel
from golden.diff import reference, render
from golden.diff.gaussians import Gaussians, from_model, to_model
from golden.metrics.image import psnr_vs
from golden.metrics.ssim import Ssim
from golden.oracle.render import render as render_oracle
from golden.scenes.camera import Camera
from golden.scenes.model import GaussianModel
from golden.training.losses import photometric
from golden.training.optimiser import Optimiser, dense_rates
from msv2.studies import page

OURS, PLAIN = "numba renderer", "plain torch tiles"

TURN = {OURS: 5, PLAIN: 1}
"""Iterations per turn. A single iteration of ours is too short to be timed on a busy machine."""

DIMMED = 0.9
"""Factor of the base colours at the start, so that there is something to train."""

PARTS = ("forward", "loss", "backward", "step")


class Training:
    """A renderer's training of one view with a number of threads. It records the seconds of each part of an iteration."""

    def __init__(
        self, draw: Callable[..., object], threads: int, start: Gaussians, camera: Camera, target: torch.Tensor
    ) -> None:
        self._draw, self.threads, self._camera = draw, threads, camera
        self._target, self._ssim = target, Ssim(target)
        self._optimiser = Optimiser(start, dense_rates(0.0, 1.0))
        self.seconds: dict[str, list[float]] = {part: [] for part in PARTS}
        self.image = self.first = None
        """(H, W, 3) images of the last and of the first iteration."""

    def iterate(self) -> float:
        """Runs one iteration; returns its seconds."""
        torch.set_num_threads(self.threads)
        clock = [time.perf_counter()]
        self.image = self._draw(self._optimiser.gaussians, self._camera).image
        clock.append(time.perf_counter())
        loss = photometric(self.image, self._ssim, self._target)
        clock.append(time.perf_counter())
        loss.backward()
        clock.append(time.perf_counter())
        self._optimiser.step()
        clock.append(time.perf_counter())
        for part, begin, end in zip(PARTS, clock, clock[1:], strict=False):
            self.seconds[part].append(end - begin)
        self.image = self.image.detach()
        self.first = self.image if self.first is None else self.first
        return clock[-1] - clock[0]


def compare(model: GaussianModel, camera: Camera, rounds: int) -> dict[str, object]:
    """The numbers of a view: for each renderer the seconds per iteration by round, and the PSNR of its first image against the
    oracle."""
    threads = torch.get_num_threads()
    try:
        return _compare(model, camera, rounds)
    finally:
        torch.set_num_threads(threads)


def _faster(draw: Callable[..., object], *view: object) -> Training:
    """The training with one thread or with all threads, whichever has the shorter second iteration."""
    found = {}
    for threads in sorted({1, parallel.threads}):
        training = Training(draw, threads, *view)
        training.iterate()
        found[training.iterate()] = training
    best = found[min(found)]
    best.seconds = {part: [] for part in PARTS}
    return best


def _compare(model: GaussianModel, camera: Camera, rounds: int) -> dict[str, object]:
    progress = tqdm(total=2 + (rounds + 1) * len(TURN), desc=f"{model.name}, training", unit="turn")

    def done(result: object) -> object:
        progress.update()
        return result

    def oracle(gaussians: Gaussians) -> np.ndarray:
        return done(render_oracle(to_model(gaussians, up=model.up, name=model.name), camera)).image

    trained = from_model(model)
    start = replace(trained, sh_dc=DIMMED * trained.sh_dc)
    target = torch.from_numpy(oracle(trained).clip(0, 1).astype(np.float32))
    truth = oracle(start)
    draw = {OURS: render.render, PLAIN: reference.render}
    work = {name: done(_faster(function, start, camera, target)) for name, function in draw.items()}
    seconds = {name: [] for name in work}
    for _ in range(rounds):
        for name, training in work.items():
            seconds[name].append(done(sum(training.iterate() for _ in range(TURN[name])) / TURN[name]))
    progress.close()
    median = {name: float(np.median(values)) for name, values in seconds.items()}
    return {
        "size": [camera.width, camera.height], "splats": len(model), "entries": render.render(start, camera).entries,
        "renderers": {
            name: {
                "iterations_per_s": 1 / median[name], "median_s": median[name], "min_s": min(values), "max_s": max(values),
                "rounds_s": values, "times_ours": median[name] / median[OURS], "threads": work[name].threads,
                "psnr_vs_oracle_db": psnr_vs(work[name].first.numpy().astype(np.float64), truth),
                "parts_s": {part: float(np.median(taken)) for part, taken in work[name].seconds.items()},
            } for name, values in seconds.items()
        },
    }


def table(result: dict[str, object]) -> str:
    """The numbers of a view as Markdown."""
    width, height = result["size"]
    header = ["renderer", "iterations/s", "median ms", "min..max ms", "times ours", "threads",
              *(f"{part} ms" for part in PARTS), "dB against the oracle"]
    rows = [[name, f"{r['iterations_per_s']:.2f}", f"{1e3 * r['median_s']:.1f}",
             f"{1e3 * r['min_s']:.1f}..{1e3 * r['max_s']:.1f}", f"{r['times_ours']:.1f}", f"{r['threads']}",
             *(f"{1e3 * r['parts_s'][part]:.1f}" for part in PARTS), f"{r['psnr_vs_oracle_db']:.1f}"]
            for name, r in result["renderers"].items()]
    return "\n".join([
        f"Training at {width}x{height}, {result['entries']:,} entries: forward, loss, backward and Adam's step.", "",
        page.table(header, rows), ""])
