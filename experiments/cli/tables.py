"""What a placement's result has beside layout and proof, for the report's answer."""

from collections.abc import Mapping
from typing import Any

from ..report.private_ground import private_ground_sentence
from ..report.refinement import refinement_sentences
from ..report.sampled_worlds import uncertainty_sentences


def added_sentences(summary: Mapping[str, Any]) -> list[str]:
    """For the report's answer."""
    sentences: list[str] = []
    sentences += _private(summary)
    if "refinement" in summary:
        sentences += refinement_sentences(summary["refinement"])
    if "sampled" in summary:
        sentences += uncertainty_sentences(summary["sampled"])
    return sentences


def _private(summary: Mapping[str, Any]) -> list[str]:
    """What cameras see of private ground; of each layout where several are compared."""
    if "private_ground" not in summary:
        return []
    return [
        private_ground_sentence(summary["private_ground"]),
        *(
            f"{other['name']}: {private_ground_sentence(other['private_ground'])}"
            for other in summary.get("compared", ())
        ),
    ]
