import pytest

from geometry.actors import pick_actor
from geometry.study_scene import load_study_scene
from scenarios.aeb import load_aeb_rule
from scenarios.cases import select_cases
from scenarios.runs import Run, build_runs


@pytest.fixture(scope="session")
def crossing_runs() -> tuple[Run, ...]:
    """Runs of several speeds with a child, a cyclist across and one ahead."""
    runs, _ = build_runs(
        load_study_scene(),
        select_cases("CPNCO-50,CBNA,CBLA", speeds="30,40,50,60").cases,
        vut=pick_actor("vut", "vut"),
        rule=load_aeb_rule(),
        approaches=["north"],
    )
    return runs
