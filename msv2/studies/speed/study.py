"""Compares the speed of three renderers: the integer golden renderer, a float32 kernel of the same structure, and plain torch.

It then compares training iterations of the differentiable renderer with those of a plain one in torch.

Everything is warm: kernels are compiled, and models are in each renderer's own form, which is made once per model and timed
apart. The renderers take turns, so that a busy machine slows all of them alike. Medians and ratios are the numbers to quote.
The study asserts nothing.
"""

from __future__ import annotations

import argparse
import os
import platform
import time
from collections.abc import Callable, Sequence

import numpy as np
from tqdm import tqdm

from golden import threads
from golden.diff import import_torch
from golden.host.quantise import quantise_model
from golden.metrics.image import psnr_vs
from golden.msv2_ref import pipeline
from golden.oracle.render import render as render_oracle
from golden.scenes.level_source import RANDOM
from golden.scenes.load import EMBEDDED
from golden.scenes.request import Request, make_folder, resolve
from msv2.studies import page
from msv2.studies.page import write_page
from msv2.studies.record import write_report
from msv2.studies.speed import float32
from spec.command_line import command_parser
from spec.config import PAPER
from spec.errors import InputError
from spec.paths import REPORTS

EXAMPLES = """examples:
  msv2 study run speed                                          the embedded scene
  msv2 study run speed truck.splat rock_sh3/ --size 640x360     several scenes in one report
"""

TRAINING_SIZE = {EMBEDDED: "256x256"}
"""Frame size of the training iterations, by scene; OTHER_TRAINING_SIZE for any other."""

OTHER_TRAINING_SIZE = "400x266"

INTEGER, FLOAT, TORCH = "integer golden", "float32 kernel", "per-tile torch"


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """The parsed command line."""
    parser = command_parser("msv2 study run speed", __doc__, EXAMPLES)
    parser.add_argument("scenes", nargs="*", default=[EMBEDDED], metavar="SCENE",
                        help="model files or folders, or 'embedded' (default)")
    parser.add_argument("--camera", default="orbit", metavar="orbit|INDEX|FILE", help="the camera (default: orbit)")
    parser.add_argument("--size", default="640x360", metavar="WxH", help="frame size (default: 640x360)")
    parser.add_argument("--training-size", metavar="WxH", help="frame size of the training iterations "
                        f"(default: {TRAINING_SIZE[EMBEDDED]} for the embedded scene, {OTHER_TRAINING_SIZE} for others)")
    parser.add_argument("--repeat", type=int, default=5, metavar="N", help="number of rounds (default: 5)")
    parser.add_argument("--out", default=str(REPORTS), metavar="DIR",
                        help="folder of bench.json and bench.md (default: build/reports; --keep: reports)")
    # The other renderers draw one level on black, so all renderers are compared with that.
    parser.set_defaults(gaze="none", levels=1, levels_from=RANDOM, background="0,0,0", seed=0)
    return parser.parse_args(argv)


def timed(work: Callable[[], object]) -> tuple[float, object]:
    """The seconds of a call, and its result."""
    begin = time.perf_counter()
    result = work()
    return time.perf_counter() - begin, result


def compare(request: Request, rounds: int) -> dict[str, object]:
    """The numbers of a scene: for each renderer the seconds of every round, the PSNR against the oracle, the preparation time,
    and the stages where it has them."""
    import torch

    from golden.diff import reference
    from golden.diff.gaussians import from_model

    model, camera = request.model, request.camera
    progress = tqdm(total=4 + 3 * (rounds + 1), desc=model.name, unit="frame")

    def step(work: Callable[[], object]) -> tuple[float, object]:
        seconds, result = timed(work)
        progress.update()
        return seconds, result

    prepared = {
        INTEGER: step(lambda: quantise_model(PAPER, model)),
        FLOAT: step(lambda: float32.prepare(model)),
        TORCH: step(lambda: from_model(model)),
    }
    draw = {
        INTEGER: lambda: pipeline.render(prepared[INTEGER][1], camera, config=PAPER),
        FLOAT: lambda: float32.render(prepared[FLOAT][1], camera),
        TORCH: torch.inference_mode()(lambda: reference.render(prepared[TORCH][1], camera)),
    }
    oracle = step(lambda: render_oracle(model, camera))[1].image
    warm = {name: step(work)[1] for name, work in draw.items()}
    seconds = {name: [] for name in draw}
    stages = {INTEGER: [], FLOAT: []}
    for _ in range(rounds):
        for name, work in draw.items():
            elapsed, frame = step(work)
            seconds[name].append(elapsed)
            if name in stages:
                stages[name].append(frame.seconds)
    progress.close()
    median = {name: float(np.median(values)) for name, values in seconds.items()}
    return {
        "scene": model.name, "camera": camera.name, "size": [camera.width, camera.height],
        "splats": len(model), "entries": len(warm[INTEGER].entries.splat),
        "renderers": {
            name: {
                "median_s": median[name], "min_s": min(values), "max_s": max(values), "rounds_s": values,
                "times_integer": median[name] / median[INTEGER], "prepare_s": prepared[name][0],
                "psnr_vs_oracle_db": psnr_vs(np.asarray(warm[name].image, np.float64), oracle),
            } for name, values in seconds.items()
        },
        "stages_s": {
            name: {stage: float(np.median([frame[stage] for frame in frames])) for stage in frames[0]}
            for name, frames in stages.items()
        },
    }


def requested(args: argparse.Namespace, scene: str, size: str) -> Request:
    """The model and the camera of a scene, at a frame size."""
    return resolve(argparse.Namespace(**{**vars(args), "scene": scene, "size": size}))


def table(result: dict[str, object]) -> str:
    """The numbers of a scene as Markdown."""
    width, height = result["size"]
    integer, single = result["stages_s"][INTEGER], result["stages_s"][FLOAT]
    stages = [stage for stage in integer if stage in single]
    return "\n".join([
        f"## {result['scene']}, {width}x{height}, {result['splats']:,} splats, {result['entries']:,} entries", "",
        page.table(["renderer", "median ms", "min..max ms", "times the integer's", "dB against the oracle"], [
            [name, f"{1e3 * r['median_s']:.1f}", f"{1e3 * r['min_s']:.1f}..{1e3 * r['max_s']:.1f}",
             f"{r['times_integer']:.2f}", f"{r['psnr_vs_oracle_db']:.1f}"] for name, r in result["renderers"].items()]), "",
        page.table(["median ms by stage", *stages], [
            [name, *(f"{1e3 * of[stage]:.1f}" for stage in stages)] for name, of in ((INTEGER, integer), (FLOAT, single))]),
        ""])


def main(argv: Sequence[str] | None = None) -> None:
    """Runs the command line."""
    args = parse_arguments(argv)
    if args.repeat < 1:
        raise InputError(f"repeat {args.repeat} is not accepted: 1 or more is")
    import_torch()  # so that a missing package is reported before the work
    from msv2.studies.speed import training

    out = make_folder(args.out)
    requests = [requested(args, scene, args.size) for scene in args.scenes]
    trained = [requested(args, scene, args.training_size or TRAINING_SIZE.get(scene, OTHER_TRAINING_SIZE))
               for scene in args.scenes]
    results = [compare(request, args.repeat) for request in requests]
    for result, request in zip(results, trained, strict=True):
        result["training"] = training.compare(request.model, request.camera, args.repeat)
    machine = {"processor": platform.machine(), "cores": os.cpu_count(), "threads": threads.threads,
               "python": platform.python_version(), "load_average": os.getloadavg()[0]}
    report = "\n".join([
        "# Renderer speed", "", "Made by `make bench`; whole frames and iterations, warm, renderers in turn. Medians of "
        f"{args.repeat} rounds, {threads.threads} threads, load average {machine['load_average']:.1f}.", "",
        *("\n".join([table(result), training.table(result["training"])]) for result in results)])
    write_report(out / "bench.json", {"machine": machine, "scenes": results}, [__name__],
                 {"arguments": args, "machine": PAPER}, args.scenes)
    write_page(out / "bench.md", report)
    print(report)
    print(f"written: {out / 'bench.json'}, {out / 'bench.md'}")
