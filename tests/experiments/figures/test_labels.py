"""Labels do not lie on one another, and stay within the frame."""

from itertools import combinations

import numpy as np

from experiments.figures.axes import new_axes, show_square, to_png
from experiments.figures.labels import TextLabel, draw_labels


def boxes(axes):
    """Where the texts are once all is laid out, in pixels."""
    to_png(axes)
    return [text.get_window_extent() for text in axes.texts]


def test_labels_of_one_place_are_put_apart_and_inside():
    axes = new_axes(6.8, 6.8)
    show_square(axes, np.zeros(2), 45.0)
    labels = [TextLabel(text=f"label {i}", point_m=(0.0, 0.0)) for i in range(12)]
    draw_labels(
        axes, [*labels, TextLabel(text="at the edge of it", point_m=(44.5, 44.5))]
    )
    found = boxes(axes)

    assert len(found) == 13
    assert not any(one.overlaps(other) for one, other in combinations(found, 2))

    frame = axes.get_window_extent()
    assert all(frame.x0 <= box.x0 and box.x1 <= frame.x1 for box in found)


def test_what_has_no_room_is_left_out_unless_it_is_kept():
    axes = new_axes(2.0, 2.0)
    show_square(axes, np.zeros(2), 45.0)
    many = [
        TextLabel(text="x" * 12, point_m=(0.0, 0.0), is_kept=False) for _ in range(60)
    ]
    draw_labels(axes, [*many, TextLabel(text="kept" * 3, point_m=(0.0, 0.0))])
    texts = [text.get_text() for text in axes.texts]

    assert texts[-1] == "kept" * 3
    assert 1 < len(texts) < 40

    draw_labels(axes, [TextLabel(text="beyond", point_m=(99.0, 0.0))])
    assert "beyond" not in [text.get_text() for text in axes.texts]
