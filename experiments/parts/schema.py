"""The JSON schema of results, made from their types.

``python -m experiments.parts.schema``.
"""

import inspect
import json
import re
from collections.abc import Iterable, Iterator
from dataclasses import is_dataclass
from importlib.resources import files
from pathlib import Path
from typing import Any, get_args, get_type_hints

import msgspec

from geometry.writing import write_atomically

from .result import KINDS

SCHEMA_FILE = Path(str(files("experiments"))) / "data" / "result.schema.json"
_HEAD = {
    "$schema": "https://json-schema.org/draft/2020-12/schema",
    "$id": "urn:place-rsus:result:2",
    "title": "place-rsus result, version 2",
    "description": (
        "summary.json of a result folder, and what --json prints: a placement, an"
        " evaluation or a comparison. Shares are 0 to 1. Names end in their unit; no"
        " ending: no unit."
    ),
}
_UNITS = {"m": "metres", "deg": "degrees", "km/h": "km/h", "m/s^2": "m/s^2"}
_UNIT = re.compile(r"\. \[(\S+)\]$")
_ATTRIBUTE = re.compile(r"^(\w+(?:, \w+)*) : .*\n((?:    .*\n?|\n)+)", re.M)


def build_schema() -> dict[str, Any]:
    """Schema of ``summary.json``.

    Types, limits and descriptions of the fields of all results.
    """
    kinds = [*KINDS.values()]
    _, parts = msgspec.json.schema_components(kinds, ref_template="#/$defs/{name}")
    types = {kind.__name__: kind for kind in _kinds_in(kinds)}
    described = {
        name: _tidy(_described(part, types[name])) for name, part in parts.items()
    }
    return {
        **_HEAD,
        "type": "object",
        "oneOf": [{"$ref": f"#/$defs/{_def_name(kind.__name__)}"} for kind in kinds],
        "$defs": {_def_name(name): part for name, part in described.items()},
    }


def schema_text() -> str:
    """The schema as its file has it."""
    return json.dumps(build_schema(), indent=2, ensure_ascii=False) + "\n"


def _kinds_in(kinds: Iterable[Any]) -> Iterator[type]:
    """Records and dataclasses of types, with those of their fields."""
    seen: set[type] = set()

    def walk(kind: Any) -> Iterator[type]:
        if isinstance(kind, type) and (
            is_dataclass(kind) or issubclass(kind, msgspec.Struct)
        ):
            if kind in seen:
                return
            seen.add(kind)
            yield kind
            for hint in get_type_hints(kind).values():
                yield from walk(hint)
        for inner in get_args(kind):
            yield from walk(inner)

    for kind in kinds:
        yield from walk(kind)


def _described(part: dict[str, Any], kind: type) -> dict[str, Any]:
    """Schema of a kind of value, with what its fields say of themselves.

    It has rules of its own.
    """
    properties = dict(part["properties"])
    said = _attributes(kind)
    for field in msgspec.inspect.type_info(kind).fields:  # type: ignore[attr-defined]
        extra = getattr(field.type, "extra", None) or {}
        words = extra.get("description", said.get(field.encode_name))
        if words is not None:
            properties[field.encode_name] = {"description": words} | properties[
                field.encode_name
            ]
    tag = getattr(getattr(kind, "__struct_config__", None), "tag", None)
    if tag is not None:
        properties["schema"] = {
            "description": "Kind and version of this file.",
            "const": tag,
        }
    return {
        **part,
        "description": (inspect.getdoc(kind) or "").split("\n\nAttributes\n")[0],
        "properties": properties,
        "additionalProperties": False,
        **getattr(kind, "schema_rules", {}),
    }


def _attributes(kind: type) -> dict[str, str]:
    """Descriptions of a dataclass's fields in its docstring.

    For those that have no others; the section is numpydoc's.
    """
    text = (inspect.getdoc(kind) or "").partition("Attributes\n----------\n")[2]
    found = {}
    for names, words in _ATTRIBUTE.findall(text):
        said = _UNIT.sub(
            lambda unit: f", in {_UNITS[unit[1]]}.", " ".join(words.split())
        )
        for name in names.split(", "):
            if said.endswith("."):
                found[name] = said
            else:
                found[name] = f"{said}."
    return found


def _def_name(kind: str) -> str:
    """Name of a part: SampledPairRecord is sampled_pair."""
    return re.sub(r"(?<!^)(?=[A-Z])", "_", kind.removesuffix("Record")).lower()


def _tidy(node: Any) -> Any:
    """Schema in its final form.

    References by the names of parts, descriptions on one line, one allowed value as
    "const".
    """
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
            # The name of a class.
            continue
        elif key == "minimum":
            # Annotations that are equal are one for Python, whether they say 0 or 0.0.
            if value == int(value):
                tidy[key] = int(value)
            else:
                tidy[key] = value
        elif key == "enum" and len(value) == 1:
            tidy["const"] = value[0]
        else:
            tidy[key] = _tidy(value)
    return tidy


if __name__ == "__main__":
    write_atomically(SCHEMA_FILE, schema_text())
