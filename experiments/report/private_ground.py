"""What each unit sees of private ground, as a table."""

from collections.abc import Mapping
from typing import Any

from ..results.numbers import percent

# ---------- ``--no-look FILE``: private ground from a planner's polygons, and what units see of it


def private_ground_sentence(summary: Mapping[str, Any]) -> str:
    """Which unit sees how much of which area."""
    seen = [
        f"{unit} sees {percent(share)} of {name}"
        for unit, shares in summary["units"].items()
        for name, share in shares.items()
        if share > 0.0
    ]
    n_areas = len(summary["areas"])
    what = "the private area" if n_areas == 1 else f"any of the {n_areas} private areas"
    if not seen:
        return f"No camera has {what} in its picture."
    return f"Of private ground, {'; '.join(seen)}."


# ---------- what each unit sees of private ground, as a table


MAX_UNITS, MAX_AREAS = 12, 60
"""Columns and rows of the table: beyond, only what is seen the most."""
_MAX_NAMED = 6  # pairs of unit and area in a sentence


def private_ground_part(
    private_ground: Mapping[str, Any] | None, labels: Mapping[str, str]
) -> dict[str, Any] | None:
    """What ``templates/private_ground.html.j2`` shows.

    Parameters
    ----------
    private_ground : mapping or None
        By :func:`.summarise_private_ground`; None: nobody has named any.
    labels : mapping of str to str
        Short names of the units, by id.

    Returns
    -------
    part : dict or None
        Sentence, caption, columns and rows: one per area, those seen the most first.
    """
    if private_ground is None:
        return None
    units: Mapping[str, Mapping[str, float]] = private_ground["units"]
    areas = private_ground["areas"]
    most_seen = {
        area["name"]: max((shares[area["name"]] for shares in units.values()), default=0.0)
        for area in areas
    }
    seeing = sorted(units, key=lambda unit_id: -max(units[unit_id].values(), default=0.0))
    shown = [unit_id for unit_id in units if unit_id in set(seeing[:MAX_UNITS])]
    rows = sorted(areas, key=lambda area: -most_seen[area["name"]])[:MAX_AREAS]
    caption = "Share of each private area that a unit sees"
    for n_shown, n_all, what in (
        (len(shown), len(units), "units"),
        (len(rows), len(areas), "areas"),
    ):
        if n_shown < n_all:
            caption += f"; of {n_all} {what} the {n_shown} that matter most"
    return {
        "sentence": _short_sentence(private_ground, most_seen),
        "caption": caption,
        "columns": [
            "area",
            "size (m\N{SUPERSCRIPT TWO})",
            "most, by one unit",
            *(labels.get(unit_id, unit_id) for unit_id in shown),
        ],
        "rows": [
            [
                area["name"],
                f"{area['area_m2']:.0f}",
                percent(most_seen[area["name"]]),
                *(percent(units[unit_id][area["name"]]) for unit_id in shown),
            ]
            for area in rows
        ],
    }


def _short_sentence(private_ground: Mapping[str, Any], most_seen: Mapping[str, float]) -> str:
    """Each unit and area where few are seen; where many are, only how many."""
    n_seen = sum(share > 0.0 for share in most_seen.values())
    n_seeing = sum(max(shares.values()) > 0.0 for shares in private_ground["units"].values())
    if n_seen * n_seeing <= _MAX_NAMED:
        return private_ground_sentence(private_ground)
    worst = max(most_seen, key=lambda name: most_seen[name])
    return (
        f"{n_seeing} of {len(private_ground['units'])} units see something of {n_seen} of "
        f"{len(most_seen)} private areas; the most is {percent(most_seen[worst])} of {worst}."
    )
