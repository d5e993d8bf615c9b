"""Labels do not lie on one another, and stay within the frame."""

from itertools import combinations

import numpy as np

from experiments.figures.axes import new_axes, show_square, to_png
from experiments.figures.labels import TextLabel, draw_labels

MIDDLE_M = (0.0, 0.0)


def square_axes(width_in):
    """Axes that show 45 m to each side of the middle."""
    axes = new_axes(width_in, width_in)
    show_square(axes, np.array(MIDDLE_M), 45.0)
    return axes


def texts(axes):
    """Which labels have been drawn."""
    return [text.get_text() for text in axes.texts]


def boxes(axes):
    """Where the texts are once all is laid out, in pixels."""
    to_png(axes)
    return [text.get_window_extent() for text in axes.texts]


def test_labels_of_one_place_are_put_apart_and_inside():
    axes = square_axes(6.8)
    labels = []
    for i in range(12):
        labels.append(TextLabel(text=f"label {i}", point_m=MIDDLE_M))
    labels.append(TextLabel(text="at the edge of it", point_m=(44.5, 44.5)))

    draw_labels(axes, labels)
    found = boxes(axes)

    assert len(found) == 13

    for one, other in combinations(found, 2):
        assert not one.overlaps(other)

    frame = axes.get_window_extent()
    for box in found:
        assert frame.x0 <= box.x0
        assert box.x1 <= frame.x1


def test_what_has_no_room_is_left_out_unless_it_is_kept():
    """And so is what lies beyond the frame."""
    axes = square_axes(2.0)
    optional = TextLabel(text="x" * 12, point_m=MIDDLE_M, is_kept=False)
    kept = TextLabel(text="kept" * 3, point_m=MIDDLE_M)
    draw_labels(axes, [optional] * 60 + [kept])
    shown = texts(axes)

    assert shown[-1] == kept.text
    assert 1 < len(shown) < 40

    beyond = TextLabel(text="beyond", point_m=(99.0, 0.0))
    draw_labels(axes, [beyond])

    assert "beyond" not in texts(axes)
