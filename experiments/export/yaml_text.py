"""Scalars in YAML that every reader understands alike: PyYAML, yaml-cpp and OpenCV's own."""

import json
from collections.abc import Iterable


def yaml_number(value: float) -> str:
    """A number in full precision; with a point, without which YAML 1.1 takes 1e-07 for text.

    Examples
    --------
    >>> yaml_number(1.0e-7), yaml_number(0.5), yaml_number(1.0e22)
    ('1.0e-07', '0.5', '1.0e+22')
    """
    text = repr(float(value))
    if "e" in text and "." not in text:
        mantissa, exponent = text.split("e")
        return f"{mantissa}.0e{exponent}"
    return text


def yaml_text(value: str) -> str:
    r"""Text in double quotes, whose escapes YAML has from JSON.

    Examples
    --------
    >>> yaml_text('pole "ü", 1')
    '"pole \\"ü\\", 1"'
    """
    return json.dumps(value, ensure_ascii=False)


def yaml_numbers(values: Iterable[float]) -> str:
    """Numbers as a list on one line."""
    return "[" + ", ".join(yaml_number(value) for value in values) + "]"


def left_out_comment(ids: Iterable[str]) -> list[str]:
    """A comment line about units that a format has no words for; none if there are none."""
    named = ", ".join(ids)
    return [f"# Left out, for they are no cameras: {named}"] if named else []
