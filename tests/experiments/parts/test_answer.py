"""Latencies of an answer in words."""

from dataclasses import replace

import pytest

from experiments.parts.assumptions import latency_words
from placement.layout import Layout, load_carlancap_layout

PLAIN = "25 ms for processing and communication"
OWN = f"{PLAIN}; units with a latency of their own: "


def layout(*latencies_s):
    """Units with latencies of their own, where one is given. [s]"""
    units = load_carlancap_layout().units
    return Layout(
        name="any",
        units=tuple(
            replace(unit, latency_s=latency_s)
            for unit, latency_s in zip(units, latencies_s, strict=False)
        ),
    )


@pytest.mark.parametrize(
    ("layouts", "text"),
    [
        ({"mine": layout(None, None)}, f"{PLAIN}."),
        ({"mine": layout(None, 0.025)}, f"{PLAIN}."),
        ({"mine": layout(None, 0.1)}, f"{OWN}RSU1 100 ms."),
        ({"mine": layout(0.0, 0.0)}, f"{OWN}every unit 0 ms."),
        (
            {"mine": layout(0.07, None, 0.0125, 0.07)},
            f"{OWN}RSU2 12.5 ms; RSU0 and RSU3 70 ms.",
        ),
        (
            {
                "mine": layout(0.1, None),
                "old": layout(0.1, 0.1, 0.1),
                "new": layout(None),
            },
            f"{OWN}RSU0 of mine 100 ms; every unit of old 100 ms.",
        ),
    ],
)
def test_latency_names_the_units_that_have_another_of_their_own(
    small_setting, layouts, text
):
    assert latency_words(small_setting.rule, layouts) == text
