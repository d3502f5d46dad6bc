"""Configurations without editing source: a named machine with some of its parameters changed.

On a command line, `--config` names a machine or a TOML file, and each `--set` changes one parameter:

    --config paper --set splat_cache_lines=4096 --set formats.colour=UQ1.8

In a TOML file the same names stand as keys; `config` says which machine the changes are made to:

    config = "paper"
    splat_cache_lines = 4096
    support_sigma = "none"

    [formats]
    colour = "UQ1.8"

Formats are written as `spec.formats` says. A `--set` overrides the file, and a later one an earlier one. A changed machine
gets a name of its own (`paper_x1a2b3c4d`), which depends only on what was changed, so that its results and build folders
never meet those of another machine.
"""

from __future__ import annotations

import argparse
import hashlib
import tomllib
import typing
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path

from spec.command_line import choice, nearest
from spec.config import LISTS, MACHINES, ORDERS, RECORDS, WARP_FILLS, AcceleratorConfig, NumberFormats
from spec.errors import InputError
from spec.formats import NOTATION, Fixed, SmallFloat, parse_format
from spec.relations import check_relations

FORMATS = "formats"
"""Prefix of the number formats' names, and their table in a TOML file."""

_PARAMETERS = {name: kind for name, kind in typing.get_type_hints(AcceleratorConfig).items() if name not in ("name", FORMATS)}
_FORMATS = {f"{FORMATS}.{name}": kind for name, kind in typing.get_type_hints(NumberFormats).items()}
_KINDS: dict[str, object] = {"name": str, **_PARAMETERS, **_FORMATS}
_SWITCHES = {"true": True, "false": False, "1": True, "0": False}
_WORDS = {"warp_fill": WARP_FILLS, "order": ORDERS, "records": RECORDS, "lists": LISTS}
_BEFORE_CHUNKS: dict[str, object] = {
    "order": "file", "chunks": False, "records": "wide", f"{FORMATS}.chunk": str(NumberFormats().chunk)}
_BEFORE_SUPERTILES: dict[str, object] = {
    f.name: f.default for f in fields(AcceleratorConfig)
    if f.name in ("lists", "list_heads", "buckets", "header_lines", "batch_places")}
_LATER: tuple[dict[str, object], ...] = (
    {"lockstep": False}, {"streams": 1}, {"packed": False}, {"joint": False}, {"overlap": False}, {"bank_memories": False},
    {"read_beats": 512})
_HASH_DIGITS = 8

NAMES = tuple(_KINDS)
"""Every name that `--set` and a TOML file take."""


def _refused(name: str, value: object, accepted: str) -> InputError:
    return InputError(f"{name} {value!r} is not accepted: {accepted}")


def _known(name: str) -> str:
    """`name` where it is a parameter's or a format's."""
    if name in _KINDS:
        return name
    if name == FORMATS:
        raise InputError(f"parameter {name!r} is not accepted: name one format, as in {FORMATS}.colour=UQ1.8")
    accepted = tuple(_FORMATS) if name.startswith(f"{FORMATS}.") else ("name", *_PARAMETERS, f"{FORMATS}.NAME")
    likely = [other for other in NAMES if other == f"{FORMATS}.{name}" or (len(name) > 2 and name in other)]
    hint = nearest(name, likely[:1] or NAMES)
    raise InputError(f"parameter {name!r} is not accepted: choose one of {', '.join(accepted)}{hint}")


def _format(name: str, value: object, kind: type[Fixed] | type[SmallFloat]) -> Fixed | SmallFloat:
    usual = getattr(NumberFormats(), name.partition(".")[2])
    shapes = {(Fixed, True): "a signed fixed-point format", (Fixed, False): "an unsigned fixed-point format",
              (SmallFloat, True): "a signed small float", (SmallFloat, False): "an unsigned small float"}
    accepted = f"{shapes[kind, usual.signed]} is, written as {usual}"
    if not isinstance(value, str):
        raise _refused(name, value, accepted)
    try:
        number = parse_format(value)
    except InputError as error:
        raise InputError(f"{name}: {error}") from error
    if type(number) is not kind or number.signed != usual.signed:
        raise _refused(name, value, accepted)
    return number


def convert(name: str, value: object) -> object:
    """The value of a parameter, by the parameter's type.

    Args:
        name: one of NAMES.
        value: text as on a command line, or a value as TOML has it.

    Raises:
        InputError: the name is not known or the value is not of its type.
    """
    kind = _KINDS[_known(name)]
    text = value.strip().lower() if isinstance(value, str) else None
    if kind in (Fixed, SmallFloat):
        return _format(name, value, kind)
    if kind is bool:
        if isinstance(value, bool) or text in _SWITCHES:
            return value if isinstance(value, bool) else _SWITCHES[typing.cast(str, text)]
        raise _refused(name, value, "true or false is")
    if kind is int:
        try:
            if isinstance(value, str) or (isinstance(value, int) and not isinstance(value, bool)):
                return int(value)
        except ValueError:
            pass
        raise _refused(name, value, "a whole number is")
    if kind is str:
        if isinstance(value, str):
            return value.strip()
        raise _refused(name, value, f"one of {', '.join(_WORDS[name])} is" if name in _WORDS else "a name is")
    if text == "none":  # what is left is the radius of the support
        return None
    try:
        if isinstance(value, str | int | float) and not isinstance(value, bool):
            return float(value)
    except ValueError:
        pass
    raise _refused(name, value, "a number or none is")


def parse_sets(sets: Sequence[str]) -> dict[str, object]:
    """Values by name of texts `NAME=VALUE`; where a name comes twice, the later value holds."""
    found: dict[str, object] = {}
    for text in sets:
        name, equals, value = text.partition("=")
        if not equals or not name.strip():
            raise InputError(f"set {text!r} is not accepted: write NAME=VALUE, as in splat_cache_lines=4096")
        found[name.strip()] = convert(name.strip(), value)
    return found


def read_file(path: Path) -> tuple[str | None, dict[str, object]]:
    """The machine that a TOML file is based on, if it says so, and its values by name."""
    try:
        with path.open("rb") as file:
            content = tomllib.load(file)
    except OSError as error:
        raise InputError(f"configuration {str(path)!r} cannot be read: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"configuration {str(path)!r} is not TOML: {error}") from error
    base, formats = content.pop("config", None), content.pop(FORMATS, {})
    if base is not None and not isinstance(base, str):
        raise InputError(f"{path}: config {base!r} is not accepted: one of {', '.join(MACHINES)} is")
    if not isinstance(formats, dict):
        raise InputError(f"{path}: {FORMATS} {formats!r} is not accepted: a table [{FORMATS}] is")
    given = content | {f"{FORMATS}.{name}": value for name, value in formats.items()}
    try:
        return base, {name: convert(name, value) for name, value in given.items()}
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _text(value: object) -> str:
    """A value as `--set` takes it."""
    return "none" if value is None else str(value).lower() if isinstance(value, bool) else str(value)


def _values(config: AcceleratorConfig) -> dict[str, object]:
    """Every parameter and format by name, but for the machine's name."""
    formats = {f"{FORMATS}.{f.name}": getattr(config.formats, f.name) for f in fields(NumberFormats)}
    return {name: getattr(config, name) for name in _PARAMETERS} | formats


def changed(base: AcceleratorConfig, values: Mapping[str, object]) -> AcceleratorConfig:
    """`base` with `values` instead of its own, under a name that depends on its own name and on what differs.

    Args:
        base: a machine.
        values: by name, converted; `name` stands before the hash instead of the base's name.

    Raises:
        InputError: a value is out of its limits, or the parameters do not work together.
    """
    plain = {name: value for name, value in values.items() if name in _PARAMETERS}
    numbers = {name.partition(".")[2]: value for name, value in values.items() if name in _FORMATS}
    try:
        formats = replace(base.formats, **numbers)  # type: ignore[arg-type]  # `convert` has made each of its field's type
        config = base.with_(**plain, formats=formats)
        if config != base:
            check_relations(config)
    except (ValueError, TypeError) as error:
        raise InputError(f"configuration {base.name!r} with {_listed(values)} is not accepted: {error}") from error
    before, after = _values(base), _values(config)
    differences = [f"{name}={_text(after[name])}" for name in before if before[name] != after[name]]
    prefix = str(values.get("name", base.name))
    if not differences and prefix == base.name:
        return base
    digest = hashlib.sha256("\n".join([base.name, *differences]).encode()).hexdigest()[:_HASH_DIGITS]
    if not prefix.isidentifier():
        raise _refused("name", prefix, "letters, digits and underscores are, with no digit first")
    return config.with_(name=f"{prefix}_x{digest}")


def _listed(values: Mapping[str, object]) -> str:
    return ", ".join(f"{name}={_text(value)}" for name, value in values.items()) or "no changes"


def resolve_config(base: str, sets: Sequence[str] = (), file: Path | None = None) -> AcceleratorConfig:
    """The machine that a base, a file and changes describe.

    Args:
        base: name of the machine that is changed; the file's own `config` goes before it.
        sets: texts `NAME=VALUE`, which override the file.
        file: a TOML file.

    Raises:
        InputError: a name or a value is not accepted; the message says what is, and which name is nearest.
    """
    of_file, values = read_file(file) if file else (None, {})
    return changed(MACHINES[choice("config", of_file or base, MACHINES)], values | parse_sets(sets))


def config_record(config: AcceleratorConfig) -> dict[str, object]:
    """Every parameter of a machine as JSON-ready values, to be written beside what was made with it; formats as text."""
    formats = {f.name: getattr(config.formats, f.name) for f in fields(NumberFormats)}
    return {"name": config.name, **{name: getattr(config, name) for name in _PARAMETERS},
            FORMATS: {name: value if isinstance(value, int) else str(value) for name, value in formats.items()}}


def add_config_arguments(
    parser: argparse.ArgumentParser, default: str | None = "paper", note: str = "",
) -> None:
    """Adds `--config` and `--set`.

    Args:
        parser: of the command.
        default: what `--config` is where it is not given; None where the command does something else without it.
        note: further words about the default.
    """
    said = f" (default: {default}{note})" if default else ""
    parser.add_argument("--config", default=default, metavar="NAME|FILE.toml",
                        help=f"machine: {', '.join(MACHINES)}, or a TOML file of parameters{said}")
    add_set_argument(parser)


def add_set_argument(parser: argparse.ArgumentParser) -> None:
    """Adds `--set` alone, for commands whose `--config` names something else."""
    parser.add_argument("--set", dest="sets", action="append", default=[], metavar="NAME=VALUE",
                        help="change one parameter of the machine, as in splat_cache_lines=4096 or formats.colour=UQ1.8; "
                             f"may be given several times. Formats are written as in {NOTATION}")


def is_file(config: str) -> bool:
    """Whether what `--config` was given means a TOML file."""
    return config.endswith(".toml")


def config_from(args: argparse.Namespace, default: str = "paper") -> AcceleratorConfig:
    """The machine that `--config` and `--set` describe.

    Args:
        args: parsed, with the arguments of `add_config_arguments`.
        default: machine that a TOML file without `config` is based on.
    """
    if is_file(args.config):
        return resolve_config(default, args.sets, Path(args.config))
    return resolve_config(args.config, args.sets)


def config_options(args: argparse.Namespace) -> list[str]:
    """`--config` and `--set` of parsed arguments, for another command that is run in another folder."""
    config = str(Path(args.config).resolve()) if is_file(args.config) else args.config
    return ["--config", config, *(part for text in args.sets for part in ("--set", text))]


def config_from_record(record: Mapping[str, object]) -> AcceleratorConfig:
    """The machine that `config_record` described; where the record is from before machines with chunks, with super-tiles,
    in lockstep, with several streams, with packed frames, with joint frames, with overlapped phases or with banks in
    memories, the machine has none.

    Raises:
        InputError: a parameter is missing, unknown or not accepted.
    """
    formats = record.get(FORMATS)
    if not isinstance(formats, Mapping):
        raise InputError(f"{FORMATS} {formats!r} is not accepted in a configuration's record: one value for each format is")
    given = {name: value for name, value in record.items() if name != FORMATS}
    given |= {f"{FORMATS}.{name}": value for name, value in formats.items()}
    for before in (_BEFORE_CHUNKS, _BEFORE_SUPERTILES, *_LATER):
        if not given.keys() & before.keys():
            given |= before
    missing = [name for name in NAMES if name not in given]
    if missing:
        raise InputError(f"a configuration's record without {', '.join(missing)} is not accepted: every parameter is needed")
    values = {name: "none" if value is None else value for name, value in given.items()}
    made = changed(AcceleratorConfig(name="recorded"), {name: convert(name, value) for name, value in values.items()})
    return made.with_(name=record["name"])


def recorded_config(result: Mapping[str, object]) -> AcceleratorConfig:
    """The machine of a result: its `configuration`, or in files from before there was one the machine that `config` names.

    Raises:
        InputError: neither is there.
    """
    record = result.get("configuration")
    if isinstance(record, Mapping):
        return config_from_record(record)
    return MACHINES[choice("config", str(result.get("config")), MACHINES)]
