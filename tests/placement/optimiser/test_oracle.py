"""Random problems of every kind against the enumeration of ``oracle``, by every solver."""

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np
import pytest
from oracle_checks import EVERY_WAY, check, faults
from problems import random_problem


def test_every_solver_answers_as_the_enumeration_says() -> None:
    for number in range(12):
        problem = random_problem(np.random.default_rng([7, number]))
        for way in EVERY_WAY:
            check(problem, way)


@pytest.mark.long
@pytest.mark.parametrize("block", range(8))
def test_thousands_of_answers_are_as_the_enumeration_says(block: int) -> None:
    """For more of them: ``PYTHONPATH=. python tests/oracle_checks.py FIRST END``."""
    parts = [range(first, first + 500) for first in range(2_000 * block, 2_000 * (block + 1), 500)]
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        assert [fault for found in pool.map(faults, parts) for fault in found] == []
