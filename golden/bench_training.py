"""Training iterations a second: ours against a plain torch tile renderer, everything else the same.

An iteration is what dense training does to a view: forward, 3DGS's loss, backward, a step of Adam on every field. All start
from the same Gaussians, those of the model with dimmed colours, see the same camera, and train towards the oracle's picture of
the model. Torch is an optional dependency: this module needs it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from tqdm import tqdm

from golden.metrics.image import psnr_vs
from golden.metrics.ssim import Ssim
from golden.msv2_ref import parallel
from golden.oracle.render import render as render_oracle
from golden.scenes.camera import Camera
from golden.scenes.model import GaussianModel
from golden.training import reference, render
from golden.training.gaussians import Gaussians, from_model, to_model
from golden.training.losses import photometric
from golden.training.optimiser import Optimiser, dense_rates

OURS, PLAIN, PLAIN_ALONE = "numba renderer", "plain torch tiles", "plain torch tiles, 1 thread"
"""Torch's threads wait for each other after every operation on a tile: where cores are shared, one thread may be faster."""

TURN = {OURS: 5, PLAIN: 1, PLAIN_ALONE: 1}
"""Iterations in a turn: one of ours is too short to be timed alone on a busy machine."""

DIMMED = 0.9
"""Factor of the DC colours at the start, so that there is something to train."""

PARTS = ("forward", "loss", "backward", "step")


class Training:
    """One renderer's training of one view, on a number of threads; keeps the seconds of each part of an iteration."""

    def __init__(
        self, draw: Callable[..., object], threads: int, start: Gaussians, camera: Camera, target: torch.Tensor
    ) -> None:
        self._draw, self._threads, self._camera = draw, threads, camera
        self._target, self._ssim = target, Ssim(target)
        self._optimiser = Optimiser(start, dense_rates(0.0, 1.0))
        self.seconds: dict[str, list[float]] = {part: [] for part in PARTS}
        self.image: torch.Tensor | None = None
        """Of the last iteration."""

    def iterate(self) -> float:
        """One iteration; its seconds."""
        torch.set_num_threads(self._threads)
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
        return clock[-1] - clock[0]


def compare(model: GaussianModel, camera: Camera, rounds: int) -> dict[str, object]:
    """One view's numbers: per renderer seconds an iteration by round, and PSNR of its first picture against the oracle."""
    threads = torch.get_num_threads()
    try:
        return _compare(model, camera, rounds)
    finally:
        torch.set_num_threads(threads)


def _compare(model: GaussianModel, camera: Camera, rounds: int) -> dict[str, object]:
    progress = tqdm(total=2 + (rounds + 1) * len(TURN), desc=f"{model.name}, training", unit="turn")

    def oracle(gaussians: Gaussians) -> np.ndarray:
        progress.update()
        return render_oracle(to_model(gaussians, up=model.up, name=model.name), camera).image

    trained = from_model(model)
    start = replace(trained, sh_dc=DIMMED * trained.sh_dc)
    target = torch.from_numpy(oracle(trained).clip(0, 1).astype(np.float32))
    truth = oracle(start)
    view = (start, camera, target)
    work = {OURS: Training(render.render, parallel.threads, *view), PLAIN: Training(reference.render, parallel.threads, *view),
            PLAIN_ALONE: Training(reference.render, 1, *view)}
    psnr, seconds = {}, {name: [] for name in work}
    for name, training in work.items():  # compiles, and draws the one picture that all draw of the same Gaussians
        training.iterate()
        psnr[name] = psnr_vs(training.image.numpy().astype(np.float64), truth)
        training.seconds = {part: [] for part in PARTS}
        progress.update()
    for _ in range(rounds):
        for name, training in work.items():
            seconds[name].append(sum(training.iterate() for _ in range(TURN[name])) / TURN[name])
            progress.update()
    progress.close()
    median = {name: float(np.median(values)) for name, values in seconds.items()}
    return {
        "size": [camera.width, camera.height], "splats": len(model), "entries": render.render(start, camera).entries,
        "renderers": {
            name: {
                "iterations_per_s": 1 / median[name], "median_s": median[name], "min_s": min(values), "max_s": max(values),
                "rounds_s": values, "times_ours": median[name] / median[OURS], "psnr_vs_oracle_db": psnr[name],
                "parts_s": {part: float(np.median(taken)) for part, taken in work[name].seconds.items()},
            } for name, values in seconds.items()
        },
    }


def table(result: dict[str, object]) -> str:
    """One view's numbers as Markdown."""
    width, height = result["size"]
    header = ["renderer", "iterations/s", "median ms", "min..max ms", "times ours", *(f"{part} ms" for part in PARTS),
              "dB against the oracle"]
    rows = [[name, f"{r['iterations_per_s']:.2f}", f"{1e3 * r['median_s']:.1f}",
             f"{1e3 * r['min_s']:.1f}..{1e3 * r['max_s']:.1f}", f"{r['times_ours']:.1f}",
             *(f"{1e3 * r['parts_s'][part]:.1f}" for part in PARTS), f"{r['psnr_vs_oracle_db']:.1f}"]
            for name, r in result["renderers"].items()]
    return "\n".join([
        f"Training at {width}x{height}, {result['entries']:,} entries: forward, loss, backward and Adam's step.", "",
        *(f"| {' | '.join(row)} |" for row in [header, ["---"] * len(header), *rows]), ""])
