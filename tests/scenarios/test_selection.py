"""Cases and speeds chosen by their names."""

import pytest

from geometry.errors import InputError
from scenarios.cases import select_cases


def speeds(selection):
    """Speeds that are driven, by the names of cases."""
    return {case.name: case.vut_speeds_kmh for case in selection.cases}


def test_a_range_keeps_the_cases_own_speeds_in_it():
    assert speeds(select_cases("CPNA-25", speeds="18-31")) == {
        "CPNA-25": (20.0, 25.0, 30.0)
    }


def test_single_speeds_and_ranges_add_up_each_once():
    assert speeds(select_cases("CPNA-25", speeds="33,20-30,25")) == {
        "CPNA-25": (20.0, 25.0, 30.0, 33.0)
    }


def test_a_case_without_the_speed_is_left_out_and_told():
    selection = select_cases("CPTAns-50,CPNA-25", speeds="40")
    assert speeds(selection) == {"CPNA-25": (40.0,)}
    assert [case.name for case in selection.left_out] == ["CPTAns-50"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "70",
            (
                "speeds: got 70; expected 10 to 60 km/h as the protocol drives "
                "these cases"
            ),
        ),
        ("20,nan", "speeds: got 'nan'; expected km/h with commas between"),
        ("inf", "speeds: got 'inf'; expected km/h"),
        ("-5", "speeds: got '-5'; expected km/h"),
        ("0", "speeds: got '0'; expected km/h"),
        ("1e9", "speeds: got '1e9'; expected km/h"),
        ("20,,30", "speeds: got ''; expected km/h"),
        ("40-20", "speeds: got '40-20'; expected the lower speed first"),
        ("61-62", "speeds: got '61-62'; expected 10 to 60 km/h"),
    ],
)
def test_speeds_that_cannot_be_driven_are_told(text, message):
    with pytest.raises(InputError) as caught:
        select_cases("CPNA-25", speeds=text)
    assert str(caught.value).startswith(message)
