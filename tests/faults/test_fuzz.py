"""Damaged files of every kind: each is read, or refused in one line, in little time and
memory.

In the whole suite for a few seconds, the same files every time. For as long as you
like::

    pytest -n 0 tests/faults/test_fuzz.py --fuzz-seconds 600 --fuzz-seed 7
"""

import ast
import hashlib
import random
import sys
import time
from functools import cache
from pathlib import Path

import pytest
from damage import damaged, wounded
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from limited_reading import Process, put
from readers import READERS

ROOT = Path(__file__).parents[2]
PACKAGES = ("geometry", "scenarios", "placement", "experiments")
pytestmark = pytest.mark.skipif(
    sys.platform != "linux", reason="limits of memory are Linux's"
)


@pytest.fixture(scope="module")
def process():
    one = Process()
    yield one
    one.end()


def complaint(answer):
    """What is wrong with an answer; empty: it is as it should be."""
    if answer["outcome"] == "failed":
        return answer["text"]
    if answer["outcome"] == "refused" and (
        "\n" in answer["text"] or len(answer["text"]) > 3000
    ):
        return f"no line for people: {answer['text'][:3000]}"
    return ""


@pytest.fixture(scope="module")
def seconds(request):
    """How long a reader with a single share of the time is tried."""
    shares = sum(reader.share for reader in READERS.values())
    return float(request.config.getoption("--fuzz-seconds")) / shares


@pytest.mark.long
@pytest.mark.parametrize("name", READERS)
def test_damaged_files_are_read_or_refused(name, process, seconds, request, tmp_path):
    seeds = READERS[name].seeds()
    for kind, (entry, files) in seeds.items():
        answer = process.ask(name, put(tmp_path / "sound", files, entry), is_sound=True)
        assert answer["outcome"] == "read", (kind, answer["text"])
    seed = request.config.getoption("--fuzz-seed")
    rng = random.Random(f"{seed} {name}")
    kept = Path(request.config.getoption("--fuzz-keep") or tmp_path / "kept")
    found = {}
    n_tried = 0
    end_s = time.monotonic() + seconds * READERS[name].share

    while time.monotonic() < end_s or n_tried < len(seeds):
        kind = list(seeds)[n_tried % len(seeds)]
        n_tried += 1
        entry, files = seeds[kind]
        changed = rng.choice(list(files))
        spoilt = dict(files) | {changed: wounded(rng, files[changed], changed)}
        if not process.running:  # what is loaded and compiled first takes its time
            process.ask(name, put(tmp_path / "sound", files, entry), is_sound=True)
        words = complaint(process.ask(name, put(tmp_path / "input", spoilt, entry)))
        if words:
            last = words.strip().splitlines()[-1][:300]
            found[last] = f"{kind}: {changed}\n{words}"
            digest = hashlib.sha256(spoilt[changed]).hexdigest()[:12]
            put(kept / name.replace(" ", "-") / digest, spoilt, entry)

    assert not found, f"{n_tried} files tried, kept in {kept}:\n\n" + "\n\n".join(
        found.values()
    )


TEXTS = (
    "sensors",
    "question",
    "latency budget",
    "uncertainty",
    "detector",
    "layout",
    "weights",
    "own cases",
    "layout lists",
)


@pytest.mark.parametrize("name", [*TEXTS, "sites", "certificates"])
def test_hypothesis_finds_no_text_that_is_neither_read_nor_refused(
    name, process, tmp_path
):
    """Small files whose faults hypothesis makes as small as they can be."""
    seeds = READERS[name].seeds()

    @given(data=st.data())
    @settings(
        max_examples=15,
        database=None,
        suppress_health_check=list(HealthCheck),
        derandomize=True,
    )
    def read(data):
        entry, files = seeds[data.draw(st.sampled_from(sorted(seeds)))]
        spoilt = {entry: data.draw(damaged(files[entry]))}
        answer = process.ask(name, put(tmp_path / "input", dict(files) | spoilt, entry))

        assert complaint(answer) == ""

    entry, files = next(iter(seeds.values()))
    process.ask(name, put(tmp_path / "sound", files, entry), is_sound=True)
    read()


# ---------- the next reader

NO_USERS_FILES = {
    "experiments.city.answer.load_summary": "written by this program, within read_city",
    "geometry.opening.open_file": "the door itself: tests/faults/test_hostile_paths.py",
    "geometry.writing.open_new": "writes",
    "geometry.opening.read_bytes": "the door itself",
    "geometry.cache_folders.open_own": "caches: tests/geometry/test_private_folders.py",
    "geometry.parquet_files.open_parquet": "within readers of results",
    "experiments.city.inputs.load_city": "maps, by read_map",
    "experiments.city.inputs.load_existing": "layouts, by load_layout",
    "experiments.perception_lab.training.crops.load_crops": (
        "written by the training itself"
    ),
    "geometry.actors.read_actors": "facts of the package",
    "geometry.scene_files.pack_scene": "writes",
    "placement.detectors.network.load_onnx_model": (
        "a network is a program: SECURITY.md"
    ),
    "placement.detectors.network.load_network_file": (
        "a network is a program: SECURITY.md"
    ),
    "geometry.study_scene.read_study_scene": "facts of the package",
    "geometry.archives.unpacked": "tests/geometry/test_archives.py",
    "geometry.gltf.check_gltf": "within read_mesh and load_scene",
    "geometry.pbf.check_pbf": "within read_elements",
}
_VERBS = ("load_", "read_", "open_", "parse_", "import_", "weight_from_", "unpacked")


def _takes_a_path(function):
    """True if a function takes a path first."""
    arguments = [*function.args.args, *function.args.kwonlyargs][:1]
    return any(
        "Path" in ast.unparse(one.annotation) for one in arguments if one.annotation
    )


def test_every_reader_is_registered():
    covered = {name for reader in READERS.values() for name in reader.covers}
    found = set()
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
            module = module.removesuffix(".__init__")
            text = path.read_text()
            if not any(f"\ndef {verb}" in text for verb in _VERBS):
                continue

            for node in ast.parse(text).body:
                if (
                    isinstance(node, ast.FunctionDef)
                    and node.name.startswith(_VERBS)
                    and _takes_a_path(node)
                ):
                    found.add(f"{module}.{node.name}")

    assert found - covered - set(NO_USERS_FILES) == set()


@cache
def _text_of(path):
    return path.read_text()


def test_every_registered_reader_exists():
    """To import all of them takes long: their files are looked into."""
    for reader in READERS.values():
        for name in reader.covers:
            module, _, function = name.rpartition(".")
            path = ROOT / module.replace(".", "/")
            if path.is_dir():
                path = path / "__init__.py"
            else:
                path = path.with_suffix(".py")

            assert f"\ndef {function}(" in _text_of(path), name
