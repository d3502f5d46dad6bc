"""Reads PLY files: the header, the vertex table, and the INRIA trainer's layout of Gaussians with this project's foveation
properties.

A foveated file is an ordinary 3DGS file whose standard properties hold level 1. After them come the properties of the levels.
They are all `float`, because many readers accept nothing else:

- `quality_bound`: the highest level that uses the splat, 1..levels;
- `opacity_l1` .. `opacity_lL`: the amplified opacity of each level, stored as it is because it may exceed 1 and then has no
  logit;
- `f_dc_0_l2` .. `f_dc_2_lL`: the DC coefficients of the levels above 1.

The comment `up X Y Z` gives the scene's up direction; after it, the comment `up_source FORMAT` says that it is only the habit
of a format. In a foveated file, this project does not use `opacity`; the property is
there for other tools.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from golden.scenes.clean import Fields, build_model, check_not_activated
from golden.scenes.conventions import UP_BY_FORMAT, sh_rest_from_ply, sigmoid
from golden.scenes.files import read_bytes
from golden.scenes.model import MAX_LEVELS, SH_REST_COUNT, GaussianModel
from spec.constants import AMP_MAX
from spec.errors import InputError

TYPES = {
    "char": "i1", "int8": "i1", "uchar": "u1", "uint8": "u1", "short": "i2", "int16": "i2", "ushort": "u2", "uint16": "u2",
    "int": "i4", "int32": "i4", "uint": "u4", "uint32": "u4", "float": "f4", "float32": "f4", "double": "f8", "float64": "f8",
}
BYTE_ORDERS = {"binary_little_endian": "<", "binary_big_endian": ">", "ascii": "="}
MAX_HEADER = 1 << 20  # bytes; a 3DGS header has about 2,000


@dataclass(frozen=True)
class Header:
    """A PLY header.

    Attributes:
        encoding: `ascii`, `binary_little_endian` or `binary_big_endian`.
        elements: for each element's name, in file order, the number of rows and the row's type (None for rows of varying
            length).
        comments: the text of each comment line.
        size: length of the header in bytes; the first row follows it.
    """

    encoding: str
    elements: dict[str, tuple[int, np.dtype | None]]
    comments: list[str]
    size: int

    @property
    def compressed(self) -> bool:
        """Whether the rows are the packed words of PlayCanvas' compressed PLY."""
        dtype = self.elements.get("vertex", (0, None))[1]
        return dtype is not None and "packed_position" in dtype.names


def parse_header(data: bytes, path: Path) -> Header:
    """Parses the header at the start of a PLY file.

    Args:
        data: the file's content.
        path: the file, for messages.

    Raises:
        InputError: the data is not a PLY file, or its header is truncated or malformed.
    """
    match = re.match(rb"ply\r?\n.*?^end_header\r?\n", data[:MAX_HEADER], re.DOTALL | re.MULTILINE)
    if match is None:
        what = "has no end of header (truncated?)" if data.startswith(b"ply") else f"starts with {data[:8]!r}"
        raise InputError(f"{path}: {what}; a PLY file is needed")
    encoding, elements, comments = "", {}, []
    for line in match.group().decode("ascii", "replace").splitlines()[1:-1]:
        match line.split():
            case ["format", word, "1.0"] if word in BYTE_ORDERS:
                encoding = word
            case ["comment" | "obj_info", *_] as words:
                comments.append(" ".join(words[1:]))
            case ["element", name, count] if count.isdigit() and len(count) < 16 and name not in elements:
                elements[name] = (int(count), [])
            case ["property", "list", _, _, _] if elements:
                elements[next(reversed(elements))][1].append(None)
            case ["property", kind, name] if elements and kind in TYPES:
                elements[next(reversed(elements))][1].append((name, BYTE_ORDERS.get(encoding, "<") + TYPES[kind]))
            case []:
                pass
            case _:
                raise InputError(f"{path}: header line {line!r} is not understood; PLY 1.0 is accepted")
    if not encoding:
        raise InputError(f"{path}: no 'format' line; accepted: {', '.join(BYTE_ORDERS)} 1.0")
    return Header(encoding, {name: (n, _row_type(p, path)) for name, (n, p) in elements.items()}, comments, match.end())


def _row_type(properties: list[tuple[str, str] | None], path: Path) -> np.dtype | None:
    if None in properties:
        return None
    names = [name for name, _ in properties]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{path}: property {name!r} appears {names.count(name)} times; once is accepted")
    return np.dtype(properties)


def read_vertices(path: Path, data: bytes, header: Header) -> np.ndarray:
    """Returns the `vertex` element as an (N,) structured array with a field for each property, in the file's types.

    Raises:
        InputError: there are no vertices, there are list properties in `vertex` or before it, or the file holds fewer bytes or
            numbers than the header announces.
    """
    if "vertex" not in header.elements:
        raise InputError(f"{path}: elements are {list(header.elements)}; 'vertex' is needed")
    count, dtype = header.elements["vertex"]
    before = list(header.elements.values())[: list(header.elements).index("vertex")]
    if dtype is None or any(row is None for _, row in before):
        raise InputError(f"{path}: list properties in or before 'vertex' are not accepted")
    if count == 0 or not dtype.names:
        raise InputError(f"{path}: {count} vertices of {len(dtype.names or ())} properties; at least one of each is needed")
    if header.encoding == "ascii":
        return _ascii_rows(path, data[header.size :], sum(n * len(row.names) for n, row in before), count, dtype)
    start = header.size + sum(n * row.itemsize for n, row in before)
    if len(data) - start < count * dtype.itemsize:
        raise InputError(
            f"{path}: {count} vertices of {dtype.itemsize} bytes need {count * dtype.itemsize} bytes, "
            f"{max(0, len(data) - start)} are left (truncated?)"
        )
    return np.frombuffer(data, dtype, count, start)


def _ascii_rows(path: Path, text: bytes, skip: int, count: int, dtype: np.dtype) -> np.ndarray:
    words = text.split(maxsplit=skip + count * len(dtype.names))[skip : skip + count * len(dtype.names)]
    try:
        table = np.array(words, np.float64).reshape(count, len(dtype.names))
    except ValueError as error:
        raise InputError(f"{path}: {count} vertices of {len(dtype.names)} numbers are announced ({error})") from error
    rows = np.empty(count, dtype)
    for column, name in enumerate(dtype.names):
        rows[name] = table[:, column]
    return rows


def load_ply(path: Path, name: str) -> GaussianModel:
    """Loads an INRIA PLY file (SH degree 0-3, properties in any order), with or without foveation levels.

    Args:
        path: the file.
        name: the model's name.

    Raises:
        InputError: anything is wrong with the file; the message names it, the value and what is accepted.
    """
    data = read_bytes(path)
    header = parse_header(data, path)
    vertices = read_vertices(path, data, header)
    levels = _level_count(path, vertices.dtype.names)
    dc = [_columns(path, vertices, [f"f_dc_{c}" + (f"_l{level}" if level > 1 else "") for c in range(3)])
          for level in range(1, max(levels, 1) + 1)]
    log_scales = _columns(path, vertices, [f"scale_{i}" for i in range(3)])
    logits = _columns(path, vertices, ["opacity"])
    if levels:
        opacity, bound = _level_fields(path, vertices, levels)
    else:
        check_not_activated(path, logits[:, 0], log_scales)
        opacity, bound = sigmoid(logits), None
    fields = Fields(
        means=_columns(path, vertices, ["x", "y", "z"]), log_scales=log_scales,
        quats=_columns(path, vertices, [f"rot_{i}" for i in range(4)]), opacity=opacity, sh_dc=np.stack(dc, axis=1),
        sh_rest=sh_rest_from_ply(_columns(path, vertices, _rest_names(path, vertices.dtype.names))), quality_bound=bound,
    )
    up, source = _up(header.comments)
    return build_model(fields, path=path, name=name, up=up, up_source=source)


def _columns(path: Path, vertices: np.ndarray, names: list[str]) -> np.ndarray:
    """The named properties as an (N, len(names)) float64 array."""
    missing = [name for name in names if name not in vertices.dtype.names]
    if missing:
        raise InputError(f"{path}: property {missing[0]!r} is missing; a 3DGS file has x y z, f_dc_*, opacity, scale_*, rot_*")
    columns = np.empty((len(vertices), len(names)))
    for i, name in enumerate(names):
        columns[:, i] = vertices[name]
    return columns


def _rest_names(path: Path, properties: tuple[str, ...]) -> list[str]:
    """The names of the `f_rest` properties in order; their number must be that of an SH degree."""
    found = {name for name in properties if name.startswith("f_rest_")}
    names = [f"f_rest_{i}" for i in range(len(found))]
    if set(names) != found or len(found) not in [3 * k for k in SH_REST_COUNT.values()]:
        raise InputError(f"{path}: {len(found)} f_rest properties; f_rest_0 to _8, _23, _44 or none")
    return names


def _level_count(path: Path, properties: tuple[str, ...]) -> int:
    """The number of foveation levels in the file; 0 for an ordinary 3DGS file."""
    found = {name for name in properties if re.fullmatch(r"opacity_l\d+", name)}
    if not found and "quality_bound" not in properties:
        return 0
    if not 1 <= len(found) <= MAX_LEVELS or found != {f"opacity_l{level + 1}" for level in range(len(found))}:
        raise InputError(f"{path}: level opacities are {sorted(found)}; opacity_l1 to opacity_l{MAX_LEVELS} are accepted")
    return len(found)


def _level_fields(path: Path, vertices: np.ndarray, levels: int) -> tuple[np.ndarray, np.ndarray]:
    """Amplified opacities (N, levels) float64 and quality bounds (N,) uint8, range-checked."""
    opacity = _columns(path, vertices, [f"opacity_l{level}" for level in range(1, levels + 1)])
    bound = _columns(path, vertices, ["quality_bound"])[:, 0]
    wrong = bound[~np.isin(bound, np.arange(1, levels + 1))]
    if wrong.size:
        raise InputError(f"{path}: quality_bound {wrong[0]:g} of {wrong.size} splats; whole numbers 1..{levels} are accepted")
    wrong = opacity[(opacity < 0) | (opacity > AMP_MAX)]
    if wrong.size:
        raise InputError(f"{path}: amplified opacity {wrong[0]:g} at {wrong.size} places; 0..{AMP_MAX:g} is accepted")
    return opacity, bound.astype(np.uint8)


def _up(comments: list[str]) -> tuple[np.ndarray, str]:
    """The up direction from a comment `up X Y Z`, or else the PLY format's own, and how it is known."""
    source = next((" ".join(words[1:]) for words in map(str.split, comments) if words[:1] == ["up_source"]), "given")
    for words in map(str.split, comments):
        if words[:1] == ["up"] and len(words) == 4:
            try:
                up = np.array(words[1:], np.float64)
            except ValueError:
                continue  # the comment is a sentence that happens to begin with "up"
            if np.isfinite(up).all() and up.any():
                return up / np.linalg.norm(up), source
    return np.array(UP_BY_FORMAT["ply"]), "ply"
