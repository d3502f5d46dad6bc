"""The pages of the gallery: docs/gallery.md, and for other scenes a page of Markdown and one of HTML."""

from __future__ import annotations

import io
from collections.abc import Sequence

from PIL import Image

from golden.scenes.pictures import to_bytes
from msv2.studies.gallery.pictures import Shown
from msv2.studies.web.maker import Chapter, page, picture

QUALITY = 87
"""JPEG quality of the pictures."""

MOST_BYTES = 600 * 1024
"""The largest size of all pictures of docs/gallery.md together."""


def jpeg(shown: Shown) -> bytes:
    """A picture as JPEG."""
    file = io.BytesIO()
    Image.fromarray(to_bytes(shown.image)).save(file, format="JPEG", quality=QUALITY, optimize=True)
    return file.getvalue()


def commands(shown: Sequence[Shown], scene: str) -> str:
    """The commands that draw the pictures one by one, as Markdown."""
    width = max(len(one.name) for one in shown)
    return "\n".join(f"    {one.name:<{width}}  msv2 render {scene} {one.options}" for one in shown)


def as_markdown(shown: Sequence[Shown], places: Sequence[str], title: str, scene: str, intro: str) -> str:
    """The page as Markdown.

    Args:
        shown: the pictures.
        places: their paths, relative to the page.
        title: the heading.
        scene: the scene as commands take it.
        intro: what stands below the heading.
    """
    parts = [f"# {title}", intro]
    for one, place in zip(shown, places, strict=True):
        parts += [f"## {one.title}", one.caption, f"![{one.title}]({place})"]
    parts += ["## One by one", "These commands draw the same frames, one by one:", commands(shown, scene)]
    return "\n\n".join(parts)


def as_html(shown: Sequence[Shown], places: Sequence[str], title: str, scene: str) -> str:
    """The page as HTML: the pictures with their captions on one screen, and the commands as a section that folds."""
    figures = "".join(picture(place, f"**{one.title}.** {one.caption}", one.title)
                      for one, place in zip(shown, places, strict=True))
    return page(title, f'<div class="figures wide">{figures}</div>',
                [Chapter("Draw them yourself", commands(shown, scene), "Commands for each picture")])
