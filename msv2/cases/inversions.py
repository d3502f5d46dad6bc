"""Analyses the order in which a frame's splats are blended, against the machine's own z and against float64 z."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from golden.metrics.image import max_abs_error, psnr_vs
from golden.msv2_ref import array, pipeline
from golden.scenes.camera import Camera
from golden.scenes.camera_options import ORBIT
from golden.scenes.level_source import RANDOM
from golden.scenes.model import GaussianModel
from golden.scenes.request import Request, add_request_arguments, resolve, write_json
from spec.command_line import command_parser
from spec.config import AcceleratorConfig
from spec.errors import run_command_line
from spec.overrides import add_config_arguments, config_from, config_record
from spec.paths import BUILD
from spec.private import output_folder

EPILOG = """\
Writes OUT/order.json. An inversion is a pair of neighbours in a tile's list of which the second is nearer.

  machine_inversions    inversions by the machine's own, rounded z, among pairs with at most one saturated key; must be 0
  saturated_inversions  inversions by the machine's z among pairs whose keys are both saturated
  equal_keys            pairs with equal keys, which are ordered by the index of the Gaussian
  float64_inversions    inversions by the oracle's float64 z; largest_gap is the largest (z1 - z2) / z1 among them
  max_abs_error         the largest difference in a pixel's colour if the same intersections are blended in the order of
                        float64 z; worst_pixel is its place, changed_pixels the number of pixels that differ, and psnr_db
                        the PSNR between the two images

The exit status is 1 if machine_inversions is not 0.

examples:
  python -m msv2.cases.inversions                                         the embedded scene
  python -m msv2.cases.inversions truck.splat --size 640x360 --camera 3
"""


def machine_z(frame: pipeline.Frame) -> np.ndarray:
    """(N,) float64 camera z of every Gaussian, with every operation rounded to the `view` format."""
    V, r, mean = frame.config.formats.view, frame.registers, frame.words.decoded.mean
    product = [V.round(r.rotation[2, i] * V.round(mean[:, i] - r.position[i])) for i in range(3)]
    return V.round(V.round(product[0] + product[1]) + product[2])


def float64_z(model: GaussianModel, camera: Camera) -> np.ndarray:
    """(N,) float64 camera z of every Gaussian, as the oracle projects it."""
    return (model.means @ camera.rotation.T + camera.translation)[:, 2]


def neighbours(start: np.ndarray) -> np.ndarray:
    """(intersections - non-empty tiles,) the first of every pair of neighbours that share a tile; `start` is (tiles + 1,)."""
    last = np.zeros(start[-1], bool)
    last[start[1:][np.diff(start) > 0] - 1] = True
    return np.flatnonzero(~last)


def reordered(frame: pipeline.Frame, z: np.ndarray) -> pipeline.Frame:
    """The frame with every tile's intersections blended in the order of (z, Gaussian index); `z` is (N,)."""
    e, r = frame.entries, frame.registers
    tile = np.repeat(np.arange(len(r.header)), np.diff(e.start))
    order = np.lexsort((e.splat, z[e.splat], tile))
    entries = e._replace(splat=e.splat[order], use=e.use[order])
    tile_y, tile_x = np.divmod(np.arange(len(r.header)), r.tiles_x)
    header = np.column_stack([tile_x, tile_y, r.header[:, [0, 2, 1]]])
    work = array.TileWork(header, r.plane, entries.start, entries.splat, entries.use)
    pixels = array.render(frame.config, frame.splats, work, r.background)
    return replace(frame, entries=entries, pixels=pixels)


def analyse(frame: pipeline.Frame, z: np.ndarray) -> dict[str, object]:
    """The numbers of order.json for a frame, given the float64 z (N,) of its Gaussians."""
    first = neighbours(frame.entries.start)
    near, far = frame.entries.splat[first], frame.entries.splat[first + 1]
    key, own = frame.projected.depth_key, machine_z(frame)
    saturated = np.minimum(key[near], key[far]) == frame.config.formats.depth_key.raw_max
    backward, truly = own[near] > own[far], z[near] > z[far]
    exact = reordered(frame, z)
    difference = np.abs(np.clip(frame.image, 0, 1) - np.clip(exact.image, 0, 1)).max(axis=2)
    y, x = np.unravel_index(int(difference.argmax()), difference.shape)
    return {
        "entries": len(frame.entries.splat), "neighbours": len(first),
        "machine_inversions": int((backward & ~saturated).sum()), "saturated_inversions": int((backward & saturated).sum()),
        "equal_keys": int((key[near] == key[far]).sum()), "float64_inversions": int(truly.sum()),
        "largest_gap": float(((z[near] - z[far]) / z[near])[truly].max()) if truly.any() else 0.0,
        "max_abs_error": max_abs_error(frame.image, exact.image), "worst_pixel": [int(x), int(y)],
        "changed_pixels": int((difference > 0).sum()), "pixels": difference.size,
        "psnr_db": psnr_vs(frame.image, exact.image),
    }


def _arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    parser = command_parser("python -m msv2.cases.inversions", __doc__, EPILOG)
    add_request_arguments(parser)
    parser.set_defaults(camera=ORBIT, levels_from=RANDOM)
    add_config_arguments(parser, "paper", ", the widest rows")
    parser.add_argument("--out", metavar="DIR", help="output folder (default: build/order/NAME)")
    return parser.parse_args(argv)


def report(request: Request, config: AcceleratorConfig) -> dict[str, object]:
    """The content of order.json for a request."""
    frame = pipeline.render(
        request.model, request.camera, config=config, foveation=request.foveation, background=request.background)
    machine = {"config": config.name, "configuration": config_record(config)}
    return {**request.record, **machine, **analyse(frame, float64_z(request.model, request.camera))}


def main(argv: Sequence[str] | None = None) -> int:
    """Runs the command line; returns 1 when the machine's order is not that of its own z."""
    args = _arguments(argv)
    config = config_from(args)
    request = resolve(args)
    with output_folder(args.out, BUILD / "order" / request.model.name) as out:
        numbers = report(request, config)
        write_json(out / "order.json", numbers)
    print(f"{out}: {numbers['entries']:,} intersections, {numbers['machine_inversions']} inversions by the machine's z, "
          f"{numbers['float64_inversions']:,} by float64 z, which change a pixel by {numbers['max_abs_error']:.3g} at most")
    return int(numbers["machine_inversions"] > 0)


if __name__ == "__main__":
    run_command_line(main)
