"""The study's pages: they open with three small frontiers, a sentence for each, and crops; everything else folds."""

from __future__ import annotations

import html
from collections.abc import Mapping, Sequence

from msv2.studies.page import table
from msv2.studies.tradeoff.choose import ASSUMED_PSNR_DB
from msv2.studies.tradeoff.crops import COLUMNS, SIZE, Crop
from msv2.studies.tradeoff.frontiers import Frontier
from msv2.studies.tradeoff.knobs import BASE, CONSTANTS, base_of
from msv2.studies.tradeoff.tables import (
    Content,
    broken_lines,
    machine_lines,
    presets,
    recommendation,
    ring_lines,
    simulation_lines,
    training_lines,
)
from msv2.studies.web.maker import Chapter, data_uri, page, picture
from msv2.studies.web.markdown import inline

TITLE = "What accuracy costs in time"
CROPPED = f"The crops are parts of a frame of {SIZE} pixels, where the settings differ most."


def judged(content: Content) -> str:
    """What losses are measured against."""
    if content["photographs"]:
        return "the photographs"
    return (f"assumed photographs from which the float64 renderer is {ASSUMED_PSNR_DB:g} dB away (there are none here; errors "
            "of arithmetic are taken as uncorrelated with the model's)")


def _measured(content: Content) -> str:
    views = f"{content['views']} view{'s' if content['views'] != 1 else ''}"
    return f"{content['scene']}, {content['size']}, {views}, {content['points']:,} splats"


def sections(content: Content, pictures: Mapping[str, str]) -> list[tuple[str, str]]:
    """What folds: titles and Markdown."""
    rows = content["machine"]

    def shown(name: str) -> str:
        return f"![{name}: all measured points]({pictures[name]})\n\n" if name in pictures else ""

    named = ", ".join(f"`{preset}` for {budget}" for preset, budget in content["presets"].items())
    return [
        ("Recommended settings", recommendation(content) + "\n\n"
         "The fastest setting of one eye within a loss that breaks no hard case and that the RTL has. Settings within 0.2 % of "
         "each other's cycles count as equally fast. Of these the one with fewer bits is taken, and of settings with as many "
         "bits the one with fewer harmonics. The energy follows from the work and the cycles and does not depend on word "
         "lengths. The area is that of the build that is the same machine, if there is one."),
        ("Presets", presets(content) + "\n\n"
         f"Measured on `{base_of(content).name}` with the formats and harmonics of the machines `spec.config.PRESETS`, which "
         f"have them on `{BASE.name}`. They are the recommendations on the embedded scene ({named}). The machine of a preset "
         "has no more harmonics than the recommendation."),
        ("All settings of the machine", shown("settings")
         + "Bold: on the frontier of cycles and loss. Frames of two eyes are judged by the second eye, and their loss is "
         "relative to both eyes rendered. A setting **breaks** a hard case if the case's expectation or bound, which the "
         "default meets, is missed. Not swept, because they are constants of the semantics and no machine's parameters: "
         f"{', '.join(CONSTANTS)}.\n\n" + machine_lines(rows)),
        ("Quality by eccentricity", ring_lines(rows)),
        ("Hard cases that settings break", "At most three of a setting.\n\n" + ("\n".join(broken_lines(rows)) or "None.")),
        ("The simulator", f"A frame of {content['simulation']['size']} on the machine `{content['simulation']['config']}`.\n\n"
         + simulation_lines(content)),
        ("The training", shown("runs") + training_lines(content))]


def how(content: Content, document: str) -> str:
    """How the page is made, as Markdown; `document` is the path of docs/tradeoff.md."""
    made = content.get("provenance") or {}
    command = made.get("command") or "msv2 study run tradeoff"
    return (f"Measured by `{command}` on {_measured(content)}, levels {content['levels']}. Losses are relative to "
            f"{judged(content)}. [docs/tradeoff.md]({document}) explains the columns.")


def answer(found: Sequence[Frontier], pictures: Mapping[str, str]) -> str:
    """The frontiers beside each other, each with its sentences below it, as Markdown.

    Args:
        found: the frontiers.
        pictures: the paths of their pictures, by name; frontiers without a picture have their sentences alone.
    """
    shown = [f"![{one.title}: {one.accuracy} over {one.time}]({pictures[one.name]})" if one.name in pictures else ""
             for one in found]
    said = [f"**{one.cost}** {one.more}".strip() for one in found]
    return table([one.title for one in found], [shown, said] if any(shown) else [said])


def crops_markdown(crops: Sequence[Crop], path: str) -> str:
    """The sheet of crops with what is on it, row by row."""
    rows = [crops[i : i + COLUMNS] for i in range(0, len(crops), COLUMNS)]
    said = "; ".join(f"row {i + 1}: {', '.join(crop.caption for crop in row)}" for i, row in enumerate(rows))
    words = said.replace("; row", ". Row").replace("row 1", "Row 1")
    return f"![crops of the pictures that one pays for]({path})\n\nFrom the left: {words}. {CROPPED}"


def as_markdown(
    content: Content, found: Sequence[Frontier], pictures: Mapping[str, str], crops: Sequence[Crop], document: str,
) -> str:
    """The page as Markdown; sections fold where HTML is shown."""
    cropped = crops_markdown(crops, pictures["crops"]) if "crops" in pictures else ""
    parts = [f"# {TITLE}", how(content, document), answer(found, pictures), *filter(None, [cropped])]
    parts += [f"<details><summary>{html.escape(title)}</summary>\n\n{text}\n\n</details>"
              for title, text in sections(content, pictures)]
    return "\n\n".join(parts) + "\n"


def as_html(
    content: Content, found: Sequence[Frontier], pictures: Mapping[str, str], crops: Sequence[Crop], document: str,
) -> str:
    """The page as HTML, with the crops in it."""
    figures = []
    for frontier in found:
        alt = f"{frontier.accuracy} over {frontier.time}"
        shown = f'<img src="{pictures[frontier.name]}" alt="{html.escape(alt)}">' if frontier.name in pictures else ""
        figures.append(f"<figure><h3>{html.escape(frontier.title)}</h3>{shown}<figcaption><b>{inline(frontier.cost)}</b> "
                       f"{inline(frontier.more)}</figcaption></figure>")
    cropped = "".join(picture(data_uri(crop.jpeg(), ".jpg"), crop.caption) for crop in crops)
    summary = (f'<div class="figures">{"".join(figures)}</div>'
               + (f'<h3>What one pays for</h3><div class="crops">{cropped}</div>' if crops else ""))
    about = " ".join([how(content, document), *([CROPPED] if crops else [])])
    text = "\n\n".join(f"## {name}\n\n{text}" for name, text in sections(content, pictures))
    return page(f"{TITLE}: {content['scene']}", summary, [Chapter("All numbers", f"{about}\n\n{text}")])
