"""The units of layouts.

Tables of where they are, plans, and the private ground that they see.
"""

from collections.abc import Collection, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated

from geometry.errors import InputError
from geometry.junction import compass_bearing_deg, street_names
from geometry.registry import load_entry
from geometry.scene import Scene
from geometry.terrain import terrain_of
from placement.candidates import CandidatePose, above_ground, is_ring
from placement.forbidden_views import ForbiddenAreas
from placement.layout import Layout
from placement.setting import Setting

from ..figures.axes import NARROW_IN, WIDTH_IN, unit_labels
from ..figures.outlines import compass_word, looking_words
from ..language import localized, tr, trn
from ..results.cached import cached_part
from ..results.numbers import NOTHING, number, percent
from ..results.record import Record, Share, build_unit_records, says
from .section import (
    Block,
    Box,
    Picture,
    Pictures,
    Section,
    Table,
    build_picture,
)

_PLAN_RANGE_M = 35.0
_MAX_UNITS_IN_WORDS = 40
# Labels of more would lie on one another.
_MAX_NARROW_UNITS = 6
# A longer table is to unfold.
_MAX_FLAT_ROWS = 24
# Pairs of unit and area in a sentence.
_MAX_NAMED = 6
MAX_UNITS = 12
MAX_AREAS = 60
"""Columns and rows of the table: beyond, only what is seen the most."""


def units_section(
    layouts: Mapping[str, Layout],
    plans: Sequence[Picture],
    scene: Scene,
    existing: Collection[str] = (),
) -> Section:
    """Places and directions of units, with a plan of each layout.

    Layouts are given by display name; `existing` are ids of mounted units.
    """
    is_beside = len(plans) > 1 and plans[0].width_in < WIDTH_IN
    heights = tr(
        "East, north and height are in metres in the junction's own coordinates; the"
        " road is at height 0."
    )
    if terrain_of(scene) is not None:
        heights = tr(
            "East, north and height are in metres in the junction's own coordinates;"
            " heights are above the ground at that point."
        )
    angles = tr(
        "Bearings are compass bearings, clockwise from north. An assumed site is "
        "not in the map, or the map has it elsewhere."
    )
    note = f"{heights} {angles}"
    tables = [
        unit_table(name, layout, scene, existing) for name, layout in layouts.items()
    ]
    return Section(
        "units",
        tr("The units"),
        [*tables, note, Box("beside" if is_beside else "", plans)],
    )


def tilt_words(pitch_deg: float) -> str:
    """How far a unit looks up or down, in degrees."""
    if pitch_deg < 0.0:
        return tr("{angle:.1f} down", angle=-pitch_deg)
    if pitch_deg:
        return tr("{angle:.1f} up", angle=pitch_deg)
    return tr("level")


def unit_table(
    name: str, layout: Layout, scene: Scene, existing: Collection[str] = ()
) -> Table:
    """The units of a layout, a row each; `existing` are ids of mounted ones."""
    labels = unit_labels(layout)
    # Short ids are marks themselves.
    has_ids = any(mark != unit_id for unit_id, mark in labels.items())
    rows = []
    for unit, record in zip(
        layout.units, build_unit_records(layout, scene), strict=True
    ):
        name_of_unit = labels[record.id]
        if record.id in existing:
            name_of_unit = tr("{unit} (existing)", unit=name_of_unit)
        kind = record.kind and tr(record.kind)
        site = " ".join(filter(None, (kind, record.site))) or NOTHING
        if record.assumed:
            site = tr("{site} (assumed)", site=site)
        bearing = number(compass_bearing_deg(record.yaw_deg), 1)
        if is_ring(unit.sensor):
            bearing = compass_word(unit)
        position_m = above_ground(unit, scene).pose.position_m.tolist()
        rows.append(
            [
                name_of_unit,
                *([record.id] if has_ids else []),
                site,
                tr(record.place or NOTHING),
                *map(number, position_m),
                bearing,
                number(-record.pitch_deg, 1),
                record.camera or record.lidar,
            ]
        )
    caption = tr("Units of {name}", name=name)
    is_long = len(rows) > _MAX_FLAT_ROWS
    return Table(
        caption=caption,
        columns=[
            tr("unit"),
            *([tr("id")] if has_ids else []),
            tr("site"),
            tr("where"),
            tr("east (m)"),
            tr("north (m)"),
            tr("height (m)"),
            tr("bearing (°)"),
            tr("tilt down (°)"),
            tr("sensor"),
        ],
        rows=rows,
        numeric=range(3 + has_ids, 8 + has_ids),
        summary=(
            tr("Units of {name}: all {n}", name=name, n=len(rows)) if is_long else ""
        ),
    )


def build_plans(
    setting: Setting,
    detailed: Mapping[str, Layout],
    others: Sequence[Layout],
    existing: Collection[str] = (),
    *,
    cache_folder: Path | None = None,
) -> Pictures:
    """A plan of each layout, drawn narrower where several stand side by side.

    `existing` are ids of mounted units.
    """
    folder = cache_folder
    # What another font of this machine looks like is in no key.
    if _needs_other_fonts(setting.scene):
        folder = None
    return cached_part(
        folder,
        "plans",
        lambda: _draw_plans(setting, detailed, others, existing),
        kind=Pictures,
        made_from=(setting.scene, setting.runs, detailed, others, sorted(existing)),
    )


def _needs_other_fonts(scene: Scene) -> bool:
    """True if a street's name has letters that the figures' own font lacks."""
    try:
        streets = street_names(scene).values()
    except InputError:
        # No lane ends at the junction.
        return False
    families_for = load_entry("experiments.figures.fonts:families_for")
    return any(families_for(name) != () for name in streets if not name.isascii())


def _draw_plans(
    setting: Setting,
    detailed: Mapping[str, Layout],
    others: Sequence[Layout],
    existing: Collection[str],
) -> Pictures:
    draw = partial(
        # By name: what draws is loaded only where the plans are not cached.
        load_entry("experiments.figures.plan:plot_plan"),
        setting,
        others=others,
        existing=existing,
        max_range_m=_PLAN_RANGE_M,
    )
    are_few = all(
        len(layout.units) <= _MAX_NARROW_UNITS for layout in detailed.values()
    )
    are_side_by_side = len(detailed) > 1 and are_few
    return tuple(
        build_picture(
            draw(layout, width_in=NARROW_IN if are_side_by_side else WIDTH_IN),
            narrow=(
                draw(layout, width_in=NARROW_IN)
                if are_few and not are_side_by_side
                else None
            ),
            title=tr(
                "Plan of {scene} with {name}", scene=setting.scene.name, name=name
            ),
            caption=tr(
                "Coloured: the ground in each sensor's field of view up to {range:g} "
                "m; the sensors see farther. The numbers account for what walls and "
                "parked cars hide; the drawing does not show it.",
                range=_PLAN_RANGE_M,
            ),
            alt=tr("Plan of the junction, north up.") + " " + _units_in_words(layout),
        )
        for name, layout in detailed.items()
    )


def _units_in_words(layout: Layout) -> str:
    if len(layout.units) > _MAX_UNITS_IN_WORDS:
        return tr(
            "{n} units; the table above gives their positions.", n=len(layout.units)
        )
    labels = unit_labels(layout)
    return " ".join(
        tr(
            "{unit} at {east} m east, {north} m north, {looking}.",
            unit=labels[unit.id],
            east=number(unit.pose.position_m[0], 1),
            north=number(unit.pose.position_m[1], 1),
            looking=looking_words(unit),
        )
        for unit in layout.units
    )


class PrivateAreaRecord(Record, frozen=True, kw_only=True):
    """An area."""

    name: Annotated[str, says("Name in the file.")]
    area_m2: Annotated[float, says("Size, in square metres.", ge=0)]


class PrivateGroundRecord(Record, frozen=True, kw_only=True):
    """Views of cameras into areas that they must not look into."""

    areas: Annotated[tuple[PrivateAreaRecord, ...], says("The areas.")]
    units: Annotated[dict[str, dict[str, Share]], says("Of each unit, by its id.")]


def build_private_ground_record(
    units: Sequence[CandidatePose], scene: Scene, ground: ForbiddenAreas
) -> PrivateGroundRecord:
    """Shares of private ground that units see."""
    shares = ground.shares(scene, units)
    areas = zip(ground.names, ground.area_m2, strict=True)
    seen = zip(units, shares, strict=True)
    return PrivateGroundRecord(
        areas=tuple(
            PrivateAreaRecord(name=name, area_m2=float(area)) for name, area in areas
        ),
        units={
            one.id: dict(zip(ground.names, row.tolist(), strict=True))
            for one, row in seen
        },
    )


def private_ground_sentence(found: PrivateGroundRecord) -> str:
    """Which unit sees how much of which area."""
    seen = [
        tr("{unit} sees {share} of {area}", unit=unit, share=percent(share), area=name)
        for unit, shares in found.units.items()
        for name, share in shares.items()
        if share > 0.0
    ]
    n_areas = len(found.areas)
    if not seen:
        return trn(
            "No camera has the private area in its picture.",
            "No camera has any of the {n} private areas in its picture.",
            n_areas,
        )
    return tr("Private ground: {views}.", views="; ".join(seen))


def private_ground_section(
    found: PrivateGroundRecord | None, labels: Mapping[str, str]
) -> Section | None:
    """What units see of private ground, the most seen first.

    `labels` are their names by id.
    """
    if not found:
        return None
    units = found.units
    areas = found.areas
    most_seen = {
        area.name: max((shares[area.name] for shares in units.values()), default=0.0)
        for area in areas
    }
    seeing = sorted(
        units, key=lambda unit_id: -max(units[unit_id].values(), default=0.0)
    )
    shown = [unit_id for unit_id in units if unit_id in set(seeing[:MAX_UNITS])]
    told = sorted(areas, key=lambda area: -most_seen[area.name])[:MAX_AREAS]
    caption = tr("Share of each private area that a unit sees")
    if len(shown) < len(units):
        caption += tr(
            "; the {n} most important of {all} units", all=len(units), n=len(shown)
        )
    if len(told) < len(areas):
        caption += tr(
            "; the {n} most important of {all} areas", all=len(areas), n=len(told)
        )
    columns = [
        *[tr("area"), tr("size (m²)"), tr("largest share seen by one unit")],
        *(labels.get(unit_id, unit_id) for unit_id in shown),
    ]
    rows = []
    for area in told:
        shares = (
            most_seen[area.name],
            *(units[unit_id][area.name] for unit_id in shown),
        )
        rows.append(
            [area.name, localized(f"{area.area_m2:.0f}"), *map(percent, shares)]
        )
    table = Table(
        caption=caption, columns=columns, rows=rows, numeric=range(1, 3 + len(shown))
    )
    note = tr(
        "A point counts as seen if it is in a camera's image at eye level with"
        " nothing in between. LiDARs take no images."
    )
    blocks: list[Block] = [_short_sentence(found, most_seen), table, note]
    return Section("private-ground", tr("Private ground"), blocks)


def _short_sentence(found: PrivateGroundRecord, most_seen: Mapping[str, float]) -> str:
    """Who sees what, where few do; where many do, only how many."""
    n_seen = sum(share > 0.0 for share in most_seen.values())
    n_seeing = sum(max(shares.values()) > 0.0 for shares in found.units.values())
    if n_seen * n_seeing <= _MAX_NAMED:
        return private_ground_sentence(found)
    worst = max(most_seen, key=lambda name: most_seen[name])
    return tr(
        "{seeing} of {units} units see part of {seen} of {areas} private areas; the"
        " largest share seen is {share} of {worst}.",
        seeing=n_seeing,
        units=len(found.units),
        seen=n_seen,
        areas=len(most_seen),
        share=percent(most_seen[worst]),
        worst=worst,
    )
