"""The report's page: a summary with a rendered frame and the main numbers, then the three reports as chapters that fold."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from PIL import Image

from golden.msv2_ref import pipeline
from golden.scenes.files import atomic_output
from golden.scenes.gaze import Display, no_foveation
from golden.scenes.load import load_scene
from golden.scenes.pictures import to_bytes
from golden.scenes.request import resolve
from msv2.studies.memory import ALL_NAMES, IDEAL, LPDDR3
from msv2.studies.page import table
from msv2.studies.performance.frames import request
from msv2.studies.performance.machines import BOTH, GPU, GSCORE
from msv2.studies.web.maker import Chapter, cards, page, picture
from msv2.studies.web.markdown import inline
from spec.config import PAPER

QUALITY = 88
"""JPEG quality of the rendered frame, which is then about 50 KB."""


PICTURES = {"whole": "frame_whole.jpg", "measured": "frame.jpg"}
"""The rendered frames: all splats everywhere, and the foveated frame that is measured."""


def draw_frames(scene: str, size: str, out: Path) -> dict[str, object]:
    """Renders the report's first frame with the integer renderer, and writes PICTURES as JPEG. Returns the frame's record."""
    asked = resolve(request(scene, size))
    flat = no_foveation(Display(asked.camera.width, asked.camera.height))
    for name, foveation in (("whole", flat), ("measured", asked.foveation)):
        frame = pipeline.render(asked.model, asked.camera, config=PAPER, foveation=foveation, background=asked.background)
        with atomic_output(out / PICTURES[name]) as file:
            Image.fromarray(to_bytes(frame.image)).save(file, format="JPEG", quality=QUALITY)
    trained = load_scene(str(request(scene, size).scene)).model.levels > 1
    return {**asked.record, "scene": Path(str(asked.record["scene"])).stem, "points": len(asked.model), "trained": trained}


def _first(performance: Mapping, machine: str, memory: str = LPDDR3) -> Mapping:
    """The first frame on a machine with a memory."""
    return next(run for run in performance["frames"][0]["runs"] if (run["machine"], run["memory"]) == (machine, memory))


def main_numbers(content: Mapping, performance: Mapping) -> list[tuple[str, str]]:
    """The numbers of the summary with their meaning."""
    ours, other, gpu = (_first(performance, name) for name in (BOTH.name, GSCORE, GPU))
    bound = _first(performance, BOTH.name, IDEAL)
    numbers = [
        (f"{ours['frames_per_s']:,.0f}", f"frames a second at {content['clock_hz'] / 1e9:g} GHz with {ALL_NAMES[LPDDR3]} "
         f"({ours['cycles']:,} cycles of the cycle model; {bound['frames_per_s']:,.0f} with an ideal memory of its bandwidth)"),
        (f"{ours['chip_mj']:.3f} mJ", f"energy of the chip for the frame, and {ours['dram_mj']:.3f} mJ of the memory")]
    if content["area_mm2_16nm"]:
        numbers.append((f"{content['area_mm2_16nm']:.2f} mm²", "area for two eyes, scaled to 16 nm"))
    equal = [row for row in performance["equal_area"]
             if row["frame"] == performance["frames"][0]["name"] and row["memory"] == LPDDR3]
    if equal:
        numbers.append((f"{equal[0]['speedup']:.2f}x", "the speed of a GSCore-like machine of equal area that gets as many "
                        f"bytes a cycle of LPDDR3; {equal[0]['speedup_bound']:.2f}x if it got all that the wires can move"))
    else:
        numbers.append((f"{other['cycles'] / ours['cycles']:.2f}x", "the speed of a GSCore-like machine of the published size"))
    numbers.append((f"{ours['frames_per_s'] / gpu['frames_per_s']:.2f}x", "at least, the speed of a mobile GPU (modelled)"))
    if content["model_error_total"] is not None:
        numbers.append((f"{100 * content['model_error_total']:.2f} %", "the cycle model's worst error against the RTL"))
    return numbers


def goals_sentence(content: Mapping) -> str:
    """How many goals are reached, and which one is missed most."""
    goals = content["goals"]
    missed = [goal for goal in goals if not goal["reached"]]
    text = f"{len(goals) - len(missed)} of the {len(goals)} goals are reached on these frames."
    if missed:
        worst = min(missed, key=lambda goal: (goal["found"] / goal["wanted"]) ** (1 if goal["least"] else -1))
        text += f" Missed most: {worst['goal']} ({worst['found']:.2f}, wanted {worst['wanted']:.2f})."
    return text


def captions(content: Mapping) -> dict[str, str]:
    """What the rendered frames show, by the names in PICTURES."""
    frame = content["frame"]
    levels = "trained with the model" if frame["trained"] else "random subsets of the splats, because the model has none"
    return {
        "whole": f"All {frame['points']:,} splats of {frame['scene']}, {content['size']}, by the integer renderer, whose every "
                 "bit is the hardware's.",
        "measured": f"The frame that is measured: {frame['levels']} levels around a gaze in the centre, {levels}."}


def sources(content: Mapping, performance: Mapping) -> str:
    """Where the numbers come from, and the configuration, as Markdown."""
    lines = [f"Commit {content['commit'][:12] or 'unknown'}{', with changed files' if content['changed'] else ''}. "
             f"The cycles and energies are of the machine `{performance['config']}`; [report.json](report.json) has the "
             "numbers, and [performance.json](performance.json), [area.json](area.json) and [energy.json](energy.json) "
             "those of the chapters."]
    if content["area_mm2_16nm"]:
        lines.append(f"The area is {content['area_mm2_16nm']:.3f} mm² at 16 nm, "
                     f"{content['area_mm2_16nm_without_warp_memories']:.3f} mm² without the warp unit's memories "
                     f"({content['area_source']}).")
    else:
        lines.append("There is no reports/area.json, so the area is not known (`make report-area`).")
    if content["model_error_total"] is not None:
        lines.append(f"The cycle model's worst error of a frame's total is {100 * content['model_error_total']:.2f} % "
                     f"({content['model_error_source']}).")
    return "\n\n".join([*lines, "The configuration:", table(("field", "value"), _flat(content["config"]))])


def _flat(config: Mapping, before: str = "") -> list[tuple[str, str]]:
    """The fields of a configuration with their values; those of a field with parts are named FIELD.PART."""
    out = []
    for name, value in config.items():
        out += _flat(value, f"{before}{name}.") if isinstance(value, Mapping) else [(f"`{before}{name}`", f"{value}")]
    return out


def markdown(content: Mapping, performance: Mapping, chapters: Mapping[str, str]) -> str:
    """The page as Markdown: the summary, where the numbers come from, then the reports."""
    numbers = table(("number", "meaning"), main_numbers(content, performance))
    shown = [part for name, text in captions(content).items() for part in (f"![{text}]({PICTURES[name]})", text)]
    return "\n\n".join(["# Report", *shown, numbers, goals_sentence(content), sources(content, performance),
                        *chapters.values()]) + "\n"


def html(content: Mapping, performance: Mapping, chapters: Mapping[str, str]) -> str:
    """The page as HTML."""
    shown = "".join(picture(PICTURES[name], text) for name, text in captions(content).items())
    goals = goals_sentence(content) + " [All goals](#performance-what-was-to-be-reached)."
    summary = (f'<div class="summary"><div class="figures">{shown}</div><div>{cards(main_numbers(content, performance))}'
               f"<p>{inline(goals)}</p></div></div>")
    parts = [Chapter(name.capitalize(), text) for name, text in chapters.items()]
    return page(f"MSV2 on {content['frame']['scene']}: speed, area and energy", summary,
                [*parts, Chapter("How this was made", sources(content, performance), "Sources and configuration")])
