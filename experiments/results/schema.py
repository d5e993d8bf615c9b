"""The JSON schema of results, made from their types: ``python -m experiments.results.schema``."""

import inspect
import json
import re
from importlib.resources import files
from pathlib import Path
from typing import Any

import msgspec

from geometry.files import write_atomically

from .record import Record
from .result import Result

SCHEMA_FILE = Path(str(files("experiments"))) / "data" / "result.schema.json"
_HEAD = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "$id": "urn:place-rsus:result:1",
    "title": "place-rsus result, version 1",
}


def build_schema() -> dict[str, Any]:
    """Schema of ``summary.json``: types, limits and descriptions of :class:`Result`'s fields."""
    _, parts = msgspec.json.schema_components([Result], ref_template="#/$defs/{name}")
    kinds = {kind.__name__: kind for kind in _kinds_of(Record)}
    described = {name: _tidy(_described(part, kinds[name])) for name, part in parts.items()}
    whole = described.pop(Result.__name__)
    return {**_HEAD, **whole, "$defs": {_def_name(name): part for name, part in described.items()}}


def schema_text() -> str:
    """The schema as its file has it."""
    return json.dumps(build_schema(), indent=2, ensure_ascii=False) + "\n"


def _kinds_of(kind: type[Record]) -> list[type[Record]]:
    return [kind, *(below for child in kind.__subclasses__() for below in _kinds_of(child))]


def _described(part: dict[str, Any], kind: type[Record]) -> dict[str, Any]:
    """Schema of a kind of record with its own rules, and with what its fields say of themselves."""
    properties = dict(part["properties"])
    for field in msgspec.inspect.type_info(kind).fields:  # type: ignore[attr-defined]
        extra = getattr(field.type, "extra", None) or {}
        said = {key: extra[key] for key in ("description",) if key in extra}
        properties[field.encode_name] = said | properties[field.encode_name]
    return {**part, **kind.schema_rules, "properties": properties}


def _def_name(kind: str) -> str:
    """Name of a part: SampledPairRecord is sampled_pair."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", kind.removesuffix("Record")).lower()


def _tidy(node: Any) -> Any:
    """References by the names of parts, descriptions on one line, one allowed value as "const"."""
    if isinstance(node, list):
        return [_tidy(item) for item in node]
    if not isinstance(node, dict):
        return node
    tidy: dict[str, Any] = {}
    for key, value in node.items():
        if key == "$ref":
            tidy[key] = "#/$defs/" + _def_name(value.rsplit("/", 1)[1])
        elif key == "description" and isinstance(value, str):
            tidy[key] = " ".join(inspect.cleandoc(value).split())
        elif key == "title" and value in _TITLES_LEFT_OUT:
            continue
        elif key == "enum" and len(value) == 1:
            tidy["const"] = value[0]
        else:
            tidy[key] = _tidy(value)
    return tidy


_TITLES_LEFT_OUT = {kind.__name__ for kind in _kinds_of(Record)}


if __name__ == "__main__":
    write_atomically(SCHEMA_FILE, schema_text())
