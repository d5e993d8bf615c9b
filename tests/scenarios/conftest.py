"""What tests of scenarios share: the car, and laying cases."""

from dataclasses import replace

import pytest

from geometry.study_scene import load_study_scene
from scenarios.cases import load_cases, select_cases
from scenarios.runs import build_runs


@pytest.fixture(scope="session")
def vut(actors):
    """The car that drives in every run."""
    return actors["vut"]


@pytest.fixture(scope="session")
def lay(vut, rule):
    """A function that lays cases, or names of some, on a scene.

    It returns runs and what is refused; the cases may have other speeds.
    """

    def build(scene, cases, *, speeds_kmh=(), **options):
        laid = []
        for case in cases:
            if isinstance(case, str):
                case = load_cases()[case]
            if speeds_kmh:
                case = replace(case, vut_speeds_kmh=speeds_kmh)
            laid.append(case)
        return build_runs(scene, laid, vut=vut, rule=rule, **options)

    return build


@pytest.fixture(scope="session")
def crossing_runs(lay):
    """Runs of several speeds with a child, a cyclist across and one ahead."""
    cases = select_cases("CPNCO-50,CBNA,CBLA", speeds="30,40,50,60").cases
    runs, _ = lay(load_study_scene(), cases, approaches=["north"])
    return runs
