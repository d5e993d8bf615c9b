"""The facts in ``geometry/maps/data/opendrive.toml``."""

from functools import cache
from importlib.resources import files
from typing import Any

from ...toml_files import load_toml


@cache
def load_facts() -> dict[str, Any]:
    """Lane kinds, words, types and assumed numbers."""
    return load_toml(files("geometry.maps") / "data" / "opendrive.toml")


@cache
def lane_kinds() -> dict[str, str]:
    """Kind of lane by the standard's type, written small."""
    kinds: dict[str, list[str]] = load_facts()["lane_kinds"]
    return {name.lower(): kind for kind, names in kinds.items() for name in names}


def assumed(key: str) -> float:
    """A number of the section of assumptions."""
    return float(load_facts()["assumed"][key])
