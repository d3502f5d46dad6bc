"""Reading and writing files: output is never left half-written, and any failure to read is an InputError that names the
file."""

from __future__ import annotations

import json
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from spec.errors import InputError
from spec.extras import how_to_get


@contextmanager
def atomic_output(path: Path | str) -> Iterator[BinaryIO]:
    """Opens a binary file for writing that appears under `path` only when the block has ended without an exception.

    Raises:
        InputError: the folder does not exist or is not writable.
    """
    path = Path(path)
    try:
        descriptor, temporary = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); an existing, writable folder is needed") from error
    try:
        with os.fdopen(descriptor, "wb") as file:
            yield file
        umask = os.umask(0)
        os.umask(umask)
        os.chmod(temporary, 0o666 & ~umask)  # mkstemp makes the file unreadable to others, which an output must not be
        os.replace(temporary, path)
    except BaseException:
        Path(temporary).unlink(missing_ok=True)
        raise


def read_bytes(path: Path) -> bytes:
    """Returns the content of a file, which must exist and must not be empty.

    Raises:
        InputError: the file is missing, unreadable, a folder, or empty.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); a readable file is needed") from error
    if not data:
        raise InputError(f"{path}: is empty (0 bytes)")
    return data


def read_json(path: Path) -> dict[str, Any]:
    """Returns the JSON object in a file.

    Raises:
        InputError: the file is missing or empty, is not JSON, or holds something other than an object.
    """
    try:
        value = json.loads(read_bytes(path))
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: is not JSON ({error})") from error
    if not isinstance(value, dict):
        raise InputError(f"{path}: holds a {type(value).__name__}; a JSON object is needed")
    return value


def require_package(name: str, purpose: str) -> Any:
    """Imports an optional package and returns it.

    Args:
        name: the package.
        purpose: what needs it, for the error message.

    Raises:
        InputError: the package is not installed; the message names the extra that has it.
    """
    import importlib

    try:
        return importlib.import_module(name)
    except ImportError as error:
        raise InputError(f"{purpose} needs {name!r}, which is not installed; {how_to_get(name)}") from error
