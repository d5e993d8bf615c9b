"""Which large libraries a command loads: each costs a good part of a second at every
call.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

LARGE = {
    *(
        "cvxpy",
        "geopandas",
        "highspy",
        "jinja2",
        "matplotlib",
        "numba",
        "numpy",
        "onnxruntime",
    ),
    *("open3d", "osqp", "pandas", "pyarrow", "pyproj", "rich", "scipy", "shapely"),
    *("trimesh",),
}
CODE = """
import sys
from experiments.main import main
for command in sys.argv[1:]:
    try:
        main(command.split())
    except SystemExit as ended:
        assert not ended.code, ended.code
print(*{name.split(".")[0] for name in sys.modules}, file=sys.stderr)
"""
# A unit must not hang inside a thing.
GEOMETRY = {
    "numpy",
    "scipy",
    "shapely",
    "trimesh",
}


def _loaded_by(code: str, *arguments: str) -> set[str]:
    """Large libraries that a process has loaded when it ends."""
    done = subprocess.run(
        [sys.executable, "-c", code, *arguments],
        env=os.environ | {"PYTHONPATH": str(Path.cwd())},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return LARGE & set(done.stderr.splitlines()[-1].split())


@pytest.mark.parametrize(
    ("commands", "may_load"),
    [
        (
            (
                "--help",
                "--version",
                "pareto --help-all",
                "latency --help",
                "verify --help",
            ),
            set(),
        ),
        (("export --layout carlancap-12 --format carla",), GEOMETRY),
        *(
            pytest.param(commands, GEOMETRY | more, marks=pytest.mark.long)
            for commands, more in (
                (("export --layout carlancap-12 --format csv",), {"pandas", "pyarrow"}),
                (("export --layout carlancap-12 --format geojson",), {"pyproj"}),
                (("scene show --quiet",), {"matplotlib", "pyproj", "rich"}),
            )
        ),
    ],
)
def test_a_command_loads_what_it_needs_and_nothing_else(commands, may_load):
    assert _loaded_by(CODE, *commands) <= may_load


# Quickly, by what a command loads: the test above
@pytest.mark.long
@pytest.mark.parametrize(
    ("modules", "may_load"),
    [
        # A part's file has its table and its figure, too; what compiles is not loaded.
        (
            "experiments.jobs.verify",
            {"numpy", "scipy", "shapely", "matplotlib", "pandas", "pyarrow"},
        ),
        (
            "experiments.scene.run, experiments.parts.sheet",
            {"numpy", "scipy", "shapely", "matplotlib"},
        ),
    ],
)
def test_a_job_is_ready_without_what_it_does_not_use(modules, may_load):
    code = (
        f"import sys, {modules}; print(*{{n.split('.')[0] for n in sys.modules}},"
        " file=sys.stderr)"
    )
    assert _loaded_by(code) <= may_load


def test_the_probe_sees_what_is_loaded():
    code = "import sys, numpy; print(*sys.modules, file=sys.stderr)"
    assert _loaded_by(code) == {"numpy"}
