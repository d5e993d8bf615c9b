"""What is driven of what is possible, in sentences."""

from types import SimpleNamespace

import pytest

from experiments.results.drives import describe_driven
from scenarios.runs import Refusal

KINDS = {
    "CPNA": "pedestrian",
    "CPLA": "pedestrian",
    "CBNA": "cyclist",
    "CBLA": "cyclist",
}

OBSTACLE = "The main reason why others are not: too short."


def case(name):
    """A case of a name."""
    return SimpleNamespace(name=name, vru=SimpleNamespace(class_name=KINDS[name]))


def setting(driven, refusals, *, weathers=("day",)):
    """Runs by case and approach, and what was refused."""
    runs = [SimpleNamespace(case=case(name), approach=arm) for name, arm in driven]
    axis = SimpleNamespace(
        n_runs=len(runs) * len(weathers), weathers=weathers * len(runs)
    )
    return SimpleNamespace(runs=runs, axis=axis, refusals=tuple(refusals))


def refused(name, arm, reason="too short", *, n=9, is_possible=True, limit_kmh=None):
    """A case that an approach does not carry."""
    return Refusal(
        case=case(name),
        approach=arm,
        speeds_kmh=tuple(range(n)),
        reason=reason,
        is_possible=is_possible and limit_kmh is None,
        limit_kmh=limit_kmh,
    )


def test_nothing_is_said_where_all_that_was_asked_for_is_driven():
    assert describe_driven(setting([("CPNA", "north")], [])) == []


@pytest.mark.parametrize(
    ("driven", "refusals", "lines"),
    [
        (
            [
                ("CPNA", "north"),
                ("CBNA", "north"),
            ],
            [refused("CPNA", "south"), refused("CBNA", "south")],
            [
                f"2 of 20 possible runs are simulated. {OBSTACLE}"
                " Not simulated: any case from the south.",
                "18 runs: too short (CPNA and CBNA from the south).",
            ],
        ),
        (
            [
                ("CPNA", "north"),
                ("CPNA", "south"),
                ("CBNA", "north"),
                ("CBLA", "north"),
            ],
            [refused("CBNA", "south"), refused("CBLA", "south", "a house.", n=2)],
            [
                (
                    "4 of 15 possible runs are simulated. The main reason why others"
                    " are not: too short. Not simulated: cyclist cases from the south."
                ),
                "9 runs: too short (CBNA from the south).",
                "2 runs: a house (CBLA from the south).",
            ],
        ),
        (
            [
                ("CPNA", "north"),
                ("CPNA", "south"),
                ("CPLA", "north"),
            ],
            [
                refused("CPLA", "south"),
                refused("CBLA", "north"),
                refused("CBLA", "south"),
            ],
            [
                (
                    "3 of 30 possible runs are simulated. The main reason why others"
                    " are not: too short. Not simulated: CBLA anywhere; CPLA from the"
                    " south."
                ),
                (
                    "27 runs: too short (CPLA from the south; CBLA from the north and"
                    " south)."
                ),
            ],
        ),
        (
            [
                ("CPNA", "north"),
                ("CPNA", "south"),
                ("CPLA", "north"),
            ],
            [refused("CPLA", "south", "no lane", is_possible=False)],
            [
                "All 3 runs that this junction allows are simulated.",
                "Not possible, 9 runs: no lane (CPLA from the south).",
            ],
        ),
        (
            [
                ("CPNA", "north"),
                ("CPNA", "east"),
            ],
            [
                refused("CPNA", "north", n=3, limit_kmh=50.0),
                refused("CPNA", "east", n=4, limit_kmh=50.0),
                refused("CBNA", "south", n=5, limit_kmh=32.2),
            ],
            [
                (
                    "Left out: 12 runs of the protocol above the map's speed"
                    " limits, 50 km/h from the north and east and 32.2 km/h from"
                    " the south (--speeds all includes them)."
                )
            ],
        ),
        (
            [("CPNA", "north")],
            [
                refused("CPNA", "north", n=2),
                refused("CPNA", "north", n=1, limit_kmh=30.0),
            ],
            [
                f"1 of 3 possible runs are simulated. {OBSTACLE}",
                "2 runs: too short (CPNA from the north).",
                (
                    "Left out: 1 run of the protocol above the map's speed limits,"
                    " 30 km/h from the north (--speeds all includes it)."
                ),
            ],
        ),
        (
            [("CPNA", "north")],
            [refused("CPNA", "north", n=2)],
            [
                f"1 of 3 possible runs are simulated. {OBSTACLE}",
                "2 runs: too short (CPNA from the north).",
            ],
        ),
    ],
)
def test_the_widest_gaps_come_first_and_each_reason_has_a_line(driven, refusals, lines):
    assert describe_driven(setting(driven, refusals)) == lines


def test_every_weather_counts():
    told = describe_driven(
        setting(
            [("CPNA", "north")],
            [refused("CPNA", "south", n=1)],
            weathers=("day", "fog"),
        )
    )
    assert told == [
        f"2 of 4 possible runs are simulated. {OBSTACLE} Not simulated: any case from"
        " the south.",
        "2 runs: too short (CPNA from the south).",
    ]
