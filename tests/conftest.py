"""Values that many tests start from."""

import gc
import logging
import os
import sys
from pathlib import Path

# Workers run side by side: a second BLAS thread of each would only spin.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
if (
    sys.dont_write_bytecode
):  # all workers and the commands they begin would compile SciPy anew
    sys.dont_write_bytecode = False
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
    sys.pycache_prefix = str(Path(__file__).parents[1] / ".pytest_cache/bytecode")
    os.environ["PYTHONPYCACHEPREFIX"] = sys.pycache_prefix

import pytest
from _pytest.doctest import DoctestModule
from hypothesis import settings
from tiny_worlds import three_runs

from geometry.actors import load_actors
from geometry.catalogue import load_cameras
from geometry.study_scene import load_study_scene
from scenarios.aeb import load_aeb_rule
from scenarios.cases import pick_cases
from scenarios.published import load_placements
from scenarios.runs import build_runs

# How long an example takes is no test. The same examples are drawn each time, so that a
# change that lands is judged by what it changes; fewer where little hangs on geometry
# and search. Continuous integration draws more: pytest --hypothesis-profile thorough.
# Others are drawn each time by --hypothesis-profile explore: run it after changes to
# geometry, scenarios, or the optimiser.
settings.register_profile(
    "place-rsus", deadline=None, max_examples=12, derandomize=True
)
settings.register_profile(
    "place-rsus-few", deadline=None, max_examples=8, derandomize=True
)
settings.register_profile("thorough", deadline=None, max_examples=30, derandomize=True)
settings.register_profile("explore", deadline=None, max_examples=30)
settings.load_profile("place-rsus")
MANY = ("geometry", "scenarios", "optimiser")
COMPILES = (  # optimiser, evaluator, table: hardly a kernel of one is another's
    "tests/placement/optimiser/test_walk.py",
    "tests/placement/evaluator/test_evaluate.py",
    "tests/placement/visibility/test_build.py",
)
NEEDS_NO_KERNELS = ("tests/scenarios/", "tests/geometry/")
# The first test that compiles is told so, on a new machine: whichever that is, and
# however quiet.
logging.getLogger("geometry.kernels").setLevel(logging.ERROR)


@pytest.hookimpl(wrapper=True)
def pytest_collect_file():
    """Docstrings of tests hold no examples: to look for them takes long."""
    found = yield
    return [
        collector for collector in found if not isinstance(collector, DoctestModule)
    ]


def pytest_collectstart(collector):
    """Tests take the number of their examples from the profile in force when they are
    imported.
    """
    if isinstance(collector, pytest.Module) and settings.get_current_profile_name() in (
        "place-rsus",
        "place-rsus-few",
    ):
        is_many = not set(MANY).isdisjoint(collector.nodeid.split("/"))
        settings.load_profile("place-rsus" if is_many else "place-rsus-few")


def pytest_collection_modifyitems(items):
    """Files that compile most come first, each what no other does, then those that need
    least.

    What one process has compiled, the others find: two that begin alike would do so
    twice.
    """
    items.sort(key=lambda item: _turn(item.nodeid))


def _turn(nodeid):
    """Place of a test in the order of files: the lower, the earlier."""
    for turn, files in enumerate((*COMPILES, NEEDS_NO_KERNELS)):
        if nodeid.startswith(files):
            return turn
    return len(COMPILES) + 1


def pytest_collection_finish():
    """What is loaded by now stays: the garbage collector need not look at it again and
    again.

    It looks seldom at the rest, too, for figures and drawn examples are many small
    objects.
    """
    gc.freeze()
    gc.set_threshold(50_000, 10, 10)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item, nextitem):
    """What the tests of a file have left goes before the next file.

    What then remains stays, too: to look at all of it after each file would take a
    tenth of a run.
    """
    yield
    if nextitem is None or nextitem.path != item.path:
        gc.collect()
        gc.freeze()


def pytest_addoption(parser):
    """Options of tests/faults/test_fuzz.py."""
    group = parser.getgroup("fuzz", "damaged files")
    group.addoption(
        "--fuzz-seconds", default=3.0, type=float, help="for all readers together"
    )
    group.addoption(
        "--fuzz-seed", default=0, type=int, help="another one: other damages"
    )
    group.addoption("--fuzz-keep", default="", help="folder for files that were found")


@pytest.fixture(scope="session")
def actors():
    return load_actors()


@pytest.fixture(scope="session")
def camera():
    return load_cameras()["carla-ncap-rgb"]


@pytest.fixture(scope="session")
def rule():
    return load_aeb_rule()


@pytest.fixture(scope="session")
def placements():
    return load_placements()


@pytest.fixture(scope="session")
def runs(actors, rule):
    """The 104 runs of the study's own cases at its junction."""
    cases = pick_cases("CPNC-50,CBNA,CBLA", "cases")
    runs, _ = build_runs(load_study_scene(), cases, vut=actors["vut"], rule=rule)
    return runs


@pytest.fixture
def frame_axis():
    """Three runs of 3, 5 and 2 frames with weights 1/2, 1/4, 1/4."""
    return three_runs()
