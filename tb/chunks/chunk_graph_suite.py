"""The chunk test's datapath alone: every reason and every box of tiles that it finds is compared with the golden renderer's.

The unit shows only which headers leave it. Its datapath with the details as outputs shows why.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from pathlib import Path

import numpy as np
from amaranth.hdl import Shape

from rtl.chunks.chunk_test import chunk_graph
from rtl.culling.dataflow import Node
from rtl.culling.datapath import Datapath
from rtl.emit import to_verilog
from spec.chunks import TEST_INTERVAL
from spec.config import AcceleratorConfig
from spec.formats import Fixed, SmallFloat
from spec.records import Field, Record, uint
from tb.chunks.chunk_test_stimuli import KINDS, Case, case_of, octagon_patterns
from tb.chunks.chunk_test_suite import DISTINCT, VARIANTS
from tb.common import exact
from tb.common.emission import emitted
from tb.common.exact import Outcome, Planned, planned
from tb.common.playback import Playback, Stream
from tb.common.player import Recording
from tb.common.runner import Waves

__all__ = ["DISTINCT", "VARIANTS", "figures", "full_plan", "run_plan"]

_MODULE = "chunk_graph"


def _verilog(config: AcceleratorConfig) -> str:
    return to_verilog(Datapath(chunk_graph(config, details=True), interval=TEST_INTERVAL), _MODULE)


def _record(name: str, nodes: dict[str, Node]) -> Record:
    """The payload of a stream of the datapath."""
    return Record(name, "", tuple(
        Field(key, node.to if isinstance(node.to, Fixed | SmallFloat) else uint(Shape.cast(node.shape).width), "")
        for key, node in nodes.items()))


@cache
def playback(config: AcceleratorConfig) -> Playback:
    """The datapath of a configuration, emitted as Verilog, with a file at each stream."""
    graph = chunk_graph(config, details=True)
    return Playback(
        name=f"chunk-graph-{config.name}", module=_MODULE, verilog=emitted(_MODULE, config, _verilog),
        inputs=(Stream("sink", _record("ChunkGraphInput", graph.inputs)),),
        outputs=(Stream("source", _record("ChunkGraphOutput", graph.outputs)),),
        settings=tuple((name, sum(node.width for node in nodes)) for name, nodes in graph.ports.items()))


def plan_of(case: Case, name: str) -> Planned:
    """The run that plays the headers of a case's first frame."""
    graph, headers, judged = chunk_graph(case.config, details=True), case.frames[0], case.judged(0)
    rows = np.zeros(len(headers), _record("ChunkGraphInput", graph.inputs).dtype)
    for key in rows.dtype.names:
        field, _, number = key.rpartition("_")
        rows[key] = headers[field][:, int(number)] if field in ("low", "step", "extent") else headers[key]
    wanted = np.zeros(len(headers), _record("ChunkGraphOutput", graph.outputs).dtype)
    wanted["skipped"], wanted["behind"], wanted["nothing"] = ~judged.read, judged.behind, judged.faint | judged.empty
    wanted["outside_x"], wanted["filtered"], wanted["astray"] = judged.outside, judged.filtered, judged.astray
    for end in ("first", "last"):
        for k, axis in enumerate("xy"):
            wanted[f"{end}_{axis}"] = getattr(judged, end)[:, k]
    return planned(name, {"sink": rows}, {"source": masked(wanted)}, settings=settings_of(case))


def settings_of(case: Case) -> dict[str, int]:
    """Bit patterns of the datapath's settings."""
    n, r = case.config.formats, case.registers
    drop = n.view.sig_bits - n.chunk.sig_bits
    numbers = {
        "position": n.view.quantise(r.position), "rotation": n.view.quantise(r.rotation.ravel()) >> drop,
        "near": n.view.quantise(r.near) >> drop, "reach": n.view.quantise(r.reach) >> drop,
        "centre": r.centre >> n.mean2d.frac_bits, "last_tile": [r.tiles_x - 1, r.tiles_y - 1],
        "gaussians": case.gaussians}
    ports, found = chunk_graph(case.config).ports, {}
    for name, values in numbers.items():
        width = ports[name][0].width
        found[name] = sum((int(value) & (1 << width) - 1) << i * width for i, value in enumerate(np.ravel(values)))
    octagons = octagon_patterns(case.config, r, case.rendered)
    return found | {f"octagon_{bound}": bits for bound, bits in enumerate(octagons)}


def masked(rows: np.ndarray) -> np.ndarray:
    """The outputs without those that mean nothing: what lies behind has no box, and what lies outside is not filtered."""
    rows = rows.copy()
    rows["outside_x"] |= rows["outside_y"]
    rows["outside_x"][rows["behind"] == 1] = 0
    rows["outside_y"] = 0
    for name in ("filtered", "first_x", "last_x", "first_y", "last_y"):
        rows[name][(rows["behind"] | rows["outside_x"]) == 1] = 0
    return rows


def _problems(item: Planned, recording: Recording) -> list[str]:
    recording.outputs["source"] = masked(recording.outputs["source"])
    return exact.problems(item, recording)


def full_plan(config: AcceleratorConfig, seed: int) -> list[Planned]:
    """Every kind of header in frames of every size."""
    rng = np.random.default_rng(seed)
    sizes = (None, None, (1, 1), (17, 33), (config.row_width, config.row_width))
    return [plan_of(case_of(config, rng, kind, 500, size), f"details, {kind} {i}") for kind in KINDS
            for i, size in enumerate(sizes)]


def figures(config: AcceleratorConfig, plan: list[Planned], outcome: Outcome) -> list[str]:
    """The share of headers by reason."""
    rows = np.concatenate([item.expected["source"] for item in plan])
    names = ("behind", "outside_x", "filtered", "nothing", "astray", "skipped")
    return [", ".join(f"{name.removesuffix('_x')} {rows[name].mean():.0%}" for name in names)]


def run_plan(
    config: AcceleratorConfig, plan: Sequence[Planned], folder: Path, *, waves: Waves | None = None, progress: bool = False,
) -> Outcome:
    """Plays a plan and compares all results that mean something."""
    return exact.run_plan(playback(config), plan, folder, waves=waves, progress=progress, judge=_problems)
