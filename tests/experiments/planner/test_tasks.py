"""How sure an answer of the optimiser is, in words."""

import pytest

from experiments.planner.tasks import _proof
from placement.layout import Certificate, Stage
from placement.optimiser import PlacementValue
from placement.retrofit import Advice

VALUE = PlacementValue(*[0.8] * len(PlacementValue._fields))


def advice(*stages, n_compared=0):
    made = [
        Stage(name=name, objective=1.0, bound=bound, gap=gap, seconds=0.0)
        for name, bound, gap in stages
    ]
    certificate = Certificate(stages=tuple(made), solver="") if made else None
    return Advice(
        units=(), before=None, after=VALUE, certificate=certificate, n_compared=n_compared
    )


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (advice(n_compared=7), "the best of 7 tried, all that there are"),
        (advice(("apr", 0.9, 0.0)), "proven: nothing of its kind is better"),
        (
            advice(("apr", 0.9, 0.0), ("mean_margin_s", 2.0, 0.5)),
            "proven: no APR is higher; of those with the same APR not all were compared in time",
        ),
        (
            advice(("cost_eur", 4040.0, 0.0), ("apr", 0.9, 0.5)),
            "proven: none costs less; of those with the same price not all were compared in time",
        ),
        (
            advice(("apr", 0.837, 0.1)),
            "not proven in the time given: no APR above 83.7 % is possible there",
        ),
        (
            advice(("cost_eur", 4040.0, 0.1)),
            "not proven in the time given: nothing for less than 4,040 EUR is possible there",
        ),
    ],
)
def test_the_words_say_what_is_proven(given, said):
    assert _proof(given) == said
