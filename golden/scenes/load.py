"""A scene by path or name: the one door through which models come in."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from golden.scenes.camera import Camera
from golden.scenes.clean import concatenate
from golden.scenes.datasets import cameras_beside_model
from golden.scenes.model import GaussianModel
from golden.scenes.packed import load_compressed_ply, load_sog, load_spz
from golden.scenes.ply import MAX_HEADER, load_ply, parse_header
from golden.scenes.splat import load_splat
from spec.errors import InputError

EMBEDDED = "embedded"
ACCEPTED = "3DGS or compressed PLY, .spz, .sog, a SOG folder or its meta.json, a folder of such, .splat, a training folder"


@dataclass(frozen=True)
class Scene:
    """A model and the cameras that came with it.

    Attributes:
        model: the Gaussians.
        cameras: the cameras beside the model, in file order; empty where there are none (then: `orbit.orbit_camera`).
    """

    model: GaussianModel
    cameras: tuple[Camera, ...] = ()


def load_scene(name_or_path: Path | str) -> Scene:
    """The model at a path with the cameras in its folder, or the project's own scene for the name `embedded`.

    Raises:
        InputError: as `load_model`; or the cameras beside the model are malformed.
    """
    if str(name_or_path) == EMBEDDED:  # a folder of that name is ./embedded
        from golden.scenes.embedded import scene  # compiles a ray tracer

        return Scene(scene.cached_embedded_model(), tuple(scene.embedded_cameras()))
    path = Path(name_or_path)
    return Scene(load_model(path), cameras_beside_model(path))


def load_model(path: Path | str) -> GaussianModel:
    """The model in a file or folder; its format is told by content first, by extension for .splat, which has no magic number.

    Args:
        path: PLY (3DGS of SH degree 0-3, foveated or not; or compressed), SPZ, SOG (bundle, folder or meta.json), .splat; a
            folder of SOG folders is one scene, concatenated in name order; of a training folder (`point_cloud/iteration_*`) the
            last iteration; of any other folder its only model file.

    Returns:
        The model in the project's conventions; splats that cannot be drawn are dropped and counted in `dropped`.

    Raises:
        InputError: missing, empty, truncated or mistyped file, or values out of range; the message names file, value and what
            is accepted.
    """
    path = Path(path)
    if path.is_dir():
        return _load_folder(path)
    if not path.exists():
        raise InputError(f"{path}: does not exist; accepted: {ACCEPTED}, or the name {EMBEDDED!r}")
    if path.name == "meta.json":
        return load_sog(path, path.absolute().parent.name)
    return _reader(path)(path, path.name.split(".")[0] or path.name)


def _reader(path: Path) -> Callable[[Path, str], GaussianModel]:
    """The reader for a file's content."""
    try:
        with open(path, "rb") as file:
            head = file.read(MAX_HEADER)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); accepted: {ACCEPTED}") from error
    if not head:
        raise InputError(f"{path}: is empty (0 bytes); accepted: {ACCEPTED}")
    if head.startswith((b"ply\n", b"ply\r\n")) or path.suffix.lower() == ".ply":
        return load_compressed_ply if parse_header(head, path).compressed else load_ply
    if head.startswith((b"\x1f\x8b", b"NGSP")) or path.suffix.lower() == ".spz":
        return load_spz
    if head.startswith(b"PK\x03\x04") or path.suffix.lower() == ".sog":
        return load_sog
    if path.suffix.lower() == ".splat":
        return load_splat
    raise InputError(f"{path}: starts with {head[:8]!r}, which is no known model format; accepted: {ACCEPTED}")


def _load_folder(path: Path) -> GaussianModel:
    name = path.absolute().name
    if (path / "meta.json").exists():
        return load_sog(path, name)
    parts = sorted(folder for folder in path.iterdir() if (folder / "meta.json").is_file())
    if parts:
        return concatenate([load_sog(part, part.name) for part in parts], name)
    iterations = [p for p in path.glob("point_cloud/iteration_*/point_cloud.ply") if p.parent.name[10:].isdigit()]
    if iterations:
        return replace(load_model(max(iterations, key=lambda p: int(p.parent.name[10:]))), name=name)
    files = sorted(p for p in path.iterdir() if p.suffix.lower() in (".ply", ".spz", ".sog", ".splat"))
    if len(files) != 1:
        raise InputError(f"{path}: a folder with {len(files)} model files; accepted: {ACCEPTED}, a folder with one model")
    return load_model(files[0])
