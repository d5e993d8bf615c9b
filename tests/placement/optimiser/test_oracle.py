"""Random problems of every kind against the enumeration of ``oracle``, by every
solver.
"""

import os
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pytest
from oracle_checks import EVERY_WAY, check, faults, rates
from problems import random_problem

from placement.verification.instances import load_problem


@pytest.mark.long
def test_every_solver_answers_as_the_enumeration_says():
    for number in range(12):
        problem = random_problem(np.random.default_rng([7, number]))
        for way in EVERY_WAY:
            check(problem, way)


RARE = 0.03
"""At least this share of the problems drawn is of each kind."""
KINDS = {
    "tail",
    "pose adds nothing",
    "tail, pose adds nothing",
    "tail, pose adds nothing to a car that sees",
    "tiny weight",
    "levels",
    "car sees",
    "single",
    "money",
    "forced pose",
    "forced site",
    "rivals",
    "floor",
    "floor of a case",
    "survive",
    "sites fail",
    "fewest",
    "cheapest",
    *(f"by {way}" for way in EVERY_WAY),
}
N_PROBLEMS = int(os.environ.get("ORACLE_PROBLEMS", "20000"))
"""What two cores answer in some eight minutes; 100000 are asked for by the variable."""
BLOCK = 2_000


@pytest.mark.long
@pytest.mark.parametrize("block", range(-(-N_PROBLEMS // BLOCK)))
def test_thousands_of_answers_are_as_the_enumeration_says(block):
    """Alone: ``PYTHONPATH=. python tests/support/oracle_checks.py FIRST END`` also says
    the rates.
    """
    first = BLOCK * block
    parts = [range(begin, begin + 500) for begin in range(first, first + BLOCK, 500)]
    kinds = Counter()
    found = []
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        for of_part, kinds_of_part in pool.map(faults, parts):
            found += of_part
            kinds.update(kinds_of_part)

    print(rates(kinds, BLOCK))  # noqa: T201

    assert found == []
    assert kinds.keys() == KINDS
    assert min(kinds.values()) >= RARE * BLOCK


SHARED = Path(__file__).parents[4] / "shared" / "inputs" / "placement"


@pytest.mark.long
@pytest.mark.parametrize("name", ["false_margin", "false_proof", "tiny_weight"])
@pytest.mark.parametrize("way", EVERY_WAY)
def test_problems_that_were_answered_wrongly_are_answered_right(name, way):
    path = SHARED / f"{name}.npz"
    if not path.exists():
        pytest.skip("the shared material is absent")
    check(load_problem(path), way)
