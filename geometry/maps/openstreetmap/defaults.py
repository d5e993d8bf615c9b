"""What OpenStreetMap leaves open, from ``data/openstreetmap.toml``."""

from importlib.resources import files
from typing import Any

from ...toml_files import load_toml

DEFAULTS: dict[str, Any] = load_toml(files("geometry.maps") / "data" / "openstreetmap.toml")
"""Sizes where a tag is missing or makes no sense, each with its source in the file."""
