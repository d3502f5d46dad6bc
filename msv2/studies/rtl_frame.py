"""Runs frames through the RTL with `python -m tb.frame`, one process per frame. Results are kept under keys that cover all
their inputs."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from golden.scenes.camera import Camera
from golden.scenes.camera_file import save_camera
from golden.scenes.camera_options import ORBIT
from golden.scenes.files import read_json
from golden.scenes.model import GaussianModel
from golden.scenes.request import make_folder
from golden.scenes.save import save_model
from msv2.studies.kept import fingerprint
from msv2.studies.record import source_hash
from spec.errors import InputError
from spec.paths import ROOT
from spec.private import locked

COMMAND = "tb.frame.__main__"
"""The module behind `python -m tb.frame`."""

INSIDE, AWAY = "inside", "away"
"""The names of cameras that are made for single frames: inside the model, and one that sees nothing of it. Reports hold the
name alone, so that such a frame cannot be made again from its report."""


def simulate(scene: str, options: Sequence[str], out: Path) -> dict[str, object]:
    """Simulates a frame and returns its numbers. The pictures are written to `out`.

    Args:
        scene: the scene argument of `python -m tb.frame`.
        options: the other arguments of that command; without --camera, the frame is the orbit's.
        out: the output folder.

    Raises:
        InputError: the simulation fails, or a bit or a counter differs from the golden renderer's.
    """
    pinned = () if "--camera" in options else ("--camera", ORBIT)  # reports keep their cameras
    command = [sys.executable, "-m", "tb.frame", scene, *pinned, *options, "--out", str(out.resolve())]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode or not (out / "frame.json").exists():
        last = (done.stderr.strip() or done.stdout.strip() or "no message").splitlines()[-1]
        raise InputError(f"{' '.join(command[1:])}: exit status {done.returncode}: {last}")
    return numbers(out)


def numbers(folder: Path) -> dict[str, object]:
    """The numbers of a frame that was simulated earlier.

    Raises:
        InputError: a bit or a counter differs from the golden renderer's.
    """
    found = read_json(folder / "frame.json")
    if not found["bit_exact"] or found.get("counter_errors"):
        raise InputError(f"{folder / 'frame.json'}: the RTL differs from the golden renderer; its cycles mean nothing")
    return found


def kept_frame(folder: Path, scene: str, options: Sequence[str], *, again: bool = False) -> dict[str, object]:
    """The numbers of a frame. It is simulated if `folder` has none with the same scene, options and sources, or with
    `again`."""
    path = Path(scene)
    file = (path.stat().st_size, path.stat().st_mtime_ns) if path.exists() else None
    out = folder / f"frame-{fingerprint((), source_hash([COMMAND]), scene, file, *options)}"
    with locked(make_folder(folder) / f"{out.name}.lock"):  # another process that wants the same frame waits for it
        return numbers(out) if (out / "frame.json").exists() and not again else simulate(scene, options, make_folder(out))


def model_frame(folder: Path, model: GaussianModel, camera: Camera, options: Sequence[str]) -> dict[str, object]:
    """The same for a model and a camera, which are written to files for the command; the key covers their contents."""
    out = folder / f"frame-{fingerprint((), source_hash([COMMAND]), model, camera, *options)}"
    with locked(make_folder(folder) / f"{out.name}.lock"):
        if (out / "frame.json").exists():
            return numbers(out)
        scene, seen = make_folder(out).resolve() / "model.ply", out.resolve() / "camera.json"
        save_model(model, scene)
        save_camera(camera, seen)
        found = simulate(str(scene), ["--camera", str(seen), "--size", f"{camera.width}x{camera.height}", *options], out)
        scene.unlink()  # the file is large and easily made again
        return found
