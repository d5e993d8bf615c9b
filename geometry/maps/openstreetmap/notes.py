"""What was not taken, or not as it stands: gathered while reading, told once per reason."""

from dataclasses import dataclass, field

from ..model import Skipped


@dataclass(slots=True)
class Notes:
    """Elements by the reason for which they were left out.

    Attributes
    ----------
    reasons : dict of (str, str) to list of str
        Kind of element in the plural and reason -> ids.
    """

    reasons: dict[tuple[str, str], list[str]] = field(default_factory=dict)

    def add(self, kinds: str, element: str, why: str) -> None:
        """Keep an element in mind: "walls", "way 5", "it has no length"."""
        elements = self.reasons.setdefault((kinds, why), [])
        if element not in elements[-1:]:
            elements.append(element)

    def skipped(self) -> tuple[Skipped, ...]:
        """One entry per reason, with a count where there is more than one element."""
        return tuple(
            Skipped(
                what=elements[0]
                if len(elements) == 1
                else f"{len(elements)} {kinds} ({elements[0]}, ..)",
                why=why,
            )
            for (kinds, why), elements in self.reasons.items()
        )
