"""Loads a scene by path or by name. Every model enters the project through `load_scene` or `load_model`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from golden.scenes.camera import Camera
from golden.scenes.clean import concatenate
from golden.scenes.datasets import cameras_beside_model
from golden.scenes.embedded.trained import NAME as TRAINED
from golden.scenes.embedded.trained import load_trained
from golden.scenes.embedded.views import embedded_cameras
from golden.scenes.model import GaussianModel
from golden.scenes.packed import load_compressed_ply, load_sog, load_spz
from golden.scenes.ply import MAX_HEADER, load_ply, parse_header
from golden.scenes.splat import load_splat
from golden.scenes.streamed import Detail, load_streamed, streamed_index
from spec.errors import InputError

EMBEDDED = "embedded"
PROJECT_SCENES = (EMBEDDED, TRAINED)
"""The scenes that come with the project, as a user names them: the procedural model, and one trained from pictures of the same
room, with foveation levels. Their cameras are the same and stand on an orbit."""

ACCEPTED = ("3DGS or compressed PLY, .spz, .sog, a SOG folder or its meta.json, a folder of such, a streamed SOG, .splat, "
            "a training folder")


@dataclass(frozen=True)
class Scene:
    """A model and the cameras that were stored with it.

    Attributes:
        model: the Gaussians.
        cameras: the cameras beside the model, in file order; empty where there are none. `orbit.orbit_camera` then makes one.
        detail: which level of detail of a streamed SOG the model is; None for all other models.
    """

    model: GaussianModel
    cameras: tuple[Camera, ...] = ()
    detail: Detail | None = None


def load_scene(name_or_path: Path | str, lod: int | None = None) -> Scene:
    """Loads the model at a path and the cameras in its folder. The names of PROJECT_SCENES stand for the project's own scenes.

    Args:
        name_or_path: the scene.
        lod: the level of detail of a streamed SOG; None for the finest.

    Raises:
        InputError: as for `load_model`; or the cameras beside the model are malformed, or a level of detail is asked of a model
            that has none.
    """
    path, name = Path(name_or_path), str(name_or_path)  # a folder of a project scene's name can still be given as ./NAME
    index = None if name in PROJECT_SCENES else streamed_index(path)
    if lod is not None and index is None:
        raise InputError(f"level of detail {lod} is not accepted: {name_or_path} is no streamed SOG, so it has only one")
    if name == EMBEDDED:
        from golden.scenes.embedded import scene  # imported only here because it compiles a ray tracer

        return Scene(scene.cached_embedded_model(), tuple(scene.embedded_cameras()))
    if name == TRAINED:
        return Scene(load_trained(), tuple(embedded_cameras()))
    if index is not None:
        model, detail = load_streamed(index, lod)
        return Scene(model, cameras_beside_model(path), detail)
    return Scene(load_model(path), cameras_beside_model(path))


def load_model(path: Path | str) -> GaussianModel:
    """Loads the model in a file or folder.

    The file's content tells its format. Only .splat, which has no magic number, is told by its extension.

    Args:
        path: a PLY (3DGS of SH degree 0-3, with or without foveation levels, or PlayCanvas' compressed layout), SPZ, SOG
            (bundle, folder or meta.json) or .splat file, or a folder. A folder of SOG folders is one scene, concatenated in
            name order; of a streamed SOG (`lod-meta.json`) the finest level of detail is read. Of a training folder
            (`point_cloud/iteration_*`) the last iteration is read. Any other folder must hold exactly one model file.

    Returns:
        The model in the project's conventions. Splats that cannot be drawn are left out and counted in `dropped`.

    Raises:
        InputError: the file is missing, empty, truncated or of an unknown type, or holds values out of range. The message names
            the file, the value and what is accepted.
    """
    path = Path(path)
    if (index := streamed_index(path)) is not None:
        return load_streamed(index)[0]
    if path.is_dir():
        return _load_folder(path)
    if not path.exists():
        raise InputError(f"{path}: does not exist; accepted: {ACCEPTED}, or the names {', '.join(PROJECT_SCENES)}")
    if path.name == "meta.json":
        return load_sog(path, path.absolute().parent.name)
    return _reader(path)(path, path.name.split(".")[0] or path.name)


def _reader(path: Path) -> Callable[[Path, str], GaussianModel]:
    """The function that reads a file of this content."""
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
