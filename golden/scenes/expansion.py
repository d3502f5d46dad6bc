"""What compressed files may become in memory: a budget that is checked before anything is decoded.

Formats that compress well make small files that decode to gigabytes, by accident or on purpose. A file may become EXPANSION
times its size, and FLOOR bytes in any case; models of this project's users grow 2 to 20 times. The variable MSV2_EXPANSION
raises the factor for a file that is known to be good.
"""

from __future__ import annotations

import io
import os
import struct
import zipfile
import zlib
from pathlib import Path

from PIL import Image

from golden.scenes.dataset import UNREADABLE
from golden.scenes.files import is_file, read_bytes
from spec.errors import InputError

EXPANSION, FLOOR = 100, 64 << 20
"""How many times its size a file may become, and the bytes that any file may become."""

VARIABLE = "MSV2_EXPANSION"
"""The environment variable that replaces EXPANSION."""

_STEP = 1 << 20
_ZSTD_HEADER = 18  # bytes of the longest header of a zstd frame


def expansion() -> int:
    """The factor in force.

    Raises:
        InputError: the variable holds something else than a whole number from 1 on.
    """
    text = os.environ.get(VARIABLE, str(EXPANSION))
    if not (text.isascii() and text.isdigit() and 0 < int(text[:12]) and len(text) < 12):
        raise InputError(f"{VARIABLE}={text[:60]!r} is not accepted: a whole number from 1 on is")
    return int(text)


def check_expansion(path: Path, packed: int, unpacked: int) -> None:
    """Refuses a file of `packed` bytes that would become `unpacked` bytes, if the budget is smaller."""
    budget = max(FLOOR, packed * expansion())
    if unpacked > budget:
        raise InputError(f"{path}: {packed:,} bytes would become {unpacked:,} or more; at most {budget:,} are accepted "
                         f"({VARIABLE}=N accepts N times the file's size)")


def check_gzip(path: Path, data: bytes) -> None:
    """Decodes gzip data step by step, keeping nothing, until it ends or breaks the budget.

    Raises:
        InputError: the budget is broken, the data is broken or truncated, or bytes follow its end.
    """
    decoder, unpacked, rest = zlib.decompressobj(31), 0, data
    try:
        while not decoder.eof:
            step = len(decoder.decompress(rest, _STEP))
            rest, unpacked = decoder.unconsumed_tail, unpacked + step
            check_expansion(path, len(data), unpacked)
            if not rest and not step and not decoder.eof:
                raise zlib.error("the compressed data ends early")
    except zlib.error as error:
        raise InputError(f"{path}: is not a whole gzip file ({error})") from error
    if decoder.unused_data:
        raise InputError(f"{path}: {len(decoder.unused_data)} bytes follow the end of the compressed data; none are accepted")


def check_spz_streams(path: Path, data: bytes) -> None:
    """Refuses an SPZ of version 4 whose zstd streams announce more bytes than the budget.

    Raises:
        InputError: the budget is broken, or the table of streams lies outside the file.
    """
    try:
        import zstandard
    except ImportError:  # without it, the reader refuses this version
        return
    try:
        streams, table = struct.unpack_from("<BI", data, 15)
        packed = [struct.unpack_from("<Q", data, table + 16 * i)[0] for i in range(streams)]
        starts = [table + 16 * streams + sum(packed[:i]) for i in range(streams)]
        sizes = [zstandard.frame_content_size(data[start : start + _ZSTD_HEADER]) for start in starts]
    except (struct.error, zstandard.ZstdError) as error:
        raise InputError(f"{path}: is not a whole SPZ file ({error})") from error
    check_expansion(path, len(data), sum(max(size, 0) for size in sizes))


def check_sog(path: Path) -> None:
    """Refuses a SOG whose members or images announce more bytes than the budget.

    Args:
        path: a folder, its meta.json, or a .sog bundle.

    Raises:
        InputError: the budget is broken, or the bundle is no zip file.
    """
    folder = path if path.is_dir() else path.parent if path.name == "meta.json" else None
    if folder is not None:
        parts = [read_bytes(part) for part in sorted(folder.iterdir()) if is_file(part) and part.stat().st_size]
        packed = sum(map(len, parts))
    else:
        packed = len(read_bytes(path))
        parts = _members(path, packed)
    check_expansion(path, packed, sum(_decoded(part) for part in parts))


def _members(path: Path, packed: int) -> list[bytes]:
    """The members of a bundle, after a look at what all of them announce."""
    try:
        with zipfile.ZipFile(path) as bundle:
            check_expansion(path, packed, sum(member.file_size for member in bundle.infolist()))
            return [bundle.read(name) for name in bundle.namelist()]
    except InputError:
        raise
    except Exception as error:  # zipfile and zlib raise nearly anything on a broken file
        raise InputError(f"{path}: is not a whole SOG bundle ({error})") from error


def _decoded(part: bytes) -> int:
    """Bytes of an image's pixels as RGBA; 0 for what is no image or a broken one, which its reader will say."""
    try:
        with Image.open(io.BytesIO(part)) as header:
            return 4 * header.width * header.height
    except Image.DecompressionBombError:
        return 1 << 62
    except (*UNREADABLE, struct.error):
        return 0
