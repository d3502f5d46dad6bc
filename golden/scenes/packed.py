"""Formats that are read through the package gsply: compressed PLY (PlayCanvas), SPZ (Niantic) and SOG (versions 1 and 2)."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from golden.scenes.clean import Fields, build_model
from golden.scenes.conventions import UP_BY_FORMAT, sigmoid
from golden.scenes.expansion import check_expansion, check_gzip, check_sog, check_spz_streams
from golden.scenes.files import read_bytes, require_package
from golden.scenes.model import GaussianModel
from golden.scenes.orbit import estimate_up
from golden.scenes.ply import parse_header, read_vertices
from spec.errors import InputError
from spec.extras import how_to_get

SPZ_VERSIONS = (2, 3, 4)
SMALLEST_SPLAT = 19  # bytes of a splat in an SPZ without harmonics, decoded
CHUNK = 256  # splats that share one row of bounds in a compressed PLY


def load_compressed_ply(path: Path, name: str) -> GaussianModel:
    """Loads the model in a compressed PLY file.

    Raises:
        InputError: the file is truncated or of another layout, or the extra `models` is not installed.
    """
    data = read_bytes(path)
    header = parse_header(data, path)
    splats = len(read_vertices(path, data, header))
    chunks = header.elements.get("chunk", (0, None))[0]
    if chunks != -(-splats // CHUNK):
        raise InputError(f"{path}: {chunks} chunks for {splats} splats; one per {CHUNK} is accepted")
    need = header.size + sum(count * row.itemsize for count, row in header.elements.values())
    if len(data) < need:
        raise InputError(f"{path}: {len(data)} bytes where the header promises {need} (truncated?)")
    return _load(path, name, "compressed ply", lambda gsply: gsply.plyread(path))


def load_spz(path: Path, name: str) -> GaussianModel:
    """Loads the model in an SPZ file of version 2, 3 or 4. (Version 1 stores half-float positions and is no longer written.)

    Raises:
        InputError: the file is truncated or of another version, has bytes behind its end, breaks the budget of
            `golden.scenes.expansion`, or the extra `models` is not installed.
    """
    data = read_bytes(path)
    try:
        head = zlib.decompressobj(31).decompress(data, 16) if data.startswith(b"\x1f\x8b") else data[:16]
        magic, version = struct.unpack_from("<4sI", head)
    except (zlib.error, struct.error) as error:
        raise InputError(f"{path}: is not a whole SPZ file ({error})") from error
    if magic != b"NGSP" or version not in SPZ_VERSIONS:
        raise InputError(f"{path}: is {magic!r} version {version}; b'NGSP' version {SPZ_VERSIONS} is accepted")
    (splats,) = struct.unpack_from("<I", head.ljust(12, b"\0"), 8)
    check_expansion(path, len(data), splats * SMALLEST_SPLAT)
    if data.startswith(b"\x1f\x8b"):
        check_gzip(path, data)
    else:
        check_spz_streams(path, data)
    return _load(path, name, "spz", lambda gsply: gsply.read_spz(path))


def load_sog(path: Path, name: str) -> GaussianModel:
    """Loads the model in a SOG folder, its meta.json, or a .sog bundle.

    The format does not say which axis points up, so the direction is estimated from the ground in the scene.

    Raises:
        InputError: a part is missing, truncated or of another version, the SOG breaks the budget of `golden.scenes.expansion`,
            or the extra `models` is not installed.
    """
    return sog_model(read_sog(path), path, name)


def read_sog(path: Path) -> Fields:
    """The fields of every splat of a SOG folder, its meta.json, or a .sog bundle, in the order of the file and unchecked.

    Raises:
        InputError: see `load_sog`.
    """
    check_sog(path)
    return _fields(path, "sog", lambda gsply: gsply.sogread(path))


def sog_model(fields: Fields, path: Path, name: str) -> GaussianModel:
    """The model of the fields of a SOG.

    Raises:
        InputError: no splat can be drawn.
    """
    return estimate_up(build_model(fields, path=path, name=name, up=UP_BY_FORMAT["sog"], up_source="sog"))


def _load(path: Path, name: str, kind: str, read: Callable[[Any], Any]) -> GaussianModel:
    return build_model(_fields(path, kind, read), path=path, name=name, up=UP_BY_FORMAT[kind], up_source=kind)


def _fields(path: Path, kind: str, read: Callable[[Any], Any]) -> Fields:
    """The fields of what `read` returns when it is called with gsply: arrays in PLY conventions, opacities as logits."""
    gsply = require_package("gsply", f"reading {path}")
    try:
        splats = read(gsply)
    except ImportError as error:
        raise InputError(f"{path}: {str(error).splitlines()[0]}; {how_to_get('imagecodecs')}") from error
    except Exception as error:  # gsply and its codecs raise exceptions of many types; each of them means a bad file here
        raise InputError(f"{path}: is not a whole {kind.upper()} ({error})") from error
    means = np.asarray(splats.means, np.float64)
    return Fields(
        means=means, log_scales=np.asarray(splats.scales, np.float64), quats=np.asarray(splats.quats, np.float64),
        opacity=sigmoid(splats.opacities).reshape(-1, 1), sh_dc=np.asarray(splats.sh0, np.float64).reshape(-1, 1, 3),
        sh_rest=np.zeros((len(means), 0, 3)) if splats.shN is None else np.asarray(splats.shN, np.float64),
    )
