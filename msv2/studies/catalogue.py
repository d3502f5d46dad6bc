"""The catalogue of studies. It holds the subject of each study, the commands that regenerate its reports, and their state.

    msv2 study list                 lists the studies, one per line
    msv2 study list --reports       lists the reports, with the command, the cost, and whether and why the report is stale
    msv2 study run NAME [OPTION...] runs a study; `msv2 study run NAME --help` shows its options
    msv2 study run NAME --keep      writes its reports into reports/ and docs/ instead of build/
"""

from __future__ import annotations

import hashlib
import importlib
import json
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property

from msv2.studies import destination, record
from spec.command_line import called_as, choice, command_parser
from spec.errors import InputError
from spec.paths import BUILD, REPORTS, ROOT
from spec.private import locked


@dataclass(frozen=True)
class Report:
    """A command of a study, with those of its output files that are kept in the repository.

    Attributes:
        arguments: the arguments of the study's command, as typed in a shell.
        outputs: the files, first the JSON file that has a provenance. A bare name is in reports/; other files are given with
            their folder in the project.
        minutes: the estimated processor time of the command in minutes, used if no provenance has a measured time.
        needs: what the command needs in addition to the project, in words.
    """

    arguments: str
    outputs: tuple[str, ...]
    minutes: float
    needs: str = ""

    @cached_property
    def provenance(self) -> dict | None:
        """The provenance in the JSON file; None if there is none."""
        path = REPORTS / self.outputs[0]
        if not self.outputs[0].endswith(".json") or not path.is_file():
            return None
        return json.loads(path.read_text()).get(record.PROVENANCE)

    @property
    def state(self) -> str:
        """The state as `record.state` returns it; a report with a missing file is stale."""
        missing = [name for name in self.outputs if not (ROOT / name if "/" in name else REPORTS / name).is_file()]
        if missing:
            return f"stale: {missing[0]} is missing"
        if not self.outputs[0].endswith(".json"):
            return "unknown: no JSON is beside it"
        return record.state(self.provenance)

    @property
    def cost(self) -> str:
        """The processor time in minutes as text: the measured time, or after a tilde the estimate, where no run made all."""
        found = self.provenance or {}
        measured = None if found.get("earlier") else found.get("cpu_seconds")
        return f"{max(measured / 60, 0.1):,.1f}" if measured is not None else f"~{self.minutes:,.0f}"


@dataclass(frozen=True)
class Study:
    """A study: its name, the module that has its `main(argv)`, its subject in one line, and its reports."""

    name: str
    module: str
    about: str
    reports: tuple[Report, ...] = ()
    only: tuple[str, ...] = ()
    """Arguments that are put before those of the command line. They select the study's part of a module with several parts."""
    kept_by: tuple[str, ...] = ()
    """What `--keep` stands for where the study writes elsewhere than `msv2.studies.destination` expects."""

    def command(self, report: Report | None = None) -> str:
        """The command that runs the study, or that regenerates one of its reports."""
        return f"msv2 study run {self.name} {report.arguments if report else ''}".rstrip()


def _files(name: str, *kinds: str) -> tuple[str, ...]:
    return tuple(f"{name}.{kind}" for kind in kinds)


def _tradeoff(name: str) -> tuple[str, ...]:
    parts = ("machine", "simulation", "training")
    drawn = ("machine", "simulation", "settings", "crops", *(("training", "runs") if name == "tradeoff" else ()))
    return (*_files(name, "json", "md", "html"), *(f"{name}_{part}.csv" for part in parts), *(f"{name}_{p}.png" for p in drawn))


BY_OUT = ("--out", str(REPORTS))
"""`--keep` of studies that write into a folder of their own unless `--out` names another."""

SCENES, PDK, TORCH = "scenes in MSV2_DATA", "liberty files in MSV2_PDK", "torch"

STUDIES = (
    Study("accuracy", "msv2.studies.accuracy.study", "the integer golden renderer against the float64 oracle",
          (Report("--keep", _files("accuracy", "json", "md"), 3, SCENES),)),
    Study("accuracy_stereo", "msv2.studies.accuracy.stereo", "depths and disparities against the float64 oracle",
          (Report("--keep", _files("accuracy_stereo", "json", "md"), 3, SCENES),)),
    Study("area", "msv2.studies.area.study", "area and clocks of the machine, by build, beside the paper's",
          (Report("--keep", _files("area", "json", "md", "png"), 120, PDK),)),
    Study("area_eyes", "msv2.studies.area.eyes", "area and timing of the units that two eyes in one list need",
          (Report("--keep", _files("area_eyes", "json", "md"), 30, PDK),)),
    Study("colour", "msv2.studies.colour.study", "errors, products and gates of the colour unit",
          (Report("--keep", ("colour.json",), 10),)),
    Study("combinations", "msv2.studies.overlap.combinations",
          "small machines in every combination of streams, packed frames, overlap and eyes, through the RTL",
          (Report("--keep", ("combinations.json",), 10),)),
    Study("coverage", "msv2.studies.coverage.study", "which bits change and which ways are taken in the units' quick suites",
          (Report("--keep", _files("coverage", "json", "md"), 15),)),
    Study("culling_area", "msv2.studies.area.culling", "one culling pipeline against several that share operators",
          (Report("--keep", ("culling_area.json",), 15, PDK),)),
    Study("dense_check", "msv2.studies.training.dense_check", "defaults of dense training against others",
          (Report("build/train/bonsai --size 200x133 --keep", _files("dense_check", "json", "md"), 20,
                  f"{TORCH}, a data set"),)),
    Study("drain_waits", "msv2.studies.drain_waits.study", "cycles that the end of a tile waits for the array's output buffer"),
    Study("effects", "msv2.studies.effects.study", "what frames do not pay for: time, cycles, energy and area by effect",
          (Report("$MSV2_DATA/trained/truck.splat embedded embedded@centre $MSV2_DATA/trained/rock_sh3@centre --rtl 128x72 "
                  "--area --keep", _files("effects", "json", "md", "png"), 120, f"{SCENES}, {PDK}"),),
          kept_by=BY_OUT),
    Study("energy", "msv2.studies.energy.study", "energy of frames, by unit",
          (Report("--keep", _files("energy", "json", "md", "png"), 2, SCENES),)),
    Study("energy_anchors", "msv2.studies.energy_anchors.study", "the energy of the same units at 16 nm by two libraries",
          (Report("--keep", _files("energy_anchors", "json", "md"), 8, PDK),)),
    Study("energy_per_operation", "msv2.studies.energy_per_operation.study",
          "energies of operations, measured on mapped netlists at work",
          (Report("--keep", ("energy_per_operation.json",), 120, f"{SCENES}, {PDK}"),)),
    Study("equivalence", "msv2.studies.equivalence.study", "whether the hardware of two commits is the same"),
    Study("formal", "msv2.studies.formal.study", "claims of the units, proven for all inputs",
          (Report("--keep", _files("formal", "json", "md"), 30, "the extra `synth`"),)),
    Study("fpga", "msv2.studies.fpga.study", "LUTs, flip-flops, memories and multipliers of every unit on FPGAs",
          (Report("--keep", ("fpga.json",), 30),)),
    Study("frames", "msv2.studies.results.study", "frames through the RTL, compared with the golden renderer in every bit",
          (Report("--keep", ("frames.json",), 25, SCENES),), ("--only", "frames")),
    Study("frames_v3", "msv2.studies.results.study", "the same on the machine `v3`, also with a camera inside the model",
          (Report("--keep", ("frames_v3.json",), 25, SCENES),), ("--only", "frames_v3")),
    Study("frames_streams", "msv2.studies.results.study", "the same on `v3` with four arrays and packed frames",
          (Report("--keep", ("frames_streams.json",), 20, SCENES),), ("--only", "frames_streams")),
    Study("frames_eyes", "msv2.studies.results.study", "joint frames of both eyes on `v3_eyes`, through the RTL",
          (Report("--keep", ("frames_eyes.json",), 20, SCENES),), ("--only", "frames_eyes")),
    Study("frames_overlap", "msv2.studies.overlap.rtl",
          "frames in a row on machines whose phases overlap, through the RTL and by the cycle model",
          (Report("--keep", _files("frames_overlap", "json", "md"), 60, SCENES),)),
    Study("gallery", "msv2.studies.gallery.study", "a frame of a scene in every way of drawing it, and the README's pictures",
          (Report("--keep", ("docs/gallery.md", *(f"docs/images/{name}" for name in (
              "foveated.png", "renderers.png", "film.webp", "film.png", *(
                  f"gallery_{name}.jpg" for name in ("plain", "foveated", "levels", "depth", "stereo", "error"))))), 0.5),)),
    Study("judge", "msv2.studies.training.judge_study", "what FovVideoVDP says of trained models: frames and levels",
          (Report("build/train/bonsai build/train/fern --keep", _files("judge", "json", "md"), 0.5,
                  f"runs in build/train, pyfvvdp, {SCENES}"),)),
    Study("latencies", "msv2.studies.latencies.study", "latencies of the RTL's units, in Amaranth's simulator",
          (Report("--keep", ("latencies.json",), 3),)),
    Study("machine", "msv2.studies.results.study", "cycles of the machine with and without merging and pipelining",
          (Report("--keep", ("machine.json",), 40, SCENES),), ("--only", "machine")),
    Study("machine_timing", "msv2.studies.machine_timing.study",
          "`paper` and `v3` timed as one at two corners: late paths by the units that they cross",
          (Report("--keep", (*_files("machine_timing", "json", "md"), "machine_budget.json"), 150, f"OpenSTA, {PDK}"),)),
    Study("memory_sizes", "msv2.studies.memory_sizes.study", "area of machines if small memories cost more a bit",
          (Report("--keep", _files("memory_sizes", "json", "md"), 0.2, PDK),)),
    Study("metric_scale", "msv2.studies.metric_scale.study", "units per metre of a scene, from a metric depth map"),
    Study("model", "msv2.studies.model.study", "the cycle model against the RTL",
          (Report("--keep", _files("model", "json", "md"), 5, SCENES),
           Report("--rtl --keep", ("model_rtl.json",), 50, SCENES))),
    Study("mutants", "msv2.studies.mutants.study", "small faults in the units' circuits, and how many the quick suites notice",
          (Report("--keep", _files("mutants", "json", "md"), 40, "the extra `synth`"),)),
    Study("order", "msv2.studies.results.study", "how far the machine's order of splats is from the exact one",
          (Report("--keep", ("order.json",), 3, SCENES),), ("--only", "order")),
    Study("overlap", "msv2.studies.overlap.study", "frames in a row whose phases overlap: cycles",
          (Report("--keep", _files("overlap", "json", "md"), 10, SCENES),)),
    Study("packed_frames", "msv2.studies.packed_frames.study", "bytes of packed frames over those of unpacked ones",
          (Report("--keep", _files("packed_frames", "json", "md"), 2, SCENES),)),
    Study("performance", "msv2.studies.performance.study", "machines on the same frames, a GPU's roofline too",
          (Report("--keep", (*_files("performance", "json", "md"), *(f"performance_{name}.png" for name in (
              "area", "bandwidth", "bars", "sweeps", "tiles", "timeline"))), 30, f"{SCENES}, runs in build/train"),)),
    Study("pooling", "msv2.studies.training.pooling", "what the display's pixels do to the levels of training",
          (Report("build/train/fern build/train/fern-pooled --keep", ("pooling.json",), 0.1, "runs in build/train"),)),
    Study("presets", "msv2.studies.presets.study", "what accuracy buys on `v3`: harmonics, points and support radius",
          (Report("--keep", _files("presets", "json", "md"), 3, SCENES),)),
    Study("ranges", "msv2.studies.ranges.study", "values that the records of real frames take",
          (Report("--keep", _files("ranges", "json", "md", "png"), 3, SCENES),)),
    Study("report", "msv2.studies.report.study", "area, energy and performance as one page in build/report"),
    Study("results", "msv2.studies.results.study", "everything that the generated tables rest on, and the tables themselves"),
    Study("sorting", "msv2.studies.sorting.study", "how fast the sorter takes the groups of scenes' frames",
          (Report("--keep", ("sorting.json",), 10, SCENES),)),
    Study("source_mutants", "msv2.studies.source_mutants.study", "small faults in spec and golden, and what notices them",
          (Report("--count spec=40 --count golden=150 --keep", _files("source_mutants", "json", "md"), 75),)),
    Study("speed", "msv2.studies.speed.study", "speed of the renderers, and of training iterations",
          (Report("embedded $MSV2_DATA/trained/truck.splat --repeat 9 --keep", _files("bench", "json", "md"), 15,
                  f"{SCENES}, {TORCH}"),)),
    Study("splat_cache", "msv2.studies.splat_cache.study", "misses of splat caches of other sizes and kinds",
          (Report("--keep", _files("splat_cache", "json", "md"), 2, SCENES),)),
    Study("stability", "msv2.studies.stability.study", "the hard cases on all renderers, and seeded faults",
          (Report("--keep", _files("stability", "json", "md", "png"), 10, TORCH),)),
    Study("stereo_rules", "msv2.studies.stereo_rules.study", "rules of filling the holes of a warped eye",
          (Report("--keep", _files("stereo_rules", "json", "md"), 10, f"{SCENES}, {TORCH}, runs in build/train"),)),
    Study("synthesis", "msv2.studies.results.study", "area and slack of single units in ASAP7",
          (Report("--keep", ("synthesis.json",), 60, PDK),), ("--only", "synthesis")),
    Study("threshold", "msv2.studies.threshold.study", "the threshold of selective warping: quality, work and cost of two eyes",
          (Report("$MSV2_DATA/trained/garden_large $MSV2_DATA/trained/truck.splat build/train/embedded --train-v1 "
                  "--keep", _files("table_ecc", "json", "md", "png"), 90, f"{SCENES}, {TORCH}, a run in build/train"),),
          kept_by=BY_OUT),
    Study("tile_size", "msv2.studies.tile_size.study", "why a tile has 16 pixels: work, cycles and area at 8, 16 and 32",
          (Report("--keep", ("tile_size.json", "docs/tile_size.md"), 2, SCENES),)),
    Study("tradeoff", "msv2.studies.tradeoff.study", "what accuracy costs in time: machine, simulation and training",
          (Report("--variant H=build/train/embedded --rtl --keep", _tradeoff("tradeoff"), 60, "runs in build/train"),
           Report("$MSV2_DATA/trained/truck.splat --size 320x180 --views 1 --runs none --keep --name tradeoff_truck",
                  _tradeoff("tradeoff_truck"), 60, SCENES)), kept_by=BY_OUT),
    Study("training", "msv2.studies.training.study", "the paper's tables of training",
          (Report("embedded --keep --name training", _files("training", "json", "md", "png"), 150, TORCH),
           Report("$MSV2_DATA/posed/fern@504x378 --tables representations,ablation --max-points 60000 --iterations 8000 --keep "
                  "--name training_fern", _files("training_fern", "json", "md", "png"), 200, f"{SCENES}, {TORCH}")),
          kept_by=BY_OUT),
    Study("training_headline", "msv2.studies.training.headline", "what training reaches: a row for each scene and variant",
          (Report("build/train/bonsai build/train/fern --keep", ("training_headline.json",), 0.1, "runs in build/train"),)),
    Study("trust", "msv2.studies.trust.study", "what speaks for the RTL: proofs, mutants, seeded faults, spoilt files, frames",
          (Report("--keep", _files("trust", "json", "md", "png"), 10),)),
    Study("two_eyes", "msv2.studies.two_eyes.study", "a second eye from the same lists by super-tile: cycles and pixels",
          (Report("--keep", _files("two_eyes", "json", "md"), 10, SCENES),)),
    Study("two_eyes_warp", "msv2.studies.two_eyes.warp", "a warped second eye on top of joint frames: cycles and pixels",
          (Report("--keep", _files("two_eyes_warp", "json", "md"), 10, SCENES),)),
    Study("untrained_levels", "msv2.studies.untrained_levels.study", "levels of models that were not trained for them",
          (Report("--keep", ("untrained_levels.json",), 5, SCENES),)),
    Study("v3", "msv2.studies.v3.study", "what the steps from `paper` to `v3` give: bytes, cycles, energy, photographs",
          (Report("--keep", _files("v3", "json", "md"), 15, f"{SCENES}, {TORCH}, runs in build/train"),)),
    Study("wires", "msv2.studies.wires.study", "units placed with coloquinte: what their wires cost in delay and energy",
          (Report("--keep", _files("wires", "json", "md"), 12, f"coloquinte, OpenSTA, {PDK}"),)),
    Study("write_combining", "msv2.studies.write_combining.study", "writes of intersections that waiting beats would save",
          (Report("--keep", _files("write_combining", "json", "md"), 2, SCENES),)),
)
"""All studies, sorted by name."""

BY_NAME = {study.name: study for study in STUDIES}


def find(name: str) -> Study:
    """The study with this name.

    Raises:
        InputError: there is no study of this name; the message suggests the most similar name.
    """
    return BY_NAME[choice("study", name, BY_NAME)]


def run_study(argv: Sequence[str]) -> int:
    """Runs the study that the first argument names, with the other arguments; returns its exit status.

    Raises:
        InputError: no study is named, or there is no study of this name.
    """
    name, *rest = argv or [""]
    if name in ("", "-h", "--help"):
        if name:
            print(__doc__)
            return 0
        raise InputError(f"no study is named: choose one of {', '.join(BY_NAME)}")
    study = find(name)
    record.begin(name, rest)
    keep, named = destination.KEEP in rest, any(word == "--out" or word.startswith("--out=") for word in rest)
    if keep and named:
        raise InputError(f"{destination.KEEP} is not accepted together with --out: one of them says where the report goes")
    destination.tell(keep=keep, named=named)
    words = [word for word in rest if word != destination.KEEP]
    with called_as(study.command()), _alone(name, words):
        try:
            return importlib.import_module(study.module).main([*study.only, *words, *study.kept_by * keep]) or 0
        finally:
            if {"-h", "--help"} & {*words}:
                print(f"\n{destination.HELP}")


@contextmanager
def _alone(name: str, words: Sequence[str]) -> Iterator[None]:
    """Waits while another run of the study writes to the same place: to the default one, or to that behind `--out`."""
    place = " ".join(word for i, word in enumerate(words) if word.startswith("--out") or "--out" in words[max(i - 1, 0) : i])
    folder = BUILD / "running"
    folder.mkdir(parents=True, exist_ok=True)
    notice = f"waiting for another run of study {name}, which writes to the same place; --out DIR names another one"
    with locked(folder / f"{name}-{hashlib.sha256(place.encode()).hexdigest()[:8]}", notice):
        yield


def list_studies(argv: Sequence[str] = ()) -> int:
    """Prints a list of the studies, or with --reports of their reports; returns the exit status.

    Raises:
        InputError: there is no study of a given name.
    """
    with called_as("msv2 study list"):
        parser = command_parser("msv2 study list", "The studies and the state of their reports.")
    parser.add_argument("names", nargs="*", metavar="NAME", help="show only these studies (default: all)")
    parser.add_argument("--reports", action="store_true", help="list reports: command, cost, and why a report is stale")
    args = parser.parse_args(argv)
    studies = [find(name) for name in args.names] or list(STUDIES)
    print("\n".join(_report_lines(studies) if args.reports else _study_lines(studies)))
    return 0


def _study_lines(studies: Sequence[Study]) -> list[str]:
    lines = [f"{'study':<22}{'CPU-minutes':>12}  {'reports':<9} about"]
    for study in studies:
        states = {report.state.partition(":")[0] for report in study.reports}
        worst = next((state for state in ("stale", "unknown", "current") if state in states), "none")
        cost = " + ".join(report.cost for report in study.reports) or "-"
        lines.append(f"{study.name:<22}{cost:>12}  {worst:<9} {study.about}")
    return [*lines, "", "~ marks an estimate. A report is current, stale, or unknown if it was written before reports had a "
            "provenance.", "`msv2 study list --reports` says why. `msv2 study run NAME` runs a study."]


def _report_lines(studies: Sequence[Study]) -> list[str]:
    lines = []
    for study in studies:
        for report in study.reports:
            needs = f"; needs {report.needs}" if report.needs else ""
            lines += [f"{study.command(report)}",
                      f"    writes {', '.join(report.outputs)}; {report.cost} CPU-minutes{needs}", f"    {report.state}"]
    return lines
