"""Notes on how a scene was made.

They say what its maps leave open, what was assumed, and what was left out.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Literal, get_args

from .phrases import Phrase, join_phrases
from .tables import Text, says

Kind = Literal[
    "junction", "side of the road", "sites", "roads", "buildings", "heights", "left out"
]
"""Subjects of notes, the most important first; all but the last are assumptions."""


@dataclass(frozen=True, slots=True)
class Note:
    """Something that was assumed where a map leaves it open, or that was left out."""

    what: Annotated[
        Text,
        says('Kind and id, as the source has them: "way 4711", "road 5 object 12".'),
    ]
    why: Annotated[Text, says("Assumption, or reason, in words.")]
    kind: Annotated[Kind, says("Subject.")] = "left out"
    site_ids: Annotated[
        tuple[Text, ...],
        says("Sites of the scene that the map does not have, or not there."),
    ] = ()

    @property
    def words(self) -> Phrase:
        """The note in a line, to be translated."""
        return Phrase("{what}: {why}", what=self.what, why=self.why)

    def __str__(self) -> str:
        return str(self.words)


def assumptions(notes: Sequence[Note]) -> tuple[Note, ...]:
    """Notes on what was assumed, the most important kind first.

    >>> masts = Note("masts", "none in the map", kind="sites")
    >>> [note.what for note in assumptions([Note("way 1", "no road"), masts])]
    ['masts']
    """
    order = get_args(Kind)
    found = [note for note in notes if note.kind != "left out"]
    return tuple(sorted(found, key=lambda note: order.index(note.kind)))


def assumed_sites(notes: Sequence[Note]) -> dict[str, str]:
    """Assumptions about sites that a map lacks, by the site's id.

    The map does not have these sites at all, or not where they are.
    """
    words: dict[str, list[str]] = {}
    for note in notes:
        for site_id in note.site_ids:
            words.setdefault(site_id, []).append(note.why)
    return {site_id: join_phrases(whys, "; ") for site_id, whys in words.items()}


@dataclass(frozen=True, slots=True)
class Finding:
    """What may be wrong, and why.

    An error makes results wrong; a warning may be as it is.
    """

    level: Literal["error", "warning"]
    what: str
    why: str
