"""What accuracy costs in time, in three small frontiers: the machine, its simulation, and the training.

Each has at most MOST_LABELS settings with a name, and says in a sentence what a decibel costs. Every number comes from the
study's content.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from msv2.studies.tradeoff.choose import pareto
from msv2.studies.tradeoff.knobs import DEFAULT, PRESET, base_of
from msv2.studies.tradeoff.tables import Content
from spec.config import PAPER

MOST_LABELS = 6

EXACT_DB = 200.0
"""The PSNR that stands in the content for two equal images."""

CLOCK_GHZ = 1.0

SAVES = 0.01
"""Part of a frame's time that a preset must save to be named: the others differ in area alone."""


@dataclass(frozen=True)
class Mark:
    """A named setting.

    Attributes:
        name: the label.
        time, decibels: its time in the frontier's unit, and its accuracy.
        front: whether it is on the frontier.
        other: whether it is measured with another model, which the frontier does not compare.
    """

    name: str
    time: float
    decibels: float
    front: bool = True
    other: bool = False


@dataclass(frozen=True)
class Frontier:
    """A small diagram of time and accuracy.

    Attributes:
        name: `machine`, `simulation` or `training`.
        title: the heading.
        time, accuracy: labels of the axes.
        marks: the named settings.
        others: (time, decibels) of further points, which have no name.
        cost: a sentence that says what a decibel costs in time.
        more: what else there is to say, in a sentence or two.
        linear_db: differences up to this many decibels are drawn to scale, larger ones by their logarithm; None for a scale
            without logarithm.
        log_time: whether times are drawn by their logarithm.
    """

    name: str
    title: str
    time: str
    accuracy: str
    marks: tuple[Mark, ...]
    others: tuple[tuple[float, float], ...]
    cost: str
    more: str = ""
    linear_db: float | None = None
    log_time: bool = False


def frontiers(content: Content) -> list[Frontier]:
    """The frontiers of the content; that of the training is missing where no run was found."""
    return [_machine(content), _simulation(content), *([_training(content)] if content["training"] else [])]


def _microseconds(row: Mapping[str, Any]) -> float:
    return row["cycles"] / (1e3 * CLOCK_GHZ)


def named_rows(content: Content) -> list[tuple[str, Mapping[str, Any]]]:
    """The settings of the machine that have a name in the diagram, ordered by descending time: the default, the frontier, other
    models, and the presets that save time. Each with its name."""
    rows = [row for row in content["machine"] if not row.get("error") and row["threshold_deg"] is None]
    default = next(row for row in rows if row["knob"] == DEFAULT)
    base = base_of(content)
    found = [("the paper's machine" if base is PAPER else f"the machine {base.name}", default)]
    found += [(_short(row), row) for row in rows if row["pareto"] and row is not default]
    found += [(f"model {row['value']}, trained levels", row) for row in rows if row["variant"]]
    found += [(f"preset {row['value']}", row) for row in rows
              if row["knob"] == PRESET and row["cycles"] < (1 - SAVES) * default["cycles"]]
    return sorted(found[:MOST_LABELS], key=lambda pair: -pair[1]["cycles"])


def _short(row: Mapping[str, Any]) -> str:
    if row["parts"]:
        return ", ".join(" ".join(part) for part in row["parts"][:2])
    count, _, how = row["value"].partition(", ")
    return {"levels": f"{count} levels, {how}", "SH degree": f"harmonics of degree {row['value']}"}.get(
        row["knob"], f"{row['knob']} {row['value']}")


def _machine(content: Content) -> Frontier:
    named = named_rows(content)
    rows = [row for row in content["machine"]
            if not row.get("error") and row["threshold_deg"] is None and row["loss_db"] is not None and not row["broken"]]
    marks = tuple(
        Mark(name, _microseconds(row), -row["loss_db"], bool(row["pareto"]), bool(row["variant"])) for name, row in named)
    front = sorted((row for row in rows if row["pareto"]), key=lambda row: -row["cycles"])
    whole, last = _microseconds(front[0]), front[-1]
    if last is front[0]:
        cost = f"No setting buys time with accuracy: every frame takes {whole:,.1f} µs."
        more = ""
    else:
        saved = whole - _microseconds(last)
        cost = (f"A decibel costs about {saved / last['loss_db']:.1f} µs of a frame of {whole:,.1f} µs: going to "
                f"{_short(last)}, saves {saved:.1f} µs and loses {last['loss_db']:.1f} dB.")
        more = ""
        if len(front) > 2:
            first = front[1]
            more = (f"The last {first['loss_db']:.2f} dB are the dearest: giving them up ({_short(first)}) saves "
                    f"{whole - _microseconds(first):.1f} µs. ")
    for row in (row for row in rows if row["variant"]):
        change = -row["loss_db"]
        more += (f"Trained levels (model {row['value']}) take {_microseconds(row):.1f} µs and are {abs(change):.1f} dB "
                 f"{'better' if change > 0 else 'worse'} than the scene's own model. ")
    more += "Shorter words save area, but no time."
    judged = "against photographs" if content["photographs"] else "assumed photographs"
    return Frontier("machine", "The machine", f"time of a frame at {CLOCK_GHZ:g} GHz, µs", f"change of PSNR, dB ({judged})",
                    marks, tuple((_microseconds(row), -row["loss_db"]) for row in rows
                                 if not any(row is other for _, other in named)), cost, more.strip(), linear_db=0.1)


SIMULATORS = {"oracle": "float64 oracle: exact", "float kernel": "float32 kernel", "integer golden": "integers: the RTL's bits",
              "cycle model": "+ cycle model", "RTL": "RTL: bits and cycles"}
"""Names in the diagram by the names of the content."""


def _simulation(content: Content) -> Frontier:
    rows = {row["name"]: row for row in content["simulation"]["rows"]}
    finite = [row["psnr_oracle_db"] for row in rows.values() if row["psnr_oracle_db"] < EXACT_DB]
    top = max(finite) + 10  # an exact picture has no decibels and is drawn above all others
    times = {name: 1e3 * row["wall_s"] for name, row in rows.items()}
    shown = {name: min(row["psnr_oracle_db"], top) for name, row in rows.items()}
    order = sorted(rows, key=lambda name: (times[name], -shown[name]))
    front = {order[i] for i in pareto([(times[name], -shown[name]) for name in order])}
    marks = tuple(Mark(SIMULATORS[name], times[name], shown[name], name in front) for name in order)
    quick, bits, model = rows["float kernel"], rows["integer golden"], rows["cycle model"]
    nearer = quick["psnr_oracle_db"] - bits["psnr_oracle_db"]
    cost = (f"Decibels cost a simulation nothing: the float32 kernel is {nearer:.0f} dB nearer to float64 than the hardware's "
            f"integers, and takes {times['float kernel']:.0f} ms a frame instead of {times['integer golden']:.0f} ms.")
    error = f"{100 * abs(model['cycle_error']):.3f} %" if model["cycle_error"] is not None else "an unknown error"
    more = (f"What costs time is the hardware's own truth: its cycles, with an error of {error}, take "
            f"{times['cycle model']:.0f} ms")
    if "RTL" in rows:
        more += f", and the RTL itself {rows['RTL']['wall_s']:.1f} s, {times['RTL'] / times['cycle model']:,.0f} times as long"
    return Frontier("simulation", "The simulator", f"wall time of a frame of {content['simulation']['size']}, ms",
                    "PSNR against float64, dB (exact on top)", marks, (), cost, f"{more}.", log_time=True)


def _run_of(content: Content) -> Mapping[str, Any]:
    """The run of the content's scene, or else the first one."""
    runs = content["training"]
    return next((run for run in runs if run["scene"] == content["scene"] and run["curve"]["iteration"]), runs[0])


def _spread(points: Sequence[tuple[float, float]], count: int) -> list[tuple[float, float]]:
    """As many points of a frontier, with the first and the last, spread evenly over the logarithm of its times."""
    if len(points) <= count:
        return list(points)
    ratio = (points[-1][0] / points[0][0]) ** (1 / (count - 1))
    wanted = [points[0][0] * ratio**i for i in range(count)]
    chosen = {min(range(len(points)), key=lambda i: abs(points[i][0] - time)) for time in wanted}
    return [points[i] for i in sorted(chosen | {0, len(points) - 1})][-count:]


def _training(content: Content) -> Frontier:
    run = _run_of(content)
    curve = list(zip(run["curve"]["seconds"], run["curve"]["psnr"], strict=True))
    if not curve:  # a run without a curve has the ends of its stages only
        curve = [(stage["seconds"], stage["psnr"]) for stage in run["stages"] if stage["level"] == 1]
    front = [curve[i] for i in pareto([(seconds, -psnr) for seconds, psnr in curve])]
    shown = _spread(front, MOST_LABELS)
    end, best = front[-1]
    dear = end - next(seconds for seconds, psnr in front if psnr >= best - 1)
    cheap = [psnr for seconds, psnr in front if seconds <= front[0][0] + dear][-1] - front[0][1]
    name = f"{run['scene']}-{run['variant']}"
    cost = (f"The last decibel takes {dear:.0f} s of the {end:.0f} s in which the dense model {name} still improves; the same "
            f"time gains {cheap:.1f} dB at the beginning.")
    stages = {stage["stage"]: stage for stage in run["stages"]}
    more = ""
    if "dense" in stages and "finetune" in stages:
        dense, small = stages["dense"], stages["finetune"]
        more = (f"Pruning takes {small['seconds'] - dense['seconds']:.0f} s more and trades "
                f"{dense['psnr'] - small['psnr']:.1f} dB of test views for "
                f"{100 * (1 - small['entries'] / dense['entries']):.0f} % fewer intersections a frame.")
    marks = tuple(Mark(f"{seconds:,.0f} s: {psnr:.1f} dB", seconds, psnr) for seconds, psnr in shown)
    return Frontier("training", "The training", "seconds of training", "PSNR of training views, dB", marks, tuple(curve), cost,
                    more, log_time=True)
