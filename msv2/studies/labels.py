"""Labels of diagrams: puts them where they cover neither each other nor a point, and finds those that overlap."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations, pairwise
from typing import Any

_STEPS = ((1.4, 0), (1, 1), (1, -1), (-1, 1), (-1, -1), (-1.4, 0), (0, 1.4), (0, -1.4))
_DISTANCES = (6, 12, 20, 30, 42, 56, 72)
"""Distances in points of the screen, in the order in which they are tried."""

_LINE = {"arrowstyle": "-", "color": "0.6", "linewidth": 0.6, "shrinkA": 0, "shrinkB": 3}
_BETWEEN = 4
"""Points of the screen between the places of a line that are kept free."""

MARGIN = 1.0
"""Pixels that stay free around a label."""


def place_labels(
    axis: Any, points: Sequence[tuple[float, float]], texts: Sequence[str], *, size: float = 8, drop: bool = False,
    avoid: Sequence[tuple[float, float]] = (), lines: Sequence[tuple[float, float]] = (), **style: object,
) -> list[Any]:
    """Writes a text beside each point, so that no text leaves the axes or covers another text or a point.

    The limits and the scales of the axis must be set before. Far texts get a thin line to their point.

    Args:
        axis: matplotlib's axes.
        points: the points in data units.
        texts: as many texts; empty ones are left out.
        size: the size of the font.
        drop: leave out a text for which there is no free place, instead of writing it at the first place.
        avoid: further points in data units that no text may cover.
        lines: the corners of a line in data units that no text may cover.
        style: options of matplotlib's `annotate`.

    Returns:
        The texts that were written.
    """
    figure = axis.figure
    figure.canvas.draw()
    renderer, frame = figure.canvas.get_renderer(), axis.get_window_extent()
    pixel = figure.dpi / 72
    marks = [axis.transData.transform(point) for point in (*points, *avoid)]
    corners = [axis.transData.transform(point) for point in lines]
    for (x0, y0), (x1, y1) in pairwise(corners):
        count = 1 + int(max(abs(x1 - x0), abs(y1 - y0)) / (_BETWEEN * pixel))
        marks += [(x0 + (x1 - x0) * i / count, y0 + (y1 - y0) * i / count) for i in range(count + 1)]
    legend = axis.get_legend()
    taken = [] if legend is None else [legend.get_window_extent(renderer)]
    out = []
    for point, text in zip(points, texts, strict=True):
        if not text:
            continue
        label = axis.annotate(text, point, xytext=(0, 0), textcoords="offset points", fontsize=size, arrowprops=_LINE, **style)
        for distance in _DISTANCES:
            found = (_try(label, step, distance, renderer, pixel, frame, taken, marks) for step in _STEPS)
            box = next(filter(None, found), None)
            if box is not None:
                label.arrow_patch.set_visible(distance > _DISTANCES[0])
                break
        else:
            if drop:
                label.remove()
                continue
            box = _moved(label, _STEPS[0], _DISTANCES[0], renderer)
        taken.append(box)
        out.append(label)
    return out


def _moved(label: Any, step: tuple[float, float], distance: float, renderer: Any) -> Any:
    x, y = step
    label.set_position((x * distance, y * distance))
    label.set_horizontalalignment("left" if x > 0 else "right" if x < 0 else "center")
    label.set_verticalalignment("bottom" if y > 0 else "top" if y < 0 else "center")
    label.update_positions(renderer)
    return _text_box(label, renderer)


def _text_box(label: Any, renderer: Any) -> Any:
    """The box of the words alone; an annotation's own box includes its line."""
    from matplotlib.text import Text

    return Text.get_window_extent(label, renderer)


def _try(
    label: Any, step: tuple[float, float], distance: float, renderer: Any, pixel: float, frame: Any, taken: Sequence[Any],
    marks: Sequence[Any],
) -> Any | None:
    """The label's box at this place; None if the place is not free."""
    box = _moved(label, step, distance, renderer)
    if box.x0 < frame.x0 or box.x1 > frame.x1 or box.y0 < frame.y0 or box.y1 > frame.y1:
        return None
    if any(_touch(box, other) for other in taken):
        return None
    near = 2.5 * pixel
    free = not any(box.x0 - near < x < box.x1 + near and box.y0 - near < y < box.y1 + near for x, y in marks)
    return box if free else None


def _touch(a: Any, b: Any, margin: float = MARGIN) -> bool:
    return bool(a.x0 < b.x1 + margin and b.x0 < a.x1 + margin and a.y0 < b.y1 + margin and b.y0 < a.y1 + margin)


def overlapping(figure: Any) -> list[tuple[str, str]]:
    """The pairs of visible texts of a figure whose boxes intersect: titles, labels of axes, ticks and points, legends.

    Boxes of turned texts are those of the turned words' outer rectangle, except that ticks of one axis that are turned alike
    are compared by the distance of their lines.
    """
    from matplotlib.text import Text

    figure.canvas.draw()
    renderer, boxes, hidden = figure.canvas.get_renderer(), [], _not_drawn(figure)
    for text in figure.findobj(Text):
        if not text.get_visible() or not text.get_text().strip() or text in hidden:
            continue
        box = _text_box(text, renderer)
        if box.width > 0 and box.height > 0:
            boxes.append((text, box))
    return [(a.get_text(), b.get_text()) for (a, box), (b, other) in combinations(boxes, 2)
            if _touch(box, other, -0.5) and not _parallel(a, b)]


def _not_drawn(figure: Any) -> set[Any]:
    """The labels of ticks that lie outside of the limits, or of axes that are off: matplotlib keeps them and does not draw
    them."""
    out = set()
    for axis in figure.axes:
        for side in (axis.xaxis, axis.yaxis):
            drawn = side._update_ticks() if axis.axison and axis.get_visible() else []  # what is drawn has no public name
            kept = [tick for tick in (*side.majorTicks, *side.minorTicks) if tick not in drawn]
            out |= {label for tick in kept for label in (tick.label1, tick.label2)}
            if not axis.axison:
                out |= {side.label, side.offsetText}
    return out


def _parallel(a: Any, b: Any) -> bool:
    """Whether two turned texts of one axis lie beside each other, so that their outer rectangles say nothing."""
    turn = a.get_rotation() % 90
    if not turn or turn != b.get_rotation() % 90 or a.axes is not b.axes:
        return False
    (ax, ay), (bx, by) = a.get_window_extent().get_points()[1], b.get_window_extent().get_points()[1]
    angle = math.radians(a.get_rotation())
    apart = abs((bx - ax) * math.sin(angle) - (by - ay) * math.cos(angle))
    return apart >= a.get_fontsize() * a.figure.dpi / 72
