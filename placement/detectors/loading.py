"""Detectors by name, or from a user's file: a response table in TOML, a network in ONNX."""

import re
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from geometry.arrays import float_array
from geometry.errors import InputError, Unquoted
from geometry.files import Table, load_toml, read_table, take, take_list, take_number

from .box_rule import GeometricDetector, load_min_iou
from .evidence import VRU_CLASSES, Detector, PlanningDetector
from .response import ResponseDetector

DETECTOR_NAMES = ("geometric", "response")
_FILE = "detectors.toml"


def load_detector(name: str = "geometric", *, where: str = "detector") -> Detector:
    """Detector by name or file.

    Parameters
    ----------
    name : str
        "geometric", "response", a ``.toml`` file with a table ``[response]`` as in
        ``data/detectors.toml``, or an ``.onnx`` file.
    where : str
        What named it, for error messages.

    Returns
    -------
    detector : Detector
        Ready.

    Raises
    ------
    InputError
        The name is unknown, or the file cannot be used.
    MissingExtraError
        An ONNX file without onnxruntime.
    """
    if name in DETECTOR_NAMES:
        return load_planning_detector(name)
    path = Path(name)
    if path.suffix == ".toml":
        return _read_response(path, load_toml(path), name=path.name)
    if path.suffix == ".onnx":
        from .network import NetworkDetector, load_onnx_model

        limits = read_table(_defaults()["onnx"], dict[str, float], f"{_FILE}: onnx")
        return NetworkDetector(name=path.name, model=load_onnx_model(path), **limits)
    known = ", ".join(DETECTOR_NAMES)
    raise InputError(where, name, f"{known}, a .toml file with a response table, or an .onnx file")


@cache
def load_planning_detector(name: str = "geometric") -> PlanningDetector:
    """One of the built-in detectors, "geometric" or "response", from ``data/detectors.toml``."""
    table = take(_defaults(), name, _FILE)
    if name == "response":
        return _read_response(_source(), _defaults(), name=name)
    limits = read_table(table, dict[str, float], f"{_FILE}: {name}")
    return GeometricDetector(min_iou=load_min_iou(), **limits)


def _source() -> Traversable:
    return files(__package__) / "data" / _FILE


@cache
def _defaults() -> dict[str, Any]:
    return load_toml(_source())


_NUMBERS = (
    "height_half_px",
    "height_steepness",
    "min_box_height_px",
    "cyclist_end_on",
    "contrast_half",
    "contrast_steepness",
    "box_noise_share",
    "frame_correlation",
    "plan_probability",
)


def _read_response(source: Path | Traversable, document: Table, *, name: str) -> ResponseDetector:
    """Response table of a document; errors name the file and the line."""
    table = document.get("response")
    if not isinstance(table, dict):
        raise InputError(str(source), Unquoted("no table [response]"), "a table [response]")
    try:
        shares, recall = (
            float_array(take_list(table, key, "response"), (-1,), key)
            for key in ("seen_share", "recall")
        )
        numbers = {key: take_number(table, key, "response") for key in _NUMBERS}
        factors = {key: take_number(table, key, "response") for key in VRU_CLASSES}
        for key, factor in factors.items():
            if not 0.0 <= factor <= 1.0:
                raise InputError(key, factor, "0 .. 1")
        return ResponseDetector(
            name=name,
            seen_share=shares,
            recall=recall,
            class_factor=float_array(list(factors.values()), (-1,), "class_factor"),
            **numbers,
        )
    except InputError as error:
        key = error.where.removeprefix("response.")
        where = f"{source}:{_line(source, key)}: {key}"
        raise InputError(where, error.got, error.expected) from None


def _line(source: Path | Traversable, key: str) -> int:
    """Line of a key in the table ``[response]``; that of the table if the key is missing."""
    lines = source.read_text(encoding="utf-8").splitlines()
    header = next(
        (index for index, text in enumerate(lines) if re.match(r"\s*\[\s*response\s*\]", text)), 0
    )
    for index in range(header + 1, len(lines)):
        if re.match(r"\s*\[", lines[index]):
            break
        if re.match(rf"\s*{re.escape(key)}\s*=", lines[index]):
            return index + 1
    return header + 1
