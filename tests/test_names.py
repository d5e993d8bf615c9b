"""Each name of a class means one thing: no two modules define the same one."""

import ast
from collections import defaultdict
from pathlib import Path

ROOT = Path(__file__).parents[1]
PACKAGES = ("geometry", "scenarios", "placement", "experiments")


def places_of_classes():
    """Modules in which each class is defined, by its name."""
    places = defaultdict(set)
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
                if isinstance(node, ast.ClassDef):
                    places[node.name].add(str(path.relative_to(ROOT)))
    return places


def test_no_two_modules_define_a_class_of_the_same_name():
    places = places_of_classes()
    assert "Assembly" in places
    assert {name: where for name, where in places.items() if len(where) > 1} == {}
