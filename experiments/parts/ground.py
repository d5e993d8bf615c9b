"""Private ground in the pictures of cameras: values, in words, as a section."""

from collections.abc import Mapping, Sequence
from typing import Annotated

from geometry.scene import Scene
from placement.candidates import CandidatePose
from placement.ground import PrivateGround, private_shares

from ..results.numbers import percent
from ..results.record import Record, Share, says
from .section import Block, Section, Table

_MAX_NAMED = 6  # pairs of unit and area in a sentence
MAX_UNITS, MAX_AREAS = 12, 60
"""Columns and rows of the table: beyond, only what is seen the most."""


class PrivateAreaRecord(Record, frozen=True, kw_only=True):
    """An area."""

    name: Annotated[str, says("Name in the file.")]
    area_m2: Annotated[float, says("Size, in square metres.", ge=0)]


class PrivateGroundRecord(Record, frozen=True, kw_only=True):
    """Views of cameras into areas that they must not look into."""

    areas: Annotated[tuple[PrivateAreaRecord, ...], says("The areas.")]
    units: Annotated[dict[str, dict[str, Share]], says("Of each unit, by its id.")]


def build_private_ground_record(
    units: Sequence[CandidatePose], scene: Scene, ground: PrivateGround
) -> PrivateGroundRecord:
    """Shares of private ground that units see."""
    shares = private_shares(scene, units, ground)
    areas = zip(ground.names, ground.area_m2, strict=True)
    seen = zip(units, shares, strict=True)
    return PrivateGroundRecord(
        areas=tuple(PrivateAreaRecord(name=name, area_m2=float(area)) for name, area in areas),
        units={one.id: dict(zip(ground.names, row.tolist(), strict=True)) for one, row in seen},
    )


def private_ground_sentence(found: PrivateGroundRecord) -> str:
    """Which unit sees how much of which area."""
    seen = [
        f"{unit} sees {percent(share)} of {name}"
        for unit, shares in found.units.items()
        for name, share in shares.items()
        if share > 0.0
    ]
    n_areas = len(found.areas)
    what = "the private area" if n_areas == 1 else f"any of the {n_areas} private areas"
    if not seen:
        return f"No camera has {what} in its picture."
    return f"Of private ground, {'; '.join(seen)}."


def private_ground_sentences(
    found: PrivateGroundRecord | None, others: Mapping[str, PrivateGroundRecord | None]
) -> list[str]:
    """The same of a result; `others` are those of layouts compared with it, by name."""
    if found is None:
        return []
    of_others = [f"{name}: {private_ground_sentence(one)}" for name, one in others.items() if one]
    return [private_ground_sentence(found), *of_others]


def private_ground_section(
    found: PrivateGroundRecord | None, labels: Mapping[str, str]
) -> Section | None:
    """What units see of private ground, the most seen first; `labels` are their names by id."""
    if not found:
        return None
    units, areas = found.units, found.areas
    most_seen = {
        area.name: max((shares[area.name] for shares in units.values()), default=0.0)
        for area in areas
    }
    seeing = sorted(units, key=lambda unit_id: -max(units[unit_id].values(), default=0.0))
    shown = [unit_id for unit_id in units if unit_id in set(seeing[:MAX_UNITS])]
    rows = sorted(areas, key=lambda area: -most_seen[area.name])[:MAX_AREAS]
    caption = "Share of each private area that a unit sees"
    if len(shown) < len(units):
        caption += f"; of {len(units)} units the {len(shown)} that matter most"
    if len(rows) < len(areas):
        caption += f"; of {len(areas)} areas the {len(rows)} that matter most"
    heads = ["area", "size (m\N{SUPERSCRIPT TWO})", "most, by one unit"]
    table = Table(
        caption=caption,
        columns=[*heads, *(labels.get(unit_id, unit_id) for unit_id in shown)],
        rows=[
            [
                area.name,
                f"{area.area_m2:.0f}",
                percent(most_seen[area.name]),
                *(percent(units[unit_id][area.name]) for unit_id in shown),
            ]
            for area in rows
        ],
        numeric=range(1, 3 + len(shown)),
    )
    note = (
        "Seen is what lies in a camera's picture with nothing in between, at the height of "
        "people's eyes. LiDARs take no pictures."
    )
    blocks: list[Block] = [_short_sentence(found, most_seen), table, note]
    return Section("private-ground", "Private ground", blocks)


def _short_sentence(found: PrivateGroundRecord, most_seen: Mapping[str, float]) -> str:
    """Who sees what, where few do; where many do, only how many."""
    n_seen = sum(share > 0.0 for share in most_seen.values())
    n_seeing = sum(max(shares.values()) > 0.0 for shares in found.units.values())
    if n_seen * n_seeing <= _MAX_NAMED:
        return private_ground_sentence(found)
    worst = max(most_seen, key=lambda name: most_seen[name])
    return (
        f"{n_seeing} of {len(found.units)} units see something of {n_seen} of "
        f"{len(most_seen)} private areas; the most is {percent(most_seen[worst])} of {worst}."
    )
