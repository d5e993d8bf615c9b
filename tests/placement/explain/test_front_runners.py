"""Which of the front runners the full evaluation takes."""

from types import SimpleNamespace

import numpy as np
import pytest

from placement.explain.alternatives import (
    EQUAL_APR,
    FrontRunner,
    build_front_runner,
    recommend,
)


def runner(apr, left):
    """A front runner of these values."""
    return FrontRunner(layout=None, apr=apr, apr_one_failed=left)


@pytest.mark.parametrize(
    ("values", "wrongly", "expected"),
    [
        ([(0.900, 0.365), (0.902, 0.482)], {}, (1, "apr")),
        ([(0.900, 0.365), (0.900 + 0.9 * EQUAL_APR, 0.3)], {}, (0, "order")),
        ([(0.900, 0.365), (0.9005, 0.482)], {}, (1, "apr_one_failed")),
        (
            [(0.9, 0.4), (0.9, 0.4), (0.9, 0.4)],
            {0: 0.7, 1: 0.88, 2: 0.9},
            (2, "mounting"),
        ),
        ([(0.9, 0.4), (0.9, 0.4)], {0: 0.8, 1: 0.8}, (0, "order")),
        ([(0.8, 0.9), (0.9, 0.3), (0.9, 0.4)], {}, (2, "apr")),
        ([(0.9, 0.4)], {}, (0, "order")),
    ],
)
def test_the_evaluator_decides_by_apr_then_failures_then_errors_of_mounting(
    values, wrongly, expected
):
    """What mounting errors leave is looked at only where it decides."""
    runners = [runner(*pair) for pair in values]

    assert recommend(runners, wrongly.__getitem__) == expected


def test_a_front_runner_has_the_shares_of_its_fusion():
    weight = np.array([0.5, 0.25, 0.25])
    axis = SimpleNamespace(weight=weight)

    def verdict(*avoided):
        is_avoided = np.array(avoided, dtype=bool)
        return SimpleNamespace(is_avoided=is_avoided)

    evaluation = SimpleNamespace(
        axis=axis,
        layout=None,
        units={"a": verdict(1, 0, 0), "b": verdict(1, 1, 0)},
        rsu_all=verdict(1, 1, 1),
        vut=verdict(0, 1, 0),
    )

    for cars, expected in (
        (0.0, (0.75, 0.5)),
        (1.0, (0.75, 0.75)),
        (0.5, (0.75, 0.625)),
    ):
        evaluation.cars = cars
        found = build_front_runner(evaluation, None, fusion="single")
        assert (found.apr, found.apr_one_failed) == expected
