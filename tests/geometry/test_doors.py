"""Files of users are opened and written through a few modules of geometry alone."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
DOORS = {
    "geometry/opening.py",
    "geometry/text_formats.py",
    "geometry/writing.py",
    "geometry/locks.py",
    "geometry/cache_folders.py",
}
# Methods and functions that open, read or write what a path names.
CALLS = {
    *("open", "read_text", "read_bytes", "write_text", "write_bytes"),
    *("rename", "symlink_to", "hardlink_to", "copyfile", "copy2", "copytree"),
    *(
        "ZipFile",
        "ParquetFile",
        "InferenceSession",
        "read_dataframe",
        "write_dataframe",
    ),
    *(
        "list_layers",
        "read_info",
        "read_parquet",
        "read_csv",
        "read_file",
        "genfromtxt",
        "loadtxt",
    ),
    *(
        "memmap",
        "fromfile",
        "savetxt",
        "to_parquet",
        "write_table",
        "FileProcessor",
        "savefig",
        "urlopen",
    ),
}
METHODS = {"read_text", "read_bytes", "rename"}  # as functions they are the doors' own
CALLS_OF = {
    "np": {"load", "save", "savez", "savez_compressed"},
    "os": {"replace", "link"},
}
EXCEPTIONS = {
    # Opened by the door before; what follows is inside the open file.
    "geometry/scene_files.py": {"ZipFile", "open"},
    "geometry/scene_sources.py": {"ZipFile"},
    "geometry/maps/point_clouds.py": {"open"},  # laspy
    "placement/proof_files.py": {"ZipFile", "open"},
    "placement/sampling/moving/sumo.py": {"load"},
    "geometry/archives.py": {"ZipFile", "open"},
    "geometry/parquet_files.py": {"ParquetFile"},
    "experiments/parts/reading.py": {"read_csv"},
    # Libraries that take names only: the door has looked at them before.
    "geometry/maps/relief.py": {"open"},
    "geometry/maps/gis_files.py": {"list_layers", "read_info", "read_dataframe"},
    "geometry/maps/openstreetmap/elements.py": {"FileProcessor"},
    "placement/detectors/network.py": {"InferenceSession"},
    # Into memory, or a folder of this program's own.
    "experiments/export/gpkg.py": {"write_dataframe", "read_bytes"},
    "experiments/jobs/placement.py": {"write_table"},  # into memory
    "experiments/city/answer.py": {"to_parquet"},
    "experiments/figures/film.py": {"savefig"},
    "experiments/parts/sheet.py": {"savefig"},
    "experiments/parts/section.py": {"open"},
    "experiments/planner/tasks.py": {"ZipFile", "read_text"},
    "experiments/planner/aerial_images.py": {"open"},
    "experiments/planner/server.py": {"open", "write_text"},
    "experiments/results/signatures.py": {"read_bytes", "write_text", "write_bytes"},
    "placement/sampling/moving/child.py": {"read_text", "savez"},
    # Folders that are put in place as a whole.
    "experiments/results/folders.py": {"rename"},
    "placement/recordings/files.py": {"rename"},
    # The package's own data, caches, and what the system tells of itself.
    "geometry/actors.py": {"open", "load"},
    "experiments/export/uper.py": {"read_text"},
    "experiments/language.py": {"open"},
    "experiments/city/pages.py": {"read_text"},
    "experiments/results/tables.py": {"read_text"},
    "geometry/body_shapes.py": {"savez_compressed"},
    "placement/detectors/response.py": {"read_text"},
    "geometry/kernels.py": {"read_bytes", "write_bytes"},
    "placement/cache.py": {"load"},
    "placement/fingerprints.py": {"read_bytes"},
    "experiments/engine/processes.py": {"read_text"},
    "placement/memory.py": {"read_text"},
    "experiments/planner/command.py": {"open"},  # the browser
    "experiments/planner/page_files.py": {"read_bytes", "read_text"},
    "experiments/planner/session.py": {"open"},  # a scene, by a worker
}
TOOLS = (
    "experiments/bench/",
    "experiments/perception_lab/training/",
    "experiments/remake.py",
    "screenshots.py",
)  # of this repository


def opened(text):
    """Calls in a source that open, read or write what a path names."""
    found = set()
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.Call):
            continue
        if isinstance(node.func, ast.Name) and node.func.id in CALLS - METHODS:
            found.add(node.func.id)
        elif isinstance(node.func, ast.Attribute):
            name = node.func.attr
            owner = getattr(node.func.value, "id", "")
            is_path_replace = (
                name == "replace" and len(node.args) == 1 and not node.keywords
            )
            if name in CALLS_OF.get(owner, CALLS) or is_path_replace:
                found.add(name)
    return found


SOURCES = sorted(
    path.relative_to(ROOT).as_posix()
    for package in ("geometry", "scenarios", "placement", "experiments")
    for path in (ROOT / package).rglob("*.py")
)


@pytest.mark.long
def test_nothing_else_opens_a_file():
    found = {}
    for name in SOURCES:
        if name in DOORS or name.startswith(TOOLS[:3]) or name.endswith(TOOLS[3]):
            continue
        calls = opened((ROOT / name).read_text())
        if calls:
            found[name] = calls
    assert found == EXCEPTIONS


@pytest.mark.parametrize(
    "line",
    [
        "open(name)",
        "path.read_text()",
        "np.load(path)",
        "a.replace(b)",
        "os.replace(a, b)",
    ],
)
def test_what_is_found(line):
    assert opened(line)


@pytest.mark.parametrize(
    "line", ["text.replace('a', 'b')", "replace(value, a=1)", "table.copy()"]
)
def test_what_is_not_meant(line):
    assert not opened(line)
