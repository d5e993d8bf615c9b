"""Sketches of cases: the car drives upwards and hits in the middle, whatever arm it
comes from.
"""

import re

import numpy as np
import pytest

from experiments.parts.accidents import SKETCHED_M, sketch_case


def points(data):
    """Corners of a path, (n, 2)."""
    return np.array(
        [[float(x), float(y)] for x, y in re.findall(r"(-?\d+) (-?\d+)", data)]
    )


def test_the_car_drives_upwards_and_hits_in_the_middle(small_setting):
    for run in small_setting.runs:
        sketch = sketch_case(run)
        paths = dict(sketch.paths)
        assert set(paths) >= {"way", "car", "user-way", "user"}

        way = points(paths["way"])
        assert way[-1] == pytest.approx([0.0, 0.0])

        first_turn = way[1] - way[0]
        assert first_turn[1] < 0.0  # upwards: rows of a drawing go down
        assert abs(first_turn[0]) <= 0.1 * abs(first_turn[1]) + 1.0
        assert abs(way).max() <= 10.0 * SKETCHED_M + 1.0

        # Distances are those of the run: one in the drawing is 0.1 m.
        user = points(paths["user-way"])[-1]
        apart_m = np.hypot(*(run.vru_position_m[-1] - run.vut_position_m[-1]))
        assert np.hypot(*user) == pytest.approx(10.0 * apart_m, abs=1.0)


def test_what_hides_somebody_is_drawn_as_wide_as_it_is(small_setting):
    run = next(run for run in small_setting.runs if run.obstruction)
    bodies = [points(data) for style, data in sketch_case(run).paths if style == "body"]
    assert bodies

    actor = run.obstruction[0].actor
    sides = np.sort(np.hypot(*np.diff(bodies[0][[0, 1, 2]], axis=0).T))
    assert sides == pytest.approx(
        np.sort([10.0 * actor.length_m, 10.0 * actor.width_m]), abs=1.5
    )
