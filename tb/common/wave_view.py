"""Writes a set-up file for GTKWave beside a wave file: the signals of the unit under test, in groups.

    gtkwave dump.gtkw

Clock and reset stand first. Then each stream of the unit has a group with `valid`, `ready`, the payload, and the fields of the
payload, which the trace has as signals of their own. Each channel of an AXI bus has such a group, too. The unit's other ports
follow, and then the streams inside the unit and inside the units below it, in closed groups. The file names only signals that
the trace has, so it also fits a trace of some scopes. Bits stand as 0 and 1, payloads, addresses and data in hexadecimal, and
fields as unsigned decimal numbers.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from tb.common.fst import Signal, signals

_BINARY, _HEXADECIMAL, _DECIMAL = "@28", "@22", "@24"
_OPEN, _OPEN_END, _CLOSED, _CLOSED_END = "@800200", "@1000200", "@c00200", "@1401200"

_CLOCKS = ("clk", "rst")

_WIDEST_NUMBER = 32
"""Bits up to which a field is shown as a decimal number; beyond, GTKWave's decimal numbers cannot be read."""

_PATTERNS = ("__payload", "addr", "data", "strb")
"""Ends of the names of signals that are patterns of bits and no numbers."""

_AXI_CHANNEL = re.compile(r"\w*axil?_(aw|ar|w|r|b)")


@dataclass
class Group:
    """A group of signals in the viewer.

    Attributes:
        name: what the viewer shows.
        shown: pairs of a radix and a signal.
        inside: groups in it.
        opened: whether its signals can be seen at the start.
    """

    name: str
    shown: list[tuple[str, Signal]] = field(default_factory=list)
    inside: list[Group] = field(default_factory=list)
    opened: bool = True


def view_path(wave: Path) -> Path:
    """The path of the set-up file that belongs to a wave file."""
    return wave.with_suffix(".gtkw")


def write_view(wave: Path) -> Path:
    """Writes `NAME.gtkw` beside the wave file `NAME.fst` and returns its path.

    Raises:
        ValueError: the wave file cannot be read.
    """
    path = view_path(wave)
    path.write_text(view_text(wave, signals(wave)), encoding="utf-8")
    return path


def view_text(wave: Path, found: Sequence[Signal]) -> str:
    """The text of the set-up file for a wave file with these signals."""
    lines = ["[*] Written by the testbench: clock and reset, then the streams of the unit.", f'[dumpfile] "{wave.resolve()}"',
             f'[savefile] "{view_path(wave).resolve()}"', "[timestart] 0", "[size] 1600 1000", "[pos] -1 -1",
             "[signals_width] 320"]
    for group in groups(found):
        lines += _lines(group)
    return "\n".join(lines) + "\n"


def groups(found: Sequence[Signal]) -> list[Group]:
    """The groups of a trace. Signals that Amaranth copies into other modules under names with `$` are left out."""
    scopes: dict[tuple[str, ...], dict[str, Signal]] = {}
    for signal in found:
        if "$" not in signal.name and not any(part.startswith("$") for part in signal.scope):
            scopes.setdefault(signal.scope, {})[signal.name] = signal
    unit = _unit(scopes)
    if unit is None:
        return []
    here = scopes[unit]
    made = [Group("clock and reset", [(_BINARY, here[name]) for name in _CLOCKS if name in here])]
    ports = {name: signal for name, signal in here.items() if signal.way or "." in name}
    made += _streams(ports)
    taken = {signal for group in made for _, signal in group.shown}
    others = [(_radix(signal), signal) for signal in here.values() if signal.way and signal not in taken]
    made.append(Group("other ports", others))
    known = {group.name for group in made}
    made.append(Group("inside", inside=[group for group in _streams(here) if group.name not in known], opened=False))
    for scope, names in scopes.items():
        if scope[:len(unit)] == unit and scope != unit:
            made.append(Group("/".join(scope[len(unit):]), inside=list(_streams(names)), opened=False))
    return [group for group in made if group.shown or group.inside]


def _unit(scopes: dict[tuple[str, ...], dict[str, Signal]]) -> tuple[str, ...] | None:
    """The scope of the unit under test: the outermost with a clock that is called `dut`; without one, the outermost of all."""
    clocked = sorted((scope for scope, names in scopes.items() if "clk" in names), key=len)
    return next((scope for scope in clocked if scope[-1] == "dut"), clocked[0] if clocked else None)


def _streams(names: dict[str, Signal]) -> Iterator[Group]:
    """A group for each stream and each AXI channel among the signals of a scope, in the order of the trace."""
    for name in names:
        start = name.removesuffix("valid")
        if start == name or f"{start}ready" not in names:
            continue
        if start.endswith("__") and f"{start}payload" in names:
            payload = f"{start}payload"
            rest = [payload, *(other for other in names if other.startswith((f"{payload}.", f"{payload}[")))]
        elif _AXI_CHANNEL.fullmatch(start):
            rest = [other for other in names if other.startswith(start) and other not in (name, f"{start}ready")]
        else:
            continue
        shown = [(_BINARY, names[name]), (_BINARY, names[f"{start}ready"])]
        shown += [(_radix(names[other], whole=other.endswith(_PATTERNS)), names[other]) for other in rest]
        yield Group(start.rstrip("_"), shown)


def _radix(signal: Signal, *, whole: bool = False) -> str:
    """Bits in binary, whole payloads and wide numbers in hexadecimal, and other numbers in decimal."""
    if not signal.bits:
        return _BINARY
    high, _, low = signal.bits[1:-1].partition(":")
    return _HEXADECIMAL if whole or int(high) - int(low or high) >= _WIDEST_NUMBER else _DECIMAL


def _lines(group: Group) -> list[str]:
    begin, end = (_OPEN, _OPEN_END) if group.opened else (_CLOSED, _CLOSED_END)
    lines = [begin, f"-{group.name}"]
    for radix, signal in group.shown:
        lines += [radix, signal.path]
    for inner in group.inside:
        lines += _lines(inner)
    return [*lines, end, f"-{group.name}"]
