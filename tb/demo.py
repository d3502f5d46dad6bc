"""`python -m tb.demo`: the main job on the embedded scene, from model to RTL frame, bit-compared, with pictures and a table."""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from golden.metrics.image import max_abs_error, psnr_vs
from golden.msv2_ref import pipeline
from golden.oracle.render import OracleFrame
from golden.oracle.render import render as render_oracle
from golden.scenes.embedded import cached_embedded_model, embedded_cameras, render_reference
from golden.scenes.gaze import Display, FoveationMap, foveation_map
from golden.scenes.levels import smfr_levels
from golden.scenes.pictures import depth_picture, levels_picture, save_png, to_bytes
from golden.scenes.request import make_folder, write_json
from spec.config import DEFAULT
from spec.errors import run_command_line
from tb.common.runner import ROOT, SimulationError
from tb.frame.__main__ import simulate_frame

SIZE = (256, 256)
GAZE = (128.0, 128.0)
ERROR_GAIN = 64
"""The difference picture shows golden - oracle times this."""


@contextmanager
def step(name: str):
    """Prints a step's name, and the seconds it took when it is done."""
    print(f"  {name:<58}", end="", flush=True)
    begin = time.perf_counter()
    yield
    print(f"{time.perf_counter() - begin:7.1f} s", flush=True)


def heat_picture(frame: pipeline.Frame) -> np.ndarray:
    """(H, W, 3) float: entries of each tile, log scale, black to white over red and yellow."""
    r = frame.registers
    counts = np.diff(frame.entries.start).reshape(r.tiles_y, r.tiles_x)
    heat = np.log1p(counts) / np.log1p(max(counts.max(), 1))
    colour = np.clip(np.stack([3 * heat, 3 * heat - 1, 3 * heat - 2], axis=-1), 0, 1)
    return np.kron(colour, np.ones((16, 16, 1)))[: r.height, : r.width]


def panel_picture(panels: list[tuple[str, np.ndarray]], columns: int) -> np.ndarray:
    """Panels of one size with captions, `columns` to a row, as one uint8 picture."""
    height, width = panels[0][1].shape[:2]
    caption, rows = 18, -(-len(panels) // columns)
    sheet = Image.new("RGB", (columns * width, rows * (height + caption)), "white")
    draw = ImageDraw.Draw(sheet)
    for i, (title, image) in enumerate(panels):
        x, y = i % columns * width, i // columns * (height + caption)
        draw.text((x + 4, y + 3), title, fill="black")
        sheet.paste(Image.fromarray(to_bytes(image)), (x, y + caption))
    return np.asarray(sheet)


def print_table(rows: list[tuple[str, str]]) -> None:
    """Two aligned columns."""
    width = max(len(name) for name, _ in rows)
    print("\n" + "\n".join(f"  {name:<{width}}  {value}" for name, value in rows))


def demo_panels(
    photo: np.ndarray, oracle: OracleFrame, golden: pipeline.Frame, rtl: pipeline.Frame, foveation: FoveationMap,
) -> list[tuple[str, np.ndarray]]:
    """Captioned pictures of every stage."""
    return [
        ("ray-traced reference", photo), ("oracle (float64)", oracle.image), ("golden (integer)", golden.image),
        ("RTL (Verilator)", rtl.image), (f"|golden - oracle| x {ERROR_GAIN}", ERROR_GAIN * np.abs(golden.image - oracle.image)),
        ("tile levels and blend tiles", levels_picture(golden.image, foveation)), ("depth (RTL)", depth_picture(rtl.depth)),
        ("entries per tile (log)", heat_picture(golden)),
    ]


def summary(gaussians: int, n: dict[str, object]) -> list[tuple[str, str]]:
    """The table's rows, from demo.json's numbers."""
    return [
        ("Gaussians, entries, tiles", f"{gaussians:,}, {n['entries']:,}, {n['tiles']:,}"),
        ("golden against oracle", f"{n['psnr_golden_vs_oracle_db']:.1f} dB, worst {n['max_error_golden_vs_oracle']:.4f}"),
        ("oracle against ray tracing", f"{n['psnr_oracle_vs_reference_db']:.1f} dB (levels are random subsets, untrained)"),
        ("RTL against golden", f"{'equal' if n['bit_exact'] else 'NOT equal'} in every bit, {n['pixels_checked']:,} pixels"),
        ("array cycles", f"{n['cycles']:,}, {n['cycles'] / max(n['entries'], 1):.2f} an entry"),
        ("simulation speed", f"{n['cycles_per_s']:,} cycles/s"),
    ]


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work; 1 when the RTL differs from the golden renderer in any bit."""
    parser = argparse.ArgumentParser(prog="python -m tb.demo", description=__doc__)
    parser.add_argument("--out", default=ROOT / "build" / "demo", metavar="DIR", help="output folder (default: build/demo)")
    out = make_folder(Path(parser.parse_args(argv).out))
    begin = time.perf_counter()
    print(f"embedded scene, {SIZE[0]}x{SIZE[1]}, gaze in the centre, 4 levels, machine '{DEFAULT.name}'")
    with step("embedded scene: trace surfaces, make the Gaussian model"):
        model = smfr_levels(cached_embedded_model())
        camera = embedded_cameras(*SIZE)[0]
        foveation = foveation_map(Display(*SIZE), GAZE, model.levels)
    with step("ray-trace the reference picture"):
        photo = render_reference(camera)[0]
    with step("oracle: float64 renderer"):
        oracle = render_oracle(model, camera, foveation=foveation, weights="plane")
    with step("golden: integer renderer"):
        golden = pipeline.render(model, camera, config=DEFAULT, foveation=foveation)
    print("  RTL: build the simulator, then simulate the frame", flush=True)
    try:
        numbers, rtl = simulate_frame(DEFAULT, golden, out / "sim")
    except SimulationError as error:
        print(f"FAILED: {error}")
        return 1

    panels = demo_panels(photo, oracle, golden, rtl, foveation)
    save_png(out / "demo.png", panel_picture(panels, 4))
    save_png(out / "frame.png", rtl.image)
    numbers |= {"psnr_golden_vs_oracle_db": psnr_vs(golden.image, oracle.image), "seconds": time.perf_counter() - begin,
                "max_error_golden_vs_oracle": max_abs_error(golden.image, oracle.image),
                "psnr_oracle_vs_reference_db": psnr_vs(oracle.image, photo.astype(np.float64))}
    write_json(out / "demo.json", numbers)
    print_table([*summary(len(model), numbers), ("pictures", f"{out}/demo.png")])
    return 0 if numbers["bit_exact"] else 1


if __name__ == "__main__":
    run_command_line(main)
