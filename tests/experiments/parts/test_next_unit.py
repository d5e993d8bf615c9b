from experiments.parts.explanation import next_unit_sentence
from placement.explain.contributions import NextUnit


def test_what_the_next_unit_buys_and_how_that_is_known():
    unit = NextUnit(pose="mast-w/7m", apr=0.974, gain=0.064)
    assert (
        next_unit_sentence(unit)
        == "One more unit would add 6.4 points of APR: 97.4 % with mast-w/7m (on the"
        " detection table, by greedy choice)"
    )
    useless = NextUnit(pose="mast-w/7m", apr=0.9, gain=0.0)
    assert (
        next_unit_sentence(useless)
        == "One more unit among the candidates would avoid nothing more (on the"
        " detection table, by greedy choice)"
    )
    assert next_unit_sentence(None) == ""
