"""JSON as tests write it, read it, and compare results with it."""

import json

from experiments.export.json import to_json_text

UNIT = {
    "id": "A",
    "site": "",
    "x_m": -115.0,
    "y_m": 8.6,
    "z_m": 8.0,
    "yaw_deg": -135.0,
    "pitch_deg": -25.0,
    "camera": "carla-ncap-rgb",
}
"""A unit at the study's junction, as layout files have it."""


def read_json(path):
    """What a file of JSON says."""
    return json.loads(path.read_text())


def write_json(path, value):
    """Write a value as JSON; lone surrogates and the like are escaped."""
    path.write_text(json.dumps(value))


def change_json(path, change):
    """Let a function change what a file of JSON says."""
    value = read_json(path)
    change(value)
    write_json(path, value)


def as_json(result):
    """A result as its JSON says it: plain objects, lists, numbers and texts."""
    return json.loads(to_json_text(result))
