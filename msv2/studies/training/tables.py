"""Makes the paper's tables for scenes: compared representations, ablated techniques, pruning by gate and criterion, latency."""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from tqdm import tqdm

from golden.diff.gaussians import Gaussians, to_model
from golden.scenes.camera import Camera
from golden.scenes.load import EMBEDDED
from golden.scenes.request import make_folder, parse_size
from golden.training.chain import Chain
from golden.training.finished_runs import FinishedRun, find_run
from golden.training.plots import read_log
from golden.training.recipe import DEFAULTS, EMBEDDED_FULL, FULL, RESULTS, Recipe, full_points, plan
from golden.training.run import chosen_recipe, chosen_scene, run_options
from golden.training.scene import EMBEDDED_SIZE, TrainingScene
from msv2.studies.page import write_page
from msv2.studies.record import write_report
from msv2.studies.training import ablation, comparison, labels, latency
from msv2.studies.training.pruning_table import pruning_rows
from msv2.studies.training.rtl_cycles import RtlCycles, rtl_cycles
from msv2.studies.training.table_runs import LEVELS, PLAIN, SCALE_DECAY, SEPARATE, Trained, part_plan, parts_of
from msv2.studies.training.tables_plot import Shown, save_plots
from msv2.studies.training.tables_text import markdown
from spec.errors import InputError


@dataclass(frozen=True)
class Wanted:
    """A scene as the command line names it.

    Attributes:
        path: 'embedded' or a folder of photographs.
        options: options of `golden/train.py` by the attributes of its parsed arguments; None stands for the value of a finished
            run, or else for the default.
    """

    path: str
    options: dict[str, Any]

    @property
    def keys(self) -> dict[str, Any]:
        """The options under the names that runs record; None for those that were not given."""
        place = self.path if self.path == EMBEDDED else str(Path(self.path).resolve())
        names = {"variant": "variant", "size": "size", "iterations": "iterations", "max_points": "max-points", "seed": "seed"}
        return {"scene": place, **{key: self.options[name] for name, key in names.items()}}


def wanted_scenes(args: argparse.Namespace) -> list[Wanted]:
    """The scenes of the command line. An argument `PATH@WxH` has a size of its own.

    Raises:
        InputError: a size is not valid, or is missing with `--full`, whose number of points follows from it.
    """
    result = []
    for text in args.scenes or [EMBEDDED]:
        path, _, own = text.rpartition("@") if "@" in text and text.rpartition("@")[2][:1].isdigit() else (text, "", "")
        size = own or args.size
        options = {name: getattr(args, name) for name in ("variant", "iterations", "max_points", "seed")}
        if size:
            options["size"] = "{}x{}".format(*parse_size(size))
        if args.full:
            if not size and path != EMBEDDED:
                raise InputError(f"scene {path!r} is not accepted with --full: name its size, as in {path}@504x378")
            full = EMBEDDED_FULL if path == EMBEDDED else FULL
            points = full_points(parse_size(size) if size else EMBEDDED_SIZE)
            options |= {name: value for name, value in (full | {"max_points": points}).items() if options[name] is None}
        result.append(Wanted(path, {"size": None, **options}))
    return result


@dataclass(frozen=True)
class Prepared:
    """A scene that is ready for training.

    Attributes:
        scene: photographs and cameras.
        references: a description of the photographs.
        recipe: the recipe of the tables' chain.
        ready: the results of the finished run, by stage.
        spent: the time of its stages.
        records: its log.
        options: the options of the chain.
    """

    scene: TrainingScene
    references: str
    recipe: Recipe
    ready: dict[str, Any]
    spent: dict[str, dict[str, float]]
    records: list[dict[str, Any]]
    options: dict[str, Any]


def prepare(wanted: Wanted, runs: Path, device: str) -> Prepared:
    """The scene, with the results of a finished run in `runs` if there is one.

    Raises:
        InputError: an option is not accepted, or nothing can be trained from the scene.
    """
    run = find_run(runs, wanted.keys)
    if run is not None:
        prepared = _from_run(wanted, run, device)
        if prepared is not None:
            return prepared
    defaults = {"variant": "H", "seed": 0}
    given = {name: defaults.get(name) if value is None else value for name, value in wanted.options.items()}
    args = argparse.Namespace(scene=wanted.path, source=None, baseline=None, enhancement=True, full=False, gate="psnr",
                              pooling="blocks", pooling_width=None, **given)
    recipe = chosen_recipe(args)
    scene, references = chosen_scene(wanted.path, parse_size(args.size) if args.size else None, None)
    return Prepared(scene, references, recipe, {}, {}, [], run_options(args, recipe, scene, device) | {"reused": None})


def _from_run(wanted: Wanted, run: FinishedRun, device: str) -> Prepared | None:
    """The scene with a finished run's results; None if nothing is left of the run, or if its stages differ from today's."""
    options, last = run.options, run.last()
    if last is None:
        return None
    dense = last.results["dense"] if options["from"] else None
    points = options["max-points"] or DEFAULTS["max_points"]  # a run from a given dense model has no cap
    recipe = Recipe(options["variant"], None, True, options["iterations"], points, options["seed"], options["pooling-width"],
                    options["gate"], options["pooling"])
    scene, references = chosen_scene(wanted.path, parse_size(options["size"]), dense)
    if tuple(last.plan) != tuple((stage.name, stage.total) for stage in plan(recipe, scene, device, dense)):
        return None
    options = options | {"device": device, "reused": run.fingerprint}
    return Prepared(scene, references, recipe, last.results, last.spent, run.records, options)


def train_scene(
    prepared: Prepared, device: str, work: Path, parts: Sequence[str], note: Callable[[str], None],
) -> Trained:
    """Trains some parts of a scene's models. An interrupted chain continues, and a finished one is not made again.

    Args:
        prepared: the scene.
        device: the device on which to train.
        work: the folder of the chains: a folder per scene and set of options, with one chain per part.
        parts: names of table_runs.PARTS.
        note: is called with messages.
    """
    key = hashlib.sha256(json.dumps(prepared.options, sort_keys=True).encode()).hexdigest()[:8]
    folder = work / f"{prepared.scene.name}-{key}"
    results, spent, records = dict(prepared.ready), dict(prepared.spent), list(prepared.records)
    if prepared.ready:
        note(f"{prepared.scene.name}: from a finished run")
    for part in parts:
        stages = part_plan(part, prepared.recipe, prepared.scene, device, dict(results))
        if not stages:
            continue
        begun = any((folder / part / "checkpoints").glob("iteration_*.pt"))
        note(f"{prepared.scene.name}, {part}: {'going on in' if begun else 'training in'} {folder / part}")
        options = prepared.options | {"part": part}
        chain = Chain(stages, make_folder(folder / part), options, resume=begun, classes=RESULTS)
        results |= chain.run()
        spent |= chain.spent
        records += read_log(chain.log_path)
    results = {name: left.to(device) if hasattr(left, "to") else left for name, left in results.items()}
    return Trained(prepared.recipe, results, {name: each["seconds"] for name, each in spent.items()}, records)


def measure_scene(
    prepared: Prepared, trained: Trained, tables: Sequence[str], *, edge: int,
    rtl: Callable[[Gaussians, Camera], RtlCycles] | None,
) -> tuple[dict[str, Any], Shown]:
    """The scene's results for the requested tables as JSON-ready values, and the data for its plots."""
    scene = prepared.scene
    record = {
        "scene": scene.name, "size": list(scene.size), "references": prepared.references,
        "options": {**prepared.options, **{name: Path(prepared.options[name]).name  # without the folders of this machine
                                           for name in ("scene", "from") if prepared.options.get(name)}},
        "views": {"train": len(scene.train), "validation": len(scene.validation), "test": len(scene.judged),
                  "doubtful_test": len(scene.test) - len(scene.judged)},
        "seconds": trained.seconds}
    shown = Shown(scene.name, (), (), ())
    if "representations" in tables:
        record |= _representations(scene, trained)
        shown = replace(shown, curves=trained.curves, plain_curves=trained.plain_curves)
    if "ablation" in tables:
        record["ablation"] = _ablation(scene, trained)
    if "pruning" in tables:
        rows = pruning_rows(scene, trained)
        record["pruning"] = [row.record(rows[0]) for row in rows]
    if "latency" in tables:
        record["latency"], versions = _latency(scene, trained, edge, rtl)
        shown = replace(shown, versions=versions)
    return record, shown


def _representations(scene: TrainingScene, t: Trained) -> dict[str, Any]:
    methods = {labels.SMFR: t.smfr, labels.MMFR: t.mmfr, labels.OURS: t.ours, labels.PLAIN: t.plain}
    seconds = {labels.MMFR: t.seconds_of(SEPARATE), labels.OURS: t.seconds_of(LEVELS),
               labels.PLAIN: t.seconds_of(tuple(name + PLAIN for name in LEVELS))}
    compared = {row.method: row for row in comparison.compare(scene, methods, seconds, t.recipe.pooling)}
    return {
        "comparison": [row.record() for row in compared.values()],
        "fewer_percent": comparison.fewer_percent(compared[labels.OURS], compared[labels.PLAIN]),
        "level_curves": {labels.OURS: [asdict(curve) for curve in t.curves],
                         labels.PLAIN: [asdict(curve) for curve in t.plain_curves]}}


def _ablation(scene: TrainingScene, t: Trained) -> list[dict[str, Any]]:
    of = t.results
    return [row.record() for row in ablation.ablate(scene, (
        (labels.DENSE, of["dense"]), (labels.DECAYED, of[SCALE_DECAY]), (labels.PRUNED, of["prune"]),
        (labels.TUNED, of["finetune"]), (labels.FOVEATED, t.plain), (labels.ENHANCED, t.ours)))]


def _latency(
    scene: TrainingScene, t: Trained, edge: int, rtl: Callable[[Gaussians, Camera], RtlCycles] | None,
) -> tuple[dict[str, Any], list[latency.Version]]:
    camera = latency.frame_camera(scene.cameras[scene.test[0]], edge)
    with tqdm(total=len(latency.CRITERIA) * len(latency.REMOVED), desc="latency", unit="frame", disable=None) as progress:
        versions = latency.measure(t.results["dense"], scene, edge=edge, rtl=rtl, progress=progress.update)
    return {"size": [camera.width, camera.height], "view": scene.test[0],
            "versions": [version.record() for version in versions],
            "proportionality": latency.proportionality(versions)}, versions


def simulate(scene: TrainingScene, folder: Path) -> Callable[[Gaussians, Camera], RtlCycles]:
    """A function that gives the RTL's cycles of a model's frame. Simulated frames are kept in `folder`."""
    return lambda gaussians, camera: rtl_cycles(to_model(gaussians, up=scene.up, name=scene.name), camera, folder)


def make_tables(args: argparse.Namespace, tables: Sequence[str], device: str) -> dict[str, Any]:
    """Trains what is missing, measures, and writes NAME.json, NAME.md and, if there is anything to plot, NAME.png.

    Args:
        args: the parsed command line.
        tables: names of labels.TABLES.
        device: the device on which to train.

    Returns:
        The content of the JSON file.

    Raises:
        InputError: an option is not accepted, nothing can be trained from a scene, or an RTL frame is not bit-exact.
        Interrupted: SIGINT was received; the same command continues.
    """
    out, work = make_folder(args.out), make_folder(args.work)
    scenes, shown = [], []
    for wanted in wanted_scenes(args):
        begin = time.monotonic()
        prepared = prepare(wanted, Path(args.runs), device)
        trained = train_scene(prepared, device, work, parts_of(tables), lambda text: print(text, file=sys.stderr))
        rtl = simulate(prepared.scene, work / "rtl") if args.rtl else None
        record, plots = measure_scene(prepared, trained, tables, edge=args.edge or latency.EDGE, rtl=rtl)
        print(f"{prepared.scene.name}: {time.monotonic() - begin:.0f} s", file=sys.stderr)
        scenes.append(record)
        shown.append(plots)
        write(out, args.name, scenes, shown, args)
    return {"scenes": scenes}


def write(
    folder: Path, name: str, scenes: list[Mapping[str, Any]], shown: list[Shown], args: argparse.Namespace | None = None,
) -> None:
    """Writes the files for the scenes that are finished so far. `args` are the arguments for the provenance."""
    modules = [__name__, "golden.train", *["tb.frame.__main__"] * bool(args and args.rtl)]
    inputs = [text.partition("@")[0] for text in (args.scenes if args else ())]
    write_report(folder / f"{name}.json", {"scenes": scenes}, modules, {"arguments": args}, inputs)
    write_page(folder / f"{name}.md", markdown(scenes, f"{name}.png"))
    if any(of.versions or of.curves for of in shown):
        save_plots(shown, folder / f"{name}.png")
