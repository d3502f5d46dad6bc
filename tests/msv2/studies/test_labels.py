"""Labels of diagrams: they keep clear of each other, of points and of lines, and overlapping ones are found."""

from __future__ import annotations

import pytest

from msv2.studies import labels

pyplot = pytest.importorskip("matplotlib.pyplot")


@pytest.fixture
def axis():
    figure, axis = pyplot.subplots(figsize=(4, 3))
    axis.set_xlim(0, 1)
    axis.set_ylim(0, 1)
    yield axis
    pyplot.close(figure)


def test_texts_on_each_other_are_found(axis):
    axis.text(0.5, 0.5, "one")
    axis.text(0.52, 0.5, "two")
    axis.text(0.1, 0.9, "three")
    assert labels.overlapping(axis.figure) == [("one", "two")]


def test_what_is_not_drawn_does_not_overlap(axis):
    axis.set_xticks([0, 0.5, 1, 1.0001, 7], ["a", "b", "c", "beyond the limit", "far"])
    axis.set_xlim(0, 1)  # setting ticks widens the limits
    assert labels.overlapping(axis.figure) == []
    axis.set_xlim(0, 2)
    assert ("c", "beyond the limit") in labels.overlapping(axis.figure)


def test_labels_of_a_crowd_do_not_overlap_and_cover_no_point_and_no_line(axis):
    points = [(0.5 + 0.02 * i, 0.5 + 0.01 * i) for i in range(6)]
    line = [(0.1, 0.1), (0.9, 0.9)]
    made = labels.place_labels(axis, points, [f"setting {i}" for i in range(6)], lines=line)
    assert len(made) == 6 and labels.overlapping(axis.figure) == []
    renderer = axis.figure.canvas.get_renderer()
    for label in made:
        box = labels._text_box(label, renderer)
        marks = [axis.transData.transform(point) for point in points]
        marks += [axis.transData.transform((0.1 + 0.008 * i, 0.1 + 0.008 * i)) for i in range(100)]
        assert not any(box.x0 < x < box.x1 and box.y0 < y < box.y1 for x, y in marks), label.get_text()


def test_a_label_without_a_place_is_left_out_on_request(axis):
    points = [(0.5, 0.5)] * 80
    made = labels.place_labels(axis, points, ["a long label"] * 80, drop=True)
    assert 3 < len(made) < 80 and labels.overlapping(axis.figure) == []
