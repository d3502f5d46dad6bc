"""`make table-effects`: what a scene does not pay for: golden time, cycles, simulation time and area saved by effects left out.

For every frame, the golden renderer runs with what the frame calls for, then with each further effect forced beside it, then
with all of them but a second eye, in turns on one thread; times are the medians of CPU time. The RTL runs the first and the
last of these, each on the machine that has its effects and no others; its times, too, are the processor's. Areas are of
synthesised machines of --area-config at 16 nm, memories included: of what the frame calls for beside all but a second eye,
and of each effect, the machine with it less the same machine without it.
"""

from __future__ import annotations

import argparse
import statistics
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from tqdm import tqdm

from golden import threads as parallel
from golden.msv2_ref.plan import Work, work_for
from golden.scenes.level_source import RANDOM
from golden.scenes.request import make_folder, parse_numbers, parse_size, resolve
from msv2.studies import page
from msv2.studies.effects.area import ONE_EYE, EffectArea, Measure, effect_areas, machine_of, measure_in
from msv2.studies.energy.frame import counter_counts, frame_energy, load_table
from msv2.studies.picture import find_pyplot, save_figure
from msv2.studies.record import liberties, write_report
from msv2.studies.rtl_frame import simulate
from spec.command_line import choice, command_parser
from spec.config import MACHINES, PAPER_SMALL
from spec.effects import EFFECTS, GIVEN, with_two_eyes
from spec.errors import InputError
from spec.extras import how_to_get
from spec.overrides import add_config_arguments, config_from, config_options
from spec.paths import ROOT

EXAMPLES = """examples:
  msv2 study run effects                                   the embedded scene, with and without a gaze
  msv2 study run effects truck.splat embedded@320,180   truck without a gaze, embedded with one; @centre is the frame's
  msv2 study run effects truck.splat --rtl 256x144         and through the RTL, at a size that it can afford
  MSV2_PDK=DIR msv2 study run effects --area               and areas: minutes for each machine not synthesised before
"""

BUT_STEREO = tuple(name for name in EFFECTS if name not in ("stereo", "fill", "rerender", *GIVEN))
SINGLE = {"sh": ("sh",), "levels": ("levels",), "blend": ("levels", "blend"), "depth": ("depth",)}
"""The effects that have arithmetic of their own in both renderers, each with the effects that are forced to measure it."""

CENTRE = "centre"

MACHINE = PAPER_SMALL.name
"""The machine of the RTL's frames if no other one is asked for: one that has every effect."""

RATIOS = ("cycles_ratio", "energy_ratio", "simulation_ratio", "area_ratio")
"""Ratios of the RTL and of its area: all effects but a second eye, divided by the effects that the frame calls for."""

RUNS = 9


@dataclass(frozen=True)
class Frame:
    """A scene with its gaze: a place in pixels of --size, the centre, or None for no gaze."""

    scene: str
    gaze: str | None

    @classmethod
    def parse(cls, text: str) -> Frame:
        """The frame that "SCENE" or "SCENE@X,Y" stands for."""
        scene, _, gaze = text.partition("@")
        return cls(scene, gaze or None)

    def gaze_at(self, size: str, to: str) -> str:
        """The gaze in a frame of size `to`, scaled from a frame of size `size`; both sizes are written as WxH."""
        old, new = parse_size(size), parse_size(to)
        at = [edge / 2 for edge in old] if self.gaze == CENTRE else parse_numbers("gaze", self.gaze, 2)
        return ",".join(f"{a * n / o:g}" for a, n, o in zip(at, new, old, strict=True))

    @property
    def label(self) -> str:
        """A name of the frame for tables."""
        return f"{Path(self.scene).stem}, {'gaze' if self.gaze else 'no gaze'}"


def parse_arguments(argv: Sequence[str] | None) -> argparse.Namespace:
    """The parsed and checked command line."""
    parser = command_parser("msv2 study run effects", __doc__, EXAMPLES)
    parser.add_argument("scenes", nargs="*", default=["embedded", f"embedded@{CENTRE}"], metavar="SCENE[@X,Y]",
                        help="scenes, each with an optional gaze; a gaze gives a model without levels nested random subsets")
    parser.add_argument("--size", default="640x360", metavar="WxH", help="size of the golden frames (default: 640x360)")
    parser.add_argument("--rtl", metavar="WxH", help="also simulate the RTL, at this size")
    add_config_arguments(parser, MACHINE)
    parser.add_argument("--area", action="store_true",
                        help="also synthesise; needs the extra `synth` and liberty files in MSV2_PDK")
    parser.add_argument("--area-config", default="paper", metavar="CONFIG",
                        help="configuration whose area is shown (default: paper)")
    parser.add_argument("--runs", type=int, default=RUNS, metavar="N", help=f"how often each frame is run (default: {RUNS})")
    parser.add_argument("--seed", type=int, default=0, help="seed of the random subsets (default: 0)")
    parser.add_argument("--out", default=ROOT / "build" / "effects", metavar="DIR",
                        help="output folder (default: build/effects)")
    args = parser.parse_args(argv)
    with_two_eyes(config_from(args, MACHINE))  # raises for a wrong configuration before anything is rendered
    with_two_eyes(MACHINES[choice("config", args.area_config, MACHINES)])
    for size in (args.size, args.rtl):
        if size is not None:
            parse_size(size)
    if args.runs < 1:
        raise InputError(f"runs {args.runs} is not accepted: 1 or more is")
    return args


def works(args: argparse.Namespace, frame: Frame) -> dict[str, Work]:
    """The frame with the effects that it calls for ("auto"), with each further effect, and with all but a second eye
    ("most")."""
    gaze, levels = (frame.gaze_at(args.size, args.size), 4) if frame.gaze else ("none", None)
    given = SimpleNamespace(
        scene=frame.scene, camera="orbit", size=args.size, gaze=gaze, levels=levels,
        background="0,0,0", seed=args.seed, stereo=False, depth=False, effects="auto")
    request, config = resolve(given), MACHINES["paper"]
    found = {"auto": work_for(given, request, config)}
    called = found["auto"].plan.called
    for name, forced in {**SINGLE, "most": BUT_STEREO}.items():
        if set(forced) - called:
            given.effects = ",".join(effect for effect in EFFECTS if effect in {*forced, *called})
            found[name] = work_for(given, request, config)
    return found


def golden_seconds(found: dict[str, Work], runs: int, label: str) -> dict[str, float]:
    """The median CPU seconds of each variant. The variants run in turn on one thread.

    Raises:
        ValueError: two variants gave different images.
    """
    threads, parallel.threads = parallel.threads, 1
    try:
        images = {name: work.render() for name, work in found.items()}  # also compiles the kernels
        for name, image in images.items():
            if not np.array_equal(image.pixels.colour, images["auto"].pixels.colour):
                raise ValueError(f"images must be equal, not those of auto and {name!r} of {label}")
        seconds: dict[str, list[float]] = {name: [] for name in found}
        for _ in tqdm(range(runs), desc=label, unit="run"):
            for name, work in found.items():
                begin = time.process_time()
                work.render()
                seconds[name].append(time.process_time() - begin)
    finally:
        parallel.threads = threads
    return {name: statistics.median(times) for name, times in seconds.items()}


def simulated(args: argparse.Namespace, frame: Frame, effects: str, out: Path) -> dict[str, object]:
    """The numbers of frame.json that the report keeps, and the frame's energies.

    Raises:
        InputError: the simulation fails.
    """
    view = ["--gaze", frame.gaze_at(args.size, args.rtl), "--levels", "4", "--levels-from", RANDOM] if frame.gaze else []
    row = simulate(frame.scene, ["--size", args.rtl, *view, *config_options(args), "--machine", "scene", "--effects", effects,
                                 "--seed", str(args.seed)], make_folder(out))
    kept = ("bit_exact", "cycles", "geometry_cycles", "render_cycles", "wall_s", "cpu_s", "dram_bytes")
    spent = frame_energy(counter_counts(row), row["cycles"], config_from(args, MACHINE), load_table())
    return {**{key: row[key] for key in kept}, "chip_mj": spent.chip_mj, "dram_mj": spent.sum_mj("dram")}


def measure(args: argparse.Namespace, text: str, out: Path, area: Measure | None = None) -> dict[str, object]:
    """The row of one frame, with its machine's area if `area` is given."""
    frame = Frame.parse(text)
    found = works(args, frame)
    seconds = golden_seconds(found, args.runs, frame.label)
    most = seconds.get("most", seconds["auto"])
    row: dict[str, object] = {
        "frame": frame.label, "size": args.size, "effects": found["auto"].plan.record, "golden_ms": {
            name: 1e3 * value for name, value in seconds.items()}, "golden_ratio": most / seconds["auto"]}
    if args.rtl:
        both = {name: simulated(args, frame, ",".join(sorted(found[name].plan.active | {"contention"})), out / f"rtl-{name}")
                for name in ("auto", "most") if name in found}
        auto, full = both["auto"], both.get("most", both["auto"])
        energy = [sum(of[part] for part in ("chip_mj", "dram_mj")) for of in (full, auto)]
        row |= {"energy_ratio": energy[0] / energy[1], "rtl_size": args.rtl, "rtl": both,
                "rtl_config": config_from(args, MACHINE).name,
                "cycles_ratio": full["cycles"] / auto["cycles"], "simulation_ratio": full["cpu_s"] / auto["cpu_s"]}
    if area:
        config = MACHINES[args.area_config]
        mm2, most = area(found["auto"].plan.machine(config)), area(machine_of(config, ONE_EYE))
        row |= {"area_config": config.name, "area_mm2": mm2, "area_most_mm2": most, "area_ratio": most / mm2}
    return row


def table(rows: list[dict[str, object]]) -> str:
    """The rows as a Markdown table."""
    head = ["frame", "called for", "auto, ms", *(f"+ {name}" for name in SINGLE), "all but a second eye", "golden", "cycles",
            "energy", "simulation", "area", "area, mm^2"]
    cells = []
    for row in rows:
        ms, called = row["golden_ms"], [n for n, e in row["effects"]["effects"].items() if e["state"] == "called for"]
        single = [f"{ms[name] - ms['auto']:+.1f}" if name in ms else "called for" for name in SINGLE]
        rtl = [f"{row[name]:.2f}x" if name in row else "-" for name in RATIOS]
        cells.append([row["frame"], ", ".join(called) or "nothing", f"{ms['auto']:.1f}", *single,
                      f"{ms.get('most', ms['auto']):.1f}", f"{row['golden_ratio']:.2f}x", *rtl,
                      f"{row['area_mm2']:.3f}" if "area_mm2" in row else "-"])
    return page.table(head, cells)


def area_table(areas: Mapping[str, EffectArea]) -> str:
    """The areas of effects as a Markdown table."""
    return page.table(["effect", "with it, mm^2", "without it", "its own", "share"], [
        [effect, f"{a.with_mm2:.3f}", f"{a.without_mm2:.3f}", f"{a.mm2:z.3f}", f"{a.share:z.1%}"]
        for effect, a in areas.items()])


def draw(rows: list[dict[str, object]], path: Path) -> None:
    """Draws bars of the ratios by which each frame saves. Does nothing without matplotlib."""
    pyplot = find_pyplot()
    if pyplot is None:
        print(f"no picture: matplotlib is not installed; {how_to_get('matplotlib')}")
        return
    names = ("golden_ratio", *(name for name in RATIOS if any(name in row for row in rows)))
    figure, axes = pyplot.subplots(figsize=(8, 3.5), layout="constrained")
    for i, name in enumerate(names):
        step = 0.8 / len(names)
        bars = axes.bar([x + step * (i - (len(names) - 1) / 2) for x in range(len(rows))], [row.get(name, 0) for row in rows],
                        0.9 * step, label=name.removesuffix("_ratio"))
        axes.bar_label(bars, fmt="%.2f", fontsize=7)
    axes.axhline(1, color="grey", linewidth=0.8)
    axes.set_xticks(range(len(rows)), [row["frame"] for row in rows])
    axes.set_ylabel("all but a second eye / called for")
    axes.legend(ncols=len(names), fontsize=8)
    save_figure(figure, path, dpi=120)


def main(argv: Sequence[str] | None = None) -> None:
    """Runs the command line."""
    args = parse_arguments(argv)
    out = make_folder(args.out)
    area = measure_in(ROOT / "build" / "synth") if args.area else None
    areas = effect_areas(MACHINES[args.area_config], area) if area else {}  # first, because its tools may be missing
    rows = [measure(args, text, out, area) for text in args.scenes]
    kept = {name: {**asdict(found), "mm2": found.mm2} for name, found in areas.items()}
    report = {"rows": rows, **({"area_config": args.area_config, "areas": kept} if areas else {})}
    write_report(out / "effects.json", report, [__name__, *["tb.frame.__main__"] * bool(args.rtl)],
                 {"arguments": args, "machine": config_from(args, MACHINE)},
                 [*(Frame.parse(text).scene for text in args.scenes), *(liberties() if areas else [])])
    tables = [table(rows), *([f"Area of the machine {args.area_config!r} at 16 nm:", area_table(areas)] if areas else [])]
    page.write_page(out / "effects.md", "\n\n".join(
        ["# What scenes do not pay for", __doc__.partition(":")[2].strip(), *tables]))
    draw(rows, out / "effects.png")
    print("\n\n".join(tables))
