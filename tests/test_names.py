"""Each name of a class means one thing: no two classes of modules have the same one."""

import ast
from collections import defaultdict
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("geometry", "scenarios", "placement", "experiments")


def places_of_classes():
    """Modules in which each class is defined, by its name."""
    places = defaultdict(list)
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.parse(path.read_text()).body:
                if isinstance(node, ast.ClassDef):
                    places[node.name].append(str(path.relative_to(ROOT)))
    return places


@pytest.mark.long
def test_no_two_classes_have_the_same_name():
    places = places_of_classes()
    assert "Assembly" in places
    assert {name: where for name, where in places.items() if len(where) > 1} == {}
