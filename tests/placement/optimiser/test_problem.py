"""What a placement problem refuses."""

from dataclasses import replace

from refusals import refused_with
from small_tables import avoiding_problem


def test_problem_says_what_is_wrong():
    problem = avoiding_problem(["10", "01"])

    with refused_with("fusion: got 'all'; expected one of any, single"):
        replace(problem, fusion="all")
