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
    kinds = {kind.__name__: kind for kind in _kinds_in(Result)}
    described = {name: _tidy(_described(part, kinds[name])) for name, part in parts.items()}
    whole = described.pop(Result.__name__)
    return {**_HEAD, **whole, "$defs": {_def_name(name): part for name, part in described.items()}}


def schema_text() -> str:
    """The schema as its file has it."""
    return json.dumps(build_schema(), indent=2, ensure_ascii=False) + "\n"


def _kinds_in(kind: type) -> set[type]:
    """Records and dataclasses of which the fields of one are made, and itself."""
    found: set[type] = set()
    waiting: list[Any] = [msgspec.inspect.type_info(kind)]
    while waiting:
        info = waiting.pop()
        if isinstance(info, msgspec.inspect.StructType | msgspec.inspect.DataclassType):
            if info.cls in found:
                continue
            found.add(info.cls)
        for name in getattr(info, "__struct_fields__", ()):
            value = getattr(info, name)
            values = value if isinstance(value, tuple) else (value,)
            waiting += [part for part in values if isinstance(part, msgspec.Struct)]
    return found


def _described(part: dict[str, Any], kind: type) -> dict[str, Any]:
    """Schema of a kind of value with its own rules and the descriptions of its fields."""
    properties = dict(part["properties"])
    attributes = _attributes(kind)
    for field in msgspec.inspect.type_info(kind).fields:  # type: ignore[attr-defined]
        said = (getattr(field.type, "extra", None) or {}).get("description")
        said = said or attributes.get(field.name)
        described = {} if said is None else {"description": said}
        properties[field.encode_name] = described | properties[field.encode_name]
    rules = getattr(kind, "schema_rules", {})
    summary = (inspect.getdoc(kind) or "").split("\n\n")[0]
    tidy = {} if issubclass(kind, Record) else {"description": summary}
    closed = {"additionalProperties": False}
    return {**part, **tidy, **closed, **rules, "properties": properties}


def _attributes(kind: type) -> dict[str, str]:
    """Descriptions of fields by the Attributes section of a docstring."""
    lines = (inspect.getdoc(kind) or "").partition("Attributes\n----------\n")[2].splitlines()
    found: dict[str, list[str]] = {}
    names: list[str] = []
    for line in lines:
        if line and not line.startswith(" "):
            names = [name.strip() for name in line.split(" : ")[0].split(",")]
        else:
            for name in names:
                found.setdefault(name, []).append(line)
    return {name: "\n".join(text) for name, text in found.items()}


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
        elif key == "title" and isinstance(value, str) and value.isidentifier():
            continue  # the name of a type
        elif key == "enum" and len(value) == 1:
            tidy["const"] = value[0]
        else:
            tidy[key] = _tidy(value)
    return tidy


if __name__ == "__main__":
    write_atomically(SCHEMA_FILE, schema_text())
