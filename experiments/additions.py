"""What a placement's result has beside layout and proof: what units buy, why these, samples."""

import textwrap
from collections.abc import Mapping
from typing import Any

from .explanation_tables import explanation_text
from .no_look import private_sentences
from .refinement_summary import refinement_sentences
from .uncertainty_summary import uncertainty_sentences, uncertainty_text

_WIDTH = 80


def added_sentences(summary: Mapping[str, Any]) -> list[str]:
    """For the report's answer."""
    sentences: list[str] = []
    sentences += _private(summary)
    if "refinement" in summary:
        sentences += refinement_sentences(summary["refinement"])
    if "sampled" in summary:
        sentences += uncertainty_sentences(summary["sampled"])
    return sentences


def added_text(summary: Mapping[str, Any]) -> str:
    """For a terminal; empty where nothing is added."""
    parts = []
    if "front" in summary:
        parts.append(
            ["What each unit buys:", *_wrapped(summary["front"]["sentences"], indent="  ")]
        )
    if "explained" in summary:
        parts.append([explanation_text(summary["explained"])])
    if "private_ground" in summary:
        parts.append(_wrapped(_private(summary)))
    if "refinement" in summary:
        parts.append(_wrapped(refinement_sentences(summary["refinement"])))
    if "sampled" in summary:
        parts.append([uncertainty_text(summary["sampled"])])
    return "\n\n".join("\n".join(part) for part in parts)


def with_additions(summary: Mapping[str, Any], table: str) -> str:
    """A table for a terminal, below what is added to it."""
    return "\n\n".join(text for text in (added_text(summary), table) if text)


def _private(summary: Mapping[str, Any]) -> list[str]:
    """What cameras see of private ground; of each layout where several are compared."""
    if "private_ground" not in summary:
        return []
    sentences = private_sentences(summary["private_ground"])
    for other in summary.get("compared", ()):
        sentences += [
            f"{other['name']}: {sentence}"
            for sentence in private_sentences(other["private_ground"])
        ]
    return sentences


def _wrapped(sentences: list[str], indent: str = "") -> list[str]:
    return [
        line
        for sentence in sentences
        for line in textwrap.wrap(
            sentence, _WIDTH, initial_indent=indent, subsequent_indent=2 * indent
        )
    ]
