"""The points of a sweep: what a TOML file asks for, as command lines of `msv2 perf`.

A file has a table of common settings, settings that vary, and settings that are listed:

    [base]
    scene = "embedded"
    size = "640x360"
    gaze = "centre"

    [vary]                              # all combinations
    splat_cache_lines = [1024, 2048, 4096]
    bandwidth = [12.8, 25.6, "unlimited"]

    [[point]]                           # each one as it stands
    culling_units = 4
    cores_y = 8

A name is an option of `msv2 perf` or a field of the configuration. `levels`, `depth` and `stereo` are both; alone they mean the
frame's, and `set.levels` and `set.depth` the machine's. The memory is LPDDR3; where a file names a bandwidth or a latency and
no memory, it is the ideal one for all points. `gaze = "centre"` follows the size. `clock_mhz` is the clock;
on LPDDR3, whose times are in nanoseconds, it changes the cycles too.
"""

from __future__ import annotations

import argparse
import itertools
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import NoReturn

from golden.host.run_options import IDEAL, OF_IDEAL
from golden.scenes.captured import scene_argument
from golden.scenes.load import EMBEDDED
from golden.scenes.request import parse_size
from perf.__main__ import Asked, asked_of, command_line
from spec.command_line import nearest
from spec.errors import InputError
from spec.overrides import NAMES, config_record, convert

MOST_POINTS = 100_000
"""Most points of a sweep; a file that asks for more has most likely one list too many."""

TABLES = ("base", "vary", "point")
CENTRE = "centre"
CLOCK = "clock_mhz"
CLOCKS_MHZ = (1.0, 100_000.0)

OF_THE_MACHINE = ("config", "machine", "pixels", "merge", "beta")
"""Options that belong to the machine, as fields of the configuration do; the others say what is drawn, and from what memory."""

_LEFT_OUT = {
    "help": "", "out": "--out of the command is", "no_cache": "", "sets": "the field's own name is",
    "pipeline": "incremental, the configuration's field, is"}
"""Options of `msv2 perf` that a point cannot have, and what is accepted in their place."""


@cache
def _parser() -> argparse.ArgumentParser:
    parser = command_line()
    setattr(parser, "error", _refuse)  # noqa: B010  # a wrong value is a point's, not this command line's
    return parser


def _refuse(message: str) -> NoReturn:
    raise InputError(message)


@cache
def options() -> dict[str, argparse.Action]:
    """The options of `msv2 perf` that a point may have, by their names with underscores."""
    return {action.dest: action for action in _parser()._actions if action.dest not in _LEFT_OUT}


@cache
def _fields() -> dict[str, str]:
    """Fields of the configuration by the names that a sweep takes; those that options have too are only known as `set.NAME`."""
    fields = {f"set.{name}": name for name in NAMES if name not in ("name", "stereo")}
    return fields | {name: name for name in NAMES if name not in ("name", *options())}


def names() -> tuple[str, ...]:
    """All names that a sweep takes."""
    return (*options(), *_fields())


@dataclass(frozen=True)
class Point:
    """A point of a sweep.

    Attributes:
        varied: the settings in which it differs from others, as text by name.
        argv: the arguments of `msv2 perf` that describe it.
        clock_mhz: the machine's clock.
    """

    varied: tuple[tuple[str, str], ...]
    argv: tuple[str, ...]
    clock_mhz: float = 1000.0

    @property
    def label(self) -> str:
        """The settings as text."""
        return ", ".join(f"{name}={value}" for name, value in self.varied) or "base"

    def checked(self) -> tuple[argparse.Namespace, Asked]:
        """The parsed arguments of `msv2 perf`, and what they ask for.

        Raises:
            InputError: a value is not accepted; the message names the point.
        """
        try:
            args = _parser().parse_args(list(self.argv))
            return args, asked_of(args)
        except InputError as error:
            raise InputError(f"point {self.label}: {error}") from error


def read_sweep(path: Path) -> list[Point]:
    """The points of a TOML file, each once.

    Raises:
        InputError: the file cannot be read, a name or a value is not accepted, or there is no point.
    """
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputError(f"sweep {str(path)!r} cannot be read: {error.strerror}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"sweep {str(path)!r} is not TOML: {error}") from error
    try:
        return points_of(content)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def points_of(content: Mapping[str, object]) -> list[Point]:
    """The points of a file's content; see `read_sweep`."""
    for name in content:
        if name not in TABLES:
            raise InputError(f"table {name!r} is not accepted: choose one of {', '.join(TABLES)}{nearest(name, TABLES)}")
    base, vary = (_flat(_table(content, name)) for name in ("base", "vary"))
    listed = content.get("point", [])
    if not isinstance(listed, list) or not all(isinstance(item, dict) for item in listed):
        raise InputError("point is not accepted as it is: each listed point is a table [[point]]")
    named = {*base, *vary, *(name for item in listed for name in _flat(item))}
    if "memory" not in named and named & set(OF_IDEAL):
        base["memory"] = IDEAL  # of all points, so that they compete
    for name, values in vary.items():
        if not isinstance(values, list) or not values:
            raise InputError(f"vary: {name} = {values!r} is not accepted: a list of values is, such as [1, 2]")
    made = [dict(zip(vary, values, strict=True)) for values in _product(vary)] if vary or not listed else []
    made += [_flat(item) for item in listed]
    varied = list(dict.fromkeys(name for item in made for name in item))
    found = {}
    for item in made:
        point = _point(base | item, varied)
        found.setdefault((point.argv, point.clock_mhz), point)
    return [_completed(point, varied) for point in found.values()]


def _completed(point: Point, varied: Sequence[str]) -> Point:
    """The point with a value for every setting that varies in the sweep, also those that it does not name itself.

    Raises:
        InputError: a value of the point is not accepted.
    """
    _, asked = point.checked()
    record, given = config_record(asked.config), dict(point.varied)
    for name in varied:
        if name in given:
            continue
        if name in options():
            given[name] = _text(_default(name, asked))
        else:
            field, _, number = _fields()[name].partition(".")
            value = record[field][number] if number else record[field]
            given[name] = "none" if value is None else _text(value)
    return replace(point, varied=tuple((name, given[name]) for name in varied))


def _default(name: str, asked: Asked) -> object:
    """The value of an option of `msv2 perf` that a point does not name."""
    if name == "memory":
        return asked.memory.kind
    if name in OF_IDEAL:
        ideal = {"bandwidth": asked.options.bytes_per_cycle, "latency": asked.options.latency}
        return ideal[name] if asked.memory.kind == IDEAL else f"of {asked.memory.kind}"
    return options()[name].default


def _product(vary: Mapping[str, Sequence[object]]) -> itertools.product:
    count = 1
    for values in vary.values():
        count *= len(values)
    if count > MOST_POINTS:
        raise InputError(f"{count:,} points are not accepted: at most {MOST_POINTS:,} are")
    return itertools.product(*vary.values())


def _table(content: Mapping[str, object], name: str) -> Mapping[str, object]:
    found = content.get(name, {})
    if not isinstance(found, dict):
        raise InputError(f"{name} = {found!r} is not accepted: a table [{name}] is")
    return found


def _flat(table: Mapping[str, object], prefix: str = "") -> dict[str, object]:
    """A table without tables inside: their names are joined by points. Every name is one that a sweep takes."""
    found: dict[str, object] = {}
    for name, value in table.items():
        if isinstance(value, dict):
            found |= _flat(value, f"{prefix}{name}.")
        else:
            found[_known(prefix + name)] = value
    return found


def _known(name: str) -> str:
    if name in names():
        return name
    instead = _LEFT_OUT.get(name)
    if instead:
        raise InputError(f"setting {name!r} is not accepted: {instead}")
    if name in ("set.stereo", "stereo"):
        raise InputError(f"setting {name!r} is not accepted: stereo, the frame's option, is")
    hint = nearest(name, names())
    raise InputError(f"setting {name!r} is not accepted: choose an option of `msv2 perf` or a field of the configuration{hint}")


def _point(settings: Mapping[str, object], varied: Sequence[str]) -> Point:
    argv, texts, clock = [], {}, 1000.0
    given = dict(settings)
    if given.get("gaze") == CENTRE:
        width, height = parse_size(str(given.get("size", options()["size"].default)))
        given["gaze"] = f"{width / 2:g},{height / 2:g}"
    for name, value in given.items():
        texts[name] = _text(settings[name])
        if name == CLOCK:
            clock = _clock(value)
            argv += ["--clock-mhz", _text(value)]
        elif name in options():
            argv += _option(name, value)
        else:
            field = _fields()[name]
            convert(field, value if not isinstance(value, list) else str(value))
            argv += ["--set", f"{field}={_text(value)}"]
    if "machine" not in given:
        argv += ["--machine", "full"]
    if "pixels" not in given:
        argv += ["--pixels", "display"]
    return Point(tuple((name, texts[name]) for name in varied if name in texts), tuple(argv), clock)


def _clock(value: object) -> float:
    low, high = CLOCKS_MHZ
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise InputError(f"{CLOCK} {value!r} is not accepted: {low:g}..{high:g} MHz are")
    return float(value)


def _option(name: str, value: object) -> list[str]:
    action = options()[name]
    if action.nargs == 0:
        if not isinstance(value, bool):
            raise InputError(f"{name} {value!r} is not accepted: true or false is")
        return [action.option_strings[0]] if value else []
    if name == "scene":
        return [f"--scene={_scene(value)}"]
    text = str(int(value)) if isinstance(value, bool) else _text(value)
    return [f"{action.option_strings[0]}={text}"]


def _scene(value: object) -> str:
    """The argument for a scene: a captured scene by its name, where it is, or a path."""
    text = str(value)
    if text.startswith(EMBEDDED) or Path(text).exists():
        return text
    try:
        found = scene_argument(text)
    except KeyError:
        found = None
    if found is None:
        raise InputError(f"scene {text!r} is not accepted: 'embedded', a path of a model, or a captured scene of MSV2_DATA is")
    return found


def _text(value: object) -> str:
    """A TOML value as a command line has it."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return ",".join(_text(item) for item in value)
    return f"{value:g}" if isinstance(value, float) else str(value)
