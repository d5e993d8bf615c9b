"""Cases at some of their speeds."""

from dataclasses import replace


def at_first_speed(case):
    """A case at the first of its speeds, and the first of its pairs of speeds."""
    return replace(
        case, vut_speeds_kmh=case.vut_speeds_kmh[:1], pairs_kmh=case.pairs_kmh[:1]
    )
