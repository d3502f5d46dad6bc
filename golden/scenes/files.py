"""Reading and writing files: output is never left half-written, and any failure to read is an InputError that names the
file."""

from __future__ import annotations

import json
import math
import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
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


_only_folder: ContextVar[Path | None] = ContextVar("only_folder", default=None)


@contextmanager
def only_inside(folder: Path) -> Iterator[None]:
    """Within it, files that are not in the folder or below it, links followed, are refused, even if they do not exist: a scene
    from a stranger may name any file of the computer."""
    token = _only_folder.set(folder.resolve())
    try:
        yield
    finally:
        _only_folder.reset(token)


def _check_inside(path: Path) -> None:
    folder = _only_folder.get()
    if folder is not None and not path.resolve().is_relative_to(folder):
        raise InputError(f"{path!s:.200}: lies outside {folder}, which --no-outside does not accept")


def is_file(path: Path) -> bool:
    """Whether a path is that of a regular file; False for names that no file can have (too long, or with a NUL).

    Raises:
        InputError: see `only_inside`.
    """
    try:
        _check_inside(path)
        return path.is_file()
    except InputError:
        raise
    except (OSError, ValueError):
        return False


def read_bytes(path: Path) -> bytes:
    """Returns the content of a regular file, which must exist and must not be empty.

    Raises:
        InputError: the file is missing, unreadable, empty, or no regular file: a folder, a pipe or a device, which might never
            end; or see `only_inside`.
    """
    try:
        _check_inside(path)
        mode = path.stat().st_mode
        if not (stat.S_ISREG(mode) or stat.S_ISDIR(mode)):
            raise InputError(f"{path}: is no regular file, but a pipe or a device; a readable file is needed")
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path!s:.200}: cannot be read ({error.strerror}); a readable file is needed") from error
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{str(path)!r:.200}: is no name of a file ({error})") from error
    if not data:
        raise InputError(f"{path}: is empty (0 bytes)")
    return data


def read_any_json(path: Path) -> Any:
    """Returns the JSON value in a file.

    Raises:
        InputError: the file is missing or empty, is not JSON, or is nested more deeply than can be read.
    """
    try:
        return json.loads(read_bytes(path))
    except RecursionError as error:
        raise InputError(f"{path}: is nested too deeply for a file of this project") from error
    except ValueError as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path}: is not JSON ({error})") from error


def read_json(path: Path) -> dict[str, Any]:
    """Returns the JSON object in a file.

    Raises:
        InputError: as for `read_any_json`, or the value is something other than an object.
    """
    value = read_any_json(path)
    if not isinstance(value, dict):
        raise InputError(f"{path}: holds a {type(value).__name__}; a JSON object is needed")
    return value


def number_of(path: Path, entry: dict[str, Any], key: str, default: float | None = None) -> float:
    """The finite number that a JSON object holds under a key, or the default.

    Raises:
        InputError: it is no finite number, or one that no float can hold.
    """
    value = entry.get(key, default)
    try:
        if not isinstance(value, bool) and isinstance(value, int | float) and math.isfinite(value):
            return float(value)
    except OverflowError:  # an integer of hundreds of digits
        pass
    shown = repr(value)[:60] if _short(value) else "an integer of thousands of digits"
    raise InputError(f"{path}: {key} is {shown}; a finite number is needed")


def _short(value: object) -> bool:
    """Whether `repr` may be called: Python refuses it for integers of thousands of digits."""
    return not isinstance(value, int) or value.bit_length() < 4096


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
