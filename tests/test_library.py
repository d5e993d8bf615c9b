"""The packages as libraries: each public name is there, and is loaded when it is first
used.
"""

import importlib
import subprocess
import sys

import pytest


@pytest.mark.parametrize("name", ["geometry", "placement", "scenarios"])
def test_every_public_name_is_there_and_nothing_else_is_listed(name):
    package = importlib.import_module(name)
    assert dir(package) == package.__all__ == sorted(package.__all__)
    for one in package.__all__:
        assert getattr(package, one).__name__ == one
    with pytest.raises(AttributeError, match="attribute laod"):
        package.laod  # noqa: B018


@pytest.mark.parametrize("name", ["geometry", "placement", "scenarios"])
def test_nothing_is_loaded_before_it_is_used(name):
    code = f"import sys, {name}; print(*sys.modules)"
    loaded = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split()

    assert name in loaded
    assert not {"numpy", "msgspec", "trimesh", "geometry.errors"} & set(loaded)
