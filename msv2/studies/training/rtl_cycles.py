"""Cycles of the RTL: a frame of a model through `python -m tb.frame`, a process of its own, kept by what it was made of."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from golden.scenes.camera import Camera
from golden.scenes.camera_file import save_camera
from golden.scenes.files import read_json
from golden.scenes.model import GaussianModel
from golden.scenes.request import make_folder
from golden.scenes.save import save_model
from spec.errors import InputError
from spec.paths import ROOT

SOURCES = ("spec/*.py", "rtl/**/*.py", "golden/msv2_ref/*.py", "tb/frame/*.py", "tb/top/*.py", "tb/top/*.sv")
"""What the machine and its frames are made of: cycles are measured again where any of it has changed."""

OPTIONS = ("--config", "paper", "--machine", "full")
"""Of every frame: the machine whose golden cycles are beside."""


@dataclass(frozen=True)
class RtlCycles:
    """Cycles of a frame, bit-exact against the golden renderer.

    Attributes:
        geometry: of the tile table and the geometry phase.
        render: of the rendering phase.
        entries: (splat, tile) pairs.
    """

    geometry: int
    render: int
    entries: int

    @property
    def cycles(self) -> int:
        """Of the frame, without what the machine clears once after a reset."""
        return self.geometry + self.render


def rtl_cycles(model: GaussianModel, camera: Camera, folder: Path) -> RtlCycles:
    """Cycles of a frame of level 1.

    Args:
        folder: for the model, the camera and what was measured before, in a folder a frame.

    Raises:
        InputError: the simulation fails or a bit differs.
    """
    folder = make_folder(folder)
    save_model(model, folder / "model.ply")
    save_camera(camera, folder / "camera.json")
    kept = folder / f"rtl-{_key(folder)}"
    if not (kept / "frame.json").exists():
        _simulate(folder, camera, make_folder(kept))
    numbers = read_json(kept / "frame.json")
    if not numbers["bit_exact"] or numbers["counter_errors"]:
        raise InputError(f"{kept / 'frame.json'}: the RTL differs from the golden renderer; its cycles mean nothing")
    return RtlCycles(numbers["table_cycles"] + numbers["geometry_cycles"], numbers["render_cycles"], numbers["entries"])


def _key(folder: Path) -> str:
    digest = hashlib.sha256(repr(OPTIONS).encode())
    for path in (folder / "model.ply", folder / "camera.json", *sorted(p for each in SOURCES for p in ROOT.glob(each))):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def _simulate(folder: Path, camera: Camera, out: Path) -> None:
    command = [sys.executable, "-m", "tb.frame", str((folder / "model.ply").resolve()),
               "--camera", str((folder / "camera.json").resolve()), "--size", f"{camera.width}x{camera.height}",
               "--out", str(out.resolve()), *OPTIONS]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode or not (out / "frame.json").exists():
        last = (done.stderr.strip() or done.stdout.strip() or "no message").splitlines()[-1]
        raise InputError(f"{' '.join(command)}: exit status {done.returncode}: {last}")
