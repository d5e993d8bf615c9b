"""What refinement and sampled worlds add to a result, where they were asked for."""

import textwrap
from collections.abc import Mapping
from typing import Any

from .refinement_summary import refinement_sentences
from .uncertainty_summary import uncertainty_sentences, uncertainty_text

_WIDTH = 80


def added_sentences(summary: Mapping[str, Any]) -> list[str]:
    """For the report's answer."""
    sentences: list[str] = []
    if "refinement" in summary:
        sentences += refinement_sentences(summary["refinement"])
    if "sampled" in summary:
        sentences += uncertainty_sentences(summary["sampled"])
    return sentences


def added_text(summary: Mapping[str, Any]) -> str:
    """For a terminal; empty where nothing is added."""
    lines: list[str] = []
    if "refinement" in summary:
        for sentence in refinement_sentences(summary["refinement"]):
            lines += textwrap.wrap(sentence, _WIDTH)
    if "sampled" in summary:
        lines += ([""] if lines else []) + uncertainty_text(summary["sampled"]).splitlines()
    return "\n".join(lines)
