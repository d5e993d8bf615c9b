"""What is left out of a file, and why: counted by kind, so that the list stays short."""

from dataclasses import dataclass, field

from ..model import Skipped

_MAX_ENTRIES = 100


@dataclass(frozen=True, slots=True)
class Omissions:
    """A list that grows while a file is read.

    Attributes
    ----------
    found : dict of (str, str) to list of str
        Ids of what was left out, by what it is (in the plural) and why.
    """

    found: dict[tuple[str, str], list[str]] = field(default_factory=dict)

    def add(self, kind: str, name: str, why: str) -> None:
        """Leave one thing out.

        Parameters
        ----------
        kind : str
            What it is, in the plural: "signals of other kinds".
        name : str
            The one at hand: "road 5 signal 12".
        why : str
            In words.
        """
        self.found.setdefault((kind, why), []).append(name)

    def listed(self) -> tuple[Skipped, ...]:
        """One entry per kind and reason."""
        entries = [
            Skipped(
                what=names[0]
                if len(names) == 1
                else f"{len(names)} {kind}, such as {names[0]} and {names[1]}",
                why=why,
            )
            for (kind, why), names in self.found.items()
        ]
        if len(entries) > _MAX_ENTRIES:
            n_more = len(entries) - _MAX_ENTRIES + 1
            entries = entries[: _MAX_ENTRIES - 1]
            entries.append(Skipped(what=f"{n_more} more kinds of things", why="see those above"))
        return tuple(entries)
