"""Spoils bytes, JSON values and containers: what the fuzzer does to a good file.

Containers are opened, a member is spoilt, and they are closed again, so that what they hold is reached behind their checksums.
"""

from __future__ import annotations

import copy
import gzip
import io
import json
import struct
import zipfile
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np

WORDS: tuple[bytes, ...] = (
    *(struct.pack("<Q", value) for value in (
        0, 1, (1 << 31) - 1, 1 << 31, (1 << 32) - 1, 1 << 40, (1 << 63) - 1, (1 << 64) - 1)),
    *(struct.pack("<f", value) for value in (0.0, -0.0, 1e38, -1e38, 1e-45, float("inf"), float("-inf"), float("nan"))),
    *(struct.pack("<d", value) for value in (1e308, -1e308, 5e-324, float("inf"), float("nan"))))
"""Numbers that break readers, as bytes."""

VALUES: tuple[Any, ...] = (
    None, True, False, 0, 1, -1, 0.5, 1e38, -1e38, 1e308, float("nan"), float("inf"), 1 << 31, 1 << 63, 10**400, "", "x",
    "x" * 6000, "../../../../etc/passwd", "\0", "\ud800", [], [[]], [1] * 1000, {}, {"x": 1}, [[[[[[1]]]]]])
"""JSON values that break readers; json writes those that JSON lacks as NaN and Infinity, which Python's readers take."""

TOKENS = (
    b"-1", b"0", b"1", b"4294967296", b"1e400", b"nan", b"float", b"double", b"list", b"uchar", b"property", b"element", b"x")
"""Words for headers of text."""


def spoil_bytes(data: bytes, rng: np.random.Generator) -> bytes:
    """Spoils bytes in one place or more, without knowing what they are."""
    out = bytearray(data)
    for _ in range(rng.geometric(0.6)):
        _STEPS[rng.integers(len(_STEPS))](out, rng)
    return bytes(out)


def _at(out: bytearray, rng: np.random.Generator) -> int:
    """A place: half of them in the first 256 bytes, where headers are."""
    return int(rng.integers(max(1, min(256, len(out)) if rng.random() < 0.5 else len(out))))


def _flip(out: bytearray, rng: np.random.Generator) -> None:
    if out:
        out[_at(out, rng)] ^= 1 << int(rng.integers(8))


def _word(out: bytearray, rng: np.random.Generator) -> None:
    at, word = _at(out, rng), WORDS[rng.integers(len(WORDS))]
    at -= at % 4 if rng.random() < 0.8 else 0
    out[at : at + len(word)] = word


def _truncate(out: bytearray, rng: np.random.Generator) -> None:
    del out[_at(out, rng) :]


def _delete(out: bytearray, rng: np.random.Generator) -> None:
    at = _at(out, rng)
    del out[at : at + int(rng.integers(1, 64))]


def _insert(out: bytearray, rng: np.random.Generator) -> None:
    at = _at(out, rng)
    out[at:at] = rng.bytes(int(rng.integers(1, 64)))


def _repeat(out: bytearray, rng: np.random.Generator) -> None:
    at = _at(out, rng)
    out[at:at] = out[at : at + int(rng.integers(1, 256))]


def _noise(out: bytearray, rng: np.random.Generator) -> None:
    at, length = _at(out, rng), int(rng.integers(1, 64))
    out[at : at + length] = rng.bytes(length)


def _token(out: bytearray, rng: np.random.Generator) -> None:
    """Replaces a word of text, such as a number in a header."""
    at = _at(out, rng)
    begin, end = max(out.rfind(b" ", 0, at), out.rfind(b"\n", 0, at)) + 1, at
    while end < len(out) and out[end] not in b" \n":
        end += 1
    out[begin : min(end, begin + 32)] = TOKENS[rng.integers(len(TOKENS))]


_STEPS: tuple[Callable[[bytearray, np.random.Generator], None], ...] = (
    *(_flip,) * 3, *(_word,) * 4, *(_noise,) * 2, *(_token,) * 2, _truncate, _delete, _insert, _repeat)


def spoil_json(data: bytes, rng: np.random.Generator) -> bytes:
    """Replaces, removes or repeats values of a JSON text; now and then its bytes are spoilt instead."""
    if rng.random() < 0.2:
        return spoil_bytes(data, rng)
    value = json.loads(data)
    for _ in range(rng.integers(1, 3)):
        value = _spoil_value(value, rng)
    return json.dumps(value).encode()


def _spoil_value(value: Any, rng: np.random.Generator) -> Any:
    """A value with one thing inside it changed."""
    nasty = copy.deepcopy(VALUES[rng.integers(len(VALUES))])  # it may be spoilt in turn
    if not isinstance(value, dict | list) or not value or rng.random() < 0.05:
        return nasty
    keys = list(value) if isinstance(value, dict) else range(len(value))
    key: Any = keys[rng.integers(len(keys))]
    turn = rng.random()
    if turn < 0.1:
        del value[key]
    elif turn < 0.2 and isinstance(value, list):
        value.insert(key, copy.deepcopy(value[key]))
    elif turn < 0.25 and isinstance(value, dict):
        value["unknown"] = nasty
    else:
        value[key] = _spoil_value(value[key], rng)
    return value


def spoil_gzip(data: bytes, rng: np.random.Generator) -> bytes:
    """Spoils what gzip data holds, or its bytes."""
    if rng.random() < 0.25:
        return spoil_bytes(data, rng)
    return gzip.compress(spoil_bytes(zlib.decompress(data, 31), rng), mtime=0)


def spoil_zip(data: bytes, rng: np.random.Generator) -> bytes:
    """Spoils, removes or repeats a member of a zip file, or spoils its bytes."""
    if rng.random() < 0.25:
        return spoil_bytes(data, rng)
    with zipfile.ZipFile(io.BytesIO(data)) as bundle:
        kind = bundle.infolist()[0].compress_type
        members = {name: bundle.read(name) for name in bundle.namelist()}
    name = list(members)[rng.integers(len(members))]
    if rng.random() < 0.1:
        del members[name]
    else:
        members[name] = (spoil_json if name.endswith(".json") else spoil_bytes)(members[name], rng)
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", kind) as bundle:
        for member, content in members.items():
            bundle.writestr(zipfile.ZipInfo(member), content)
    return out.getvalue()


def spoil_file(name: str, data: bytes, rng: np.random.Generator) -> bytes:
    """Spoils a file by what its name says it is."""
    suffix = name.rpartition(".")[2]
    if suffix == "json":
        return spoil_json(data, rng)
    if suffix in ("sog", "npz", "pt"):
        return spoil_zip(data, rng)
    if data.startswith(b"\x1f\x8b"):
        return spoil_gzip(data, rng)
    return spoil_bytes(data, rng)
