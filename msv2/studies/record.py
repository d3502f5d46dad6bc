"""Writes the JSON files of all reports: their content, and the provenance of this content.

The last key of every report is `provenance`, an object with these keys:

| key | meaning |
|---|---|
| `command` | the command that wrote the report |
| `commit` | 7 digits of the commit, followed by `+dirty` if tracked files differ from it; `unknown` without git |
| `configuration` | the resolved arguments, and every machine with all of its parameters |
| `modules`, `sources` | the modules that made the numbers, and a hash of these and of everything they import (spec.sources) |
| `inputs` | a hash of each file that was read: scenes, liberty files, other reports |
| `machine` | the processor, its number of cores, and the versions of Python and numpy |
| `date` | the date and time of writing, in UTC |
| `cpu_seconds`, `wall_seconds` | the time that the command had taken by then, with the processes that it started |
| `earlier` | the provenances of rows that earlier commands wrote and this command left unchanged |
| `backfilled` | true if the object was made later from the git history, so that its hashes are not known |
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shlex
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from golden.scenes.request import write_json
from msv2.studies.destination import place
from spec.config import AcceleratorConfig
from spec.overrides import config_record
from spec.paths import IN_CHECKOUT, REPORTS, ROOT, data_folder
from spec.sources import fingerprint, sources_of

PROVENANCE = "provenance"
"""The key of the provenance in every report."""

_PLACES = frozenset({"out", "work", "runs", "scheduler"})
"""Arguments that name places. They change no number and are left out of the configuration."""


@dataclass(frozen=True)
class Run:
    """A command and the time when it began: `wall` as of `time.monotonic`, `cpu` as of `processor_seconds`."""

    command: str
    wall: float
    cpu: float


def processor_seconds() -> float:
    """The processor time in seconds of this process and of the finished processes that it started."""
    return sum(os.times()[:4])


def begun(command: str) -> Run:
    """A command that begins now."""
    return Run(command, time.monotonic(), processor_seconds())


_run = [Run("", time.monotonic(), 0.0)]


def begin(study: str, arguments: Iterable[str]) -> None:
    """Sets the study and the arguments that the provenances of all later reports name."""
    _run[0] = begun(" ".join(["msv2 study run", study, *map(_word, arguments)]))


def _word(text: str) -> str:
    """A word of a command line, quoted for a shell. The variables MSV2_DATA and MSV2_PDK stand for their folders."""
    word = shown(text)
    if not word.startswith(("MSV2_DATA/", "MSV2_PDK/")):
        return shlex.quote(word)
    return f"${word}" if shlex.quote(word) == word else f'"${word}"'


def command(module: str | None = None) -> str:
    """The running command: that of the study named to `begin`, or else the command line of the interpreter."""
    arguments = list(map(_word, sys.argv))
    return _run[0].command or " ".join(["python", *(arguments if module is None else ["-m", module, *arguments[1:]])])


def shown(value: object) -> str:
    """A word of a command line without paths that exist on this computer only."""
    text = str(value)
    for folder, name in ((ROOT, ""), (data_folder(), "MSV2_DATA/"), (os.environ.get("MSV2_PDK"), "MSV2_PDK/")):
        if folder is not None:
            for form in dict.fromkeys((str(Path(folder).resolve()), str(folder))):
                if text == form:
                    return name.rstrip("/") or "."
                text = text.replace(f"{form.rstrip('/')}/", name)
    return Path(text).name if text.startswith("/") else text


def plain(value: object) -> Any:
    """A value of a configuration in a form that JSON can store. Machines have all their parameters; for paths see `shown`."""
    if isinstance(value, argparse.Namespace):
        return {key: plain(item) for key, item in sorted(vars(value).items()) if key not in _PLACES}
    if isinstance(value, AcceleratorConfig):
        return config_record(value)
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple | set | frozenset):
        return [plain(item) for item in (value if isinstance(value, list | tuple) else sorted(value))]
    return value if isinstance(value, bool | int | float | None) else shown(value)


def commit() -> str:
    """The checkout's commit, with `+dirty` where tracked files differ from it; `unknown` without git or a checkout."""
    if not IN_CHECKOUT:
        return "unknown"

    def git(*command: str) -> str | None:
        done = subprocess.run(["git", "-C", str(ROOT), *command], capture_output=True, text=True, check=False)
        return done.stdout.strip() if done.returncode == 0 else None

    try:
        head, changed = git("rev-parse", "--short=7", "HEAD"), git("status", "--porcelain", "--untracked-files=no")
    except OSError:
        return "unknown"
    return f"{head}{'+dirty' if changed else ''}" if head else "unknown"


def processor() -> str:
    """The model of the processor, as the operating system names it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith(("model name", "Model"))]
    return names[0] if names else platform.processor() or platform.machine()


def machine() -> dict[str, object]:
    """A description of the computer that makes the report. It contains no host name and no folder."""
    return {"processor": processor(), "cores": os.cpu_count(), "python": platform.python_version(), "numpy": np.__version__}


def input_name(path: Path | str) -> str:
    """The name of a file or folder in `inputs`. It is relative to the repository, to MSV2_DATA or to MSV2_PDK."""
    return shown(Path(path).absolute())


def input_hash(path: Path) -> str:
    """16 hexadecimal digits of a file, or of all files of a folder.

    Of a report, all but its provenance counts; of the folder of a training run, its model and its report count.

    Raises:
        OSError: the file does not exist.
    """
    run = [path / name for name in ("model.ply", "report.json")]
    if all(file.is_file() for file in run):
        return fingerprint(run)
    if path.is_dir():
        return fingerprint(file for file in sorted(path.rglob("*")) if file.is_file())
    if path.parent == REPORTS and path.suffix == ".json":
        content = json.loads(path.read_text())
        content.pop(PROVENANCE, None)
        return fingerprint((), json.dumps(content, sort_keys=True))
    return fingerprint([path])


def liberties() -> list[Path]:
    """A list of the folder of liberty files that MSV2_PDK names; it is empty if the variable is not set."""
    folder = os.environ.get("MSV2_PDK")
    return [Path(folder)] if folder else []


def input_path(name: str) -> Path:
    """The present path of an input with this name in `inputs`."""
    head, _, rest = name.partition("/")
    folder = {"MSV2_DATA": data_folder(), "MSV2_PDK": Path(os.environ.get("MSV2_PDK", "MSV2_PDK"))}.get(head)
    return folder / rest if folder is not None else ROOT / name


def _dotted(module: str) -> str:
    """The dotted name of a module, also if it runs as `__main__`."""
    spec = getattr(sys.modules["__main__"], "__spec__", None)
    return spec.name if module == "__main__" and spec is not None else module


OTHER_SOURCES = {"tb.frame.__main__": tuple(ROOT / "tb" / "top" / name for name in ("lpddr3.sv", "memory.sv"))}
"""Source files that are not Python, by the module that reads them."""


def source_hash(modules: Iterable[str]) -> str:
    """A hash of 16 hexadecimal digits of modules and of all the project's sources that they import or read.

    Raises:
        ValueError: a module does not exist.
    """
    names = list(modules)
    return fingerprint([*sources_of(*names), *(path for name in names for path in OTHER_SOURCES.get(name, ()))])


def provenance(
    modules: Iterable[str], configuration: object = None, inputs: Iterable[Path | str] = (),
    earlier: Mapping[str, Any] | None = None,
) -> dict[str, object]:
    """The provenance of a report that is written now.

    Args:
        modules: the dotted names of the modules that made the numbers, also of those that ran as separate processes.
        configuration: the parsed arguments, or a mapping; machines in it are written with all of their parameters.
        inputs: files and folders that were read; names of files that do not exist, such as `embedded`, are left out.
        earlier: the old report, if some of its rows stay in this one.
    """
    names, run = sorted(set(map(_dotted, modules))), _run[0]
    paths = [path for path in map(Path, inputs) if path.exists()]
    made: dict[str, object] = {
        "command": command(), "commit": commit(),
        "configuration": plain(configuration or {}), "modules": names, "sources": source_hash(names),
        "inputs": {input_name(path): input_hash(path) for path in paths}, "machine": machine(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"), "cpu_seconds": round(processor_seconds() - run.cpu, 1),
        "wall_seconds": round(time.monotonic() - run.wall, 1)}
    old = (earlier or {}).get(PROVENANCE)
    return made if old is None else {**made, "earlier": [{k: v for k, v in old.items() if k != "earlier"},
                                                         *old.get("earlier", [])]}


def write_report(
    path: Path, content: Mapping[str, Any], modules: Iterable[str], configuration: object = None,
    inputs: Iterable[Path | str] = (), earlier: Mapping[str, Any] | None = None,
) -> None:
    """Writes a report and its provenance as JSON. The file is written completely or not at all; infinities and NaNs become
    null.

    Args:
        path: the path of the JSON file; for a report in reports/, see `msv2.studies.destination`.
        content: the content of the report; a provenance in it is replaced.
        modules, configuration, inputs, earlier: the arguments of `provenance`.

    Raises:
        InputError: the folder does not exist or is not writable.
    """
    body = {key: value for key, value in content.items() if key != PROVENANCE}
    write_json(place(path), {**body, PROVENANCE: provenance(modules, configuration, inputs, earlier)})


def state(made: Mapping[str, Any] | None) -> str:
    """Tells from the hashes in a provenance whether the command would write the same report today.

    Returns:
        `current`; or `stale` and what has changed; or `unknown` and the reason why.
    """
    if not made:
        return "unknown: it has no provenance"
    if made.get("sources") is None:
        return f"unknown: backfilled, written at {made['commit']}"
    try:
        changed = ["sources"] if source_hash(made["modules"]) != made["sources"] else []
    except ValueError:
        changed = ["sources"]
    for name, digest in made["inputs"].items():
        path = input_path(name)
        if path.exists() and input_hash(path) != digest:
            changed.append(name)
    for old in made.get("earlier", ()):
        if old.get("sources") != made["sources"]:
            changed.append(f"rows of {old['commit']}")
    return f"stale: changed {', '.join(changed)}" if changed else "current"
