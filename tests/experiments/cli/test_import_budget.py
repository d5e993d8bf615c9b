"""Modules that commands load: for their help, and for the main job's optimiser.

Modules are counted, not seconds, so that the figures are the same on every machine.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from experiments.bench.work import QUESTIONS
from experiments.cli.commands import COMMANDS
from geometry.kernels import compiled_folder

MOST_FOR_HELP = 250
"""Of any command: click and this project's options, and no library that computes."""
MOST_TO_OPTIMISE = 1_420
MOST_ASKED_AGAIN = 700
HEAVY = {
    *("numpy", "scipy", "pandas", "shapely", "matplotlib", "trimesh", "numba"),
    *("jinja2", "pyarrow", "PIL", "pyproj", "starlette"),
}
_COUNT = """
import sys
loaded = {name.partition(".")[0] for name in sys.modules}
print(len(sys.modules), *sorted(loaded), file=sys.stderr)
"""
_HELP = """
from experiments.main import main
try:
    main(ARGUMENTS)
except SystemExit as error:
    assert error.code == 0
"""
_OPTIMISE = """
from placement.pipeline import assemble, place
from placement.question import Question

question = Question(cases="CPNCO-50", approaches="north", speeds="30", budget=1)
place(assemble(question))
"""


def loaded_by(script: str, **variables: str) -> tuple[int, set[str]]:
    """Number of modules that a script loads, and their packages."""
    run = subprocess.run(
        [sys.executable, "-c", script + _COUNT],
        env=os.environ | variables,
        capture_output=True,
        text=True,
        check=True,
    )
    number, *packages = run.stderr.splitlines()[-1].split()
    return int(number), set(packages)


@pytest.mark.long
@pytest.mark.parametrize("words", [[], *([name] for name in COMMANDS)])
def test_help_loads_little(words: list[str]) -> None:
    number, packages = loaded_by(_HELP.replace("ARGUMENTS", repr([*words, "--help"])))
    assert "click" in packages
    assert packages & HEAVY == set()
    assert number <= MOST_FOR_HELP


@pytest.mark.long
def test_the_optimiser_of_the_main_job_loads_no_figures_tables_and_renderers() -> None:
    number, packages = loaded_by(_OPTIMISE)
    assert "numpy" in packages
    assert packages & {"pandas", "matplotlib", "jinja2", "pyarrow", "cvxpy"} == set()
    assert number <= MOST_TO_OPTIMISE


@pytest.mark.long
def test_a_question_asked_again_loads_nothing_that_computes_or_draws(
    tmp_path: Path,
) -> None:
    words = [*QUESTIONS["small"], "--quiet", "--json", "--out", str(tmp_path / "out")]
    script = _HELP.replace("ARGUMENTS", repr(words))
    # Kernels are none of the answer's caches.
    compiled = str(compiled_folder())
    for _ in range(2):
        number, packages = loaded_by(
            script, XDG_CACHE_HOME=str(tmp_path), NUMBA_CACHE_DIR=compiled
        )

    assert packages & HEAVY == {"numpy", "shapely", "jinja2", "pyproj"}
    assert number <= MOST_ASKED_AGAIN
