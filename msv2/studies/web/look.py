"""Looks at a page in headless Chromium: screenshots at two widths, and what a reader would stumble over."""

from __future__ import annotations

from pathlib import Path

from golden.scenes.files import atomic_output
from msv2.studies.web.browser import HINT, browser, find_chromium

WIDTHS = (1280, 400)
"""Widths in pixels of the windows in which a page is looked at: that of a small laptop, and that of a telephone."""

HEIGHT = 800
TALLEST = 12000
"""Height in pixels below which a picture of an unfolded page is cut."""

_MEASURE = """(() => {
  const root = document.documentElement, summary = document.getElementById('summary');
  const wide = [...document.querySelectorAll('body *')].filter(e => !e.closest('.table, .plot, pre') && e.checkVisibility()
    && e.getBoundingClientRect().right > innerWidth + 1).map(e => e.tagName + ': ' + e.textContent.slice(0, 40));
  const broken = [...document.images].filter(i => i.checkVisibility() && i.complete && !i.naturalWidth).map(i => i.alt);
  return {width: root.scrollWidth, height: root.scrollHeight, wide, broken,
          summary: summary ? Math.ceil(summary.getBoundingClientRect().bottom) : 0};
})()"""


def look(page: Path, folder: Path) -> tuple[list[Path], list[str]]:
    """Writes screenshots NAME_WIDTH.png of a page as it opens, and NAME_WIDTH_unfolded.png with all sections unfolded.

    Args:
        page: the HTML file.
        folder: an existing folder.

    Returns:
        The screenshots, and what a reader would stumble over, in words: a page that is wider than its window, a summary that is
        longer than one screen at the larger width, pictures that do not load, and messages on the console.

    Raises:
        InputError: Chromium is not installed, or it fails.
    """
    made, found = [], []
    with browser() as window:
        for width in WIDTHS:
            window.open(page.resolve().as_uri(), width, HEIGHT)
            for state in ("", "_unfolded"):
                if state:
                    window.run("document.querySelectorAll('details').forEach(e => { e.open = true; })")
                path = folder / f"{page.stem}_{width}{state}.png"
                size = window.run(_MEASURE)
                with atomic_output(path) as file:
                    file.write(window.whole_screenshot(width, min(size["height"], TALLEST)))
                size = window.run(_MEASURE)
                made.append(path)
                where = f"{page.name} at {width} pixels{' unfolded' if state else ''}: "
                if size["width"] > width:
                    found.append(f"{where}{size['width']} pixels wide: {'; '.join(size['wide'][:3])}")
                found += [f"{where}the picture {alt!r} does not load" for alt in size["broken"]]
                if not state and width == max(WIDTHS) and size["summary"] > HEIGHT:
                    found.append(f"{where}the summary is {size['summary']} pixels high, more than {HEIGHT}")
            found += [f"{page.name} at {width} pixels: console: {text}" for text in window.complaints()]
    return made, found


def take_screenshots(page: Path, folder: Path) -> bool:
    """Looks at a page for a command line: prints the screenshots and the findings, or how to install Chromium where it is
    absent. Returns whether nothing was found."""
    if find_chromium() is None:
        print(f"no screenshots: Chromium is not installed ({HINT})")
        return True
    made, found = look(page, folder)
    print("\n".join([*(f"screenshot: {path}" for path in made), *(f"LOOK: {line}" for line in found)]))
    return not found
