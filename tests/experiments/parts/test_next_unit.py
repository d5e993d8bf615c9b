"""What one more unit would add, in words."""

from experiments.parts.explanation import next_unit_sentence
from placement.explain.contributions import NextUnit


def test_what_the_next_unit_buys_and_how_that_is_known():
    unit = NextUnit(pose="mast-w/7m", apr=0.974, gain=0.064)
    assert (
        next_unit_sentence(unit)
        == "One more unit adds 6.4 points in the planning model: mast-w/7m"
    )

    useless = NextUnit(pose="mast-w/7m", apr=0.9, gain=0.0)
    assert (
        next_unit_sentence(useless)
        == "One more unit adds nothing in the planning model"
    )
    assert next_unit_sentence(None) == ""
