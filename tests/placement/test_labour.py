import pytest

from geometry.errors import InputError
from placement.retrofit import Labour, load_labour


def test_a_visit_is_people_on_the_way_and_at_the_pole_and_a_lift() -> None:
    labour = Labour(
        people=2.0,
        wage_eur_per_h=50.0,
        travel_h=1.0,
        lift_eur=100.0,
        re_aim_h=2.0,
        remove_h=0.5,
        source="a test",
    )
    assert labour.re_aim_eur == 2.0 * 50.0 * 3.0 + 100.0
    assert labour.remove_eur == 2.0 * 50.0 * 1.5 + 100.0


def test_prices_of_ours_are_called_an_assumption() -> None:
    assert "assumption" in load_labour().source


def test_an_unknown_name_lists_the_known_ones() -> None:
    with pytest.raises(InputError, match=r"labour\.toml: got 'night'; expected .*default"):
        load_labour("night")


def test_a_price_below_nothing_is_refused() -> None:
    with pytest.raises(InputError, match=r"labour\.lift_eur: got -1\.0; expected at least 0"):
        Labour(
            people=1.0,
            wage_eur_per_h=1.0,
            travel_h=0.0,
            lift_eur=-1.0,
            re_aim_h=0.0,
            remove_h=0.0,
            source="a test",
        )
