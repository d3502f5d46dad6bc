"""`msv2 demo`: the main job on the trained model of the embedded scene, from model to RTL frame, bit-compared, with pictures
and a table."""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from golden.metrics.image import max_abs_error, psnr_vs
from golden.msv2_ref import pipeline
from golden.oracle.render import OracleFrame
from golden.oracle.render import render as render_oracle
from golden.scenes.camera import Camera
from golden.scenes.embedded.scene import embedded_cameras, render_photograph
from golden.scenes.gaze import Display, FoveationMap, foveation_map, no_foveation
from golden.scenes.load import TRAINED, load_scene
from golden.scenes.model import GaussianModel
from golden.scenes.pictures import depth_picture, levels_picture, save_png, to_bytes
from golden.scenes.request import write_json
from spec.command_line import add_out_argument, command_parser
from spec.config import DEFAULT
from spec.errors import run_command_line
from spec.paths import BUILD
from spec.private import output_folder
from spec.progress import LiveLine, on_terminal
from tb.common.runner import SimulationError
from tb.frame.whole import simulate_machine, tiled
from tb.top import device
from tb.top.memory import MemorySpeed

SIZE = (256, 256)
GAZE = (128.0, 128.0)
ERROR_GAIN = 64
"""The difference picture shows golden - oracle times this."""


@contextmanager
def step(name: str):
    """Prints a step's name, and the seconds it took when it is done; on a terminal, the seconds so far until then."""
    title, live = f"  {name:<58}", on_terminal()
    if not live:
        print(title, end="", flush=True)
    begin = time.perf_counter()
    with LiveLine(lambda seconds: f"{title}{seconds:7.0f} s"):
        yield
    print(f"{title * live}{time.perf_counter() - begin:7.1f} s", flush=True)


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


@dataclass(frozen=True)
class Shot:
    """One frame all the way: oracle, golden, RTL."""

    oracle: OracleFrame
    golden: pipeline.Frame
    rtl: pipeline.Frame
    numbers: dict[str, object]


def take(name: str, model: GaussianModel, camera: Camera, foveation: FoveationMap, folder: Path) -> Shot:
    """Renders one frame three times; SimulationError where the simulator cannot be built."""
    with step(f"{name}: oracle (float64)"):
        oracle = render_oracle(model, camera, foveation=foveation, weights="plane")
    with step(f"{name}: golden (integers)"):
        golden = pipeline.render(model, camera, config=DEFAULT, foveation=foveation)
    print(f"  {name}: the machine (its simulator is built once, in a few minutes)", flush=True)
    numbers, pixels = simulate_machine(golden, device.machine(DEFAULT), folder, beta=None, speed=MemorySpeed())
    errors = {"psnr_golden_vs_oracle_db": psnr_vs(golden.image, oracle.image),
              "max_error_golden_vs_oracle": max_abs_error(golden.image, oracle.image)}
    return Shot(oracle, golden, replace(golden, pixels=tiled(golden, pixels)), {**numbers, **errors})


def panels(photo: np.ndarray, full: Shot, foveated: Shot, foveation: FoveationMap) -> list[tuple[str, np.ndarray]]:
    """Captioned pictures of every stage."""
    error = ERROR_GAIN * np.abs(full.golden.image - full.oracle.image)
    return [
        ("ray-traced reference", photo), ("oracle (float64)", full.oracle.image), ("the machine (RTL)", full.rtl.image),
        (f"|golden - oracle| x {ERROR_GAIN}", error), ("the machine, 4 trained levels", foveated.rtl.image),
        ("tile levels, blend tiles between", levels_picture(foveated.rtl.image, foveation)),
        ("depth (RTL)", depth_picture(full.rtl.depth)), ("entries per tile, foveated (log)", heat_picture(foveated.golden)),
    ]


def print_table(full: dict[str, object], foveated: dict[str, object], photo_db: float) -> None:
    """The demo's numbers, one column a frame."""
    rows = [("", "full quality", "foveated")]
    for title, show in (
        ("entries (splat, tile)", lambda n: f"{n['entries']:,}"),
        ("golden against oracle", lambda n: f"{n['psnr_golden_vs_oracle_db']:.1f} dB"),
        ("RTL against golden", lambda n: "equal in every bit" if n["bit_exact"] else f"{n['mismatches']} DIFFER"),
        ("counters against golden", lambda n: "all equal" if not n["counter_errors"] else f"{len(n['counter_errors'])} DIFFER"),
        ("cycles: geometry", lambda n: f"{n['geometry_cycles']:,}"),
        ("cycles: rendering", lambda n: f"{n['render_cycles']:,}"),
        ("at least, by what limits", lambda n: f"{n['bound_cycles']:,}, {max(n['bounds'], key=n['bounds'].get)}"),
        ("memory moved", lambda n: f"{(n['dram_bytes']['read'] + n['dram_bytes']['write']) / 1e6:.1f} MB"),
        ("simulated cycles/s", lambda n: f"{n['cycles_per_s']:,}"),
    ):
        rows.append((title, show(full), show(foveated)))
    print("\n" + "\n".join(f"  {a:<24}{b:>20}{c:>20}" for a, b, c in rows))
    print(f"\n  full quality against the ray-traced reference: {photo_db:.1f} dB")


def main(argv: Sequence[str] | None = None) -> int:
    """The command line's work; 1 when the RTL differs from the golden renderer in any bit."""
    parser = command_parser("python -m msv2.cli.demo", __doc__)
    add_out_argument(parser, "build/demo")
    with output_folder(parser.parse_args(argv).out, BUILD / "demo") as out:
        return _shown(out)


def _shown(out: Path) -> int:
    """Takes the frames, and writes their pictures and numbers into the folder `out`; the exit status."""
    begin = time.perf_counter()
    print(f"scene {TRAINED}, {SIZE[0]}x{SIZE[1]}, machine '{DEFAULT.name}'")
    with step("scene: read the trained model"):
        model, camera, display = load_scene(TRAINED).model, embedded_cameras(*SIZE)[0], Display(*SIZE)
    with step("scene: ray-trace the reference picture"):
        photo = render_photograph(camera).astype(np.float64)
    foveation = foveation_map(display, GAZE)
    try:
        full = take("full quality", model, camera, no_foveation(display), out / "sim")
        foveated = take("foveated", model, camera, foveation, out / "sim")
    except SimulationError as error:
        print(f"FAILED: {error}")
        return 1
    photo_db = psnr_vs(full.oracle.image, photo)
    save_png(out / "demo.png", panel_picture(panels(photo, full, foveated, foveation), 4))
    write_json(out / "demo.json", {"full": full.numbers, "foveated": foveated.numbers, "psnr_oracle_vs_reference_db": photo_db,
                                   "seconds": time.perf_counter() - begin})
    print_table(full.numbers, foveated.numbers, photo_db)
    print(f"  pictures: {out}/demo.png")
    good = all(shot.numbers["bit_exact"] and not shot.numbers["counter_errors"] for shot in (full, foveated))
    return 0 if good else 1


if __name__ == "__main__":
    run_command_line(main)
