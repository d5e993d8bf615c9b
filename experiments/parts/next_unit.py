"""Gain of one more unit."""

from placement.explain.contributions import NextUnit

from ..results.numbers import percent, points
from .section import Section


def next_unit_sentence(unit: NextUnit | None, measure: str) -> str:
    """Gain of one more unit, of an "APR" or a "score"; empty where none fits."""
    if unit is None:
        return ""
    how = "on the detection table, by greedy choice"
    if unit.gain < 0.5e-9:  # what rounding leaves
        return f"One more unit among the candidates would avoid nothing more ({how})"
    return (
        f"One more unit would add {points(unit.gain)} of {measure}: {percent(unit.apr)} with "
        f"{unit.pose} ({how})"
    )


def section(unit: NextUnit | None, measure: str) -> Section | None:
    """One more unit; None where none fits."""
    if unit is None:
        return None
    return Section(
        "next-unit", "What the next unit buys", [f"{next_unit_sentence(unit, measure)}."]
    )
