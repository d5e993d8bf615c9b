"""The units of a report's layouts: tables of where they are, and plans."""

from collections.abc import Mapping, Sequence
from functools import partial

from geometry.junction import compass_bearing_deg
from geometry.scene import Scene
from geometry.terrain import terrain_of
from placement.candidates import above_ground
from placement.layout import Layout
from placement.setting import Setting

from ..figures.axes import NARROW_IN, WIDTH_IN, unit_labels
from ..figures.plan import compass_word, looking_words, plot_plan
from ..results.numbers import NOTHING, number
from ..results.record import build_unit_records
from .section import Box, Picture, Section, Table, build_picture

_PLAN_RANGE_M = 35.0
_MAX_UNITS_IN_WORDS = 40
_MAX_NARROW_UNITS = 6  # labels of more would lie on one another
_MAX_FLAT_ROWS = 24  # a longer table is to unfold
_COLUMNS = (
    *("mark", "id", "site", "kind", "where", "east (m)", "north (m)", "height (m)"),
    *("bearing (°)", "tilt down (°)", "yaw (°)", "pitch (°)", "looks to the", "sensor"),
)


def units_section(layouts: Mapping[str, Layout], plans: Sequence[Picture], scene: Scene) -> Section:
    """Places and directions of the units of layouts, by display name, with a plan of each."""
    is_beside = len(plans) > 1 and plans[0].width_in < WIDTH_IN
    is_flat = terrain_of(scene) is None
    where = "the road is at height 0" if is_flat else "height is that above the ground below"
    note = (
        f"East, north and height are metres in the junction's own coordinates; {where}. The "
        "bearing is that of a compass, clockwise from north; yaw is counted counter-clockwise from "
        "east; pitch is negative where the sensor looks down. An assumed site is one that the map "
        "does not have, or not there."
    )
    tables = [unit_table(name, layout, scene) for name, layout in layouts.items()]
    return Section("units", "The units", [*tables, note, Box("beside" if is_beside else "", plans)])


def unit_table(name: str, layout: Layout, scene: Scene) -> Table:
    """The units of a layout, a row each."""
    labels = unit_labels(layout)
    rows = [
        [
            labels[record.id],
            record.id,
            f"{record.site} (assumed)" if record.assumed else record.site or NOTHING,
            record.kind or NOTHING,
            record.place or NOTHING,
            *(number(value) for value in above_ground(unit, scene).pose.position_m.tolist()),
            number(compass_bearing_deg(record.yaw_deg), 1),
            number(-record.pitch_deg, 1),
            number(record.yaw_deg, 1),
            number(record.pitch_deg, 1),
            compass_word(unit),
            record.camera or record.lidar,
        ]
        for unit, record in zip(layout.units, build_unit_records(layout, scene), strict=True)
    ]
    caption = f"Units of {name}"
    return Table(
        caption=caption,
        columns=_COLUMNS,
        rows=rows,
        numeric=range(5, 12),
        summary=f"{caption}: all {len(rows)}" if len(rows) > _MAX_FLAT_ROWS else "",
    )


def build_plans(
    setting: Setting, detailed: Mapping[str, Layout], others: Sequence[Layout]
) -> list[Picture]:
    """A plan of each layout, drawn narrower where several stand side by side."""
    draw = partial(plot_plan, setting, others=others, max_range_m=_PLAN_RANGE_M)
    are_few = all(len(layout.units) <= _MAX_NARROW_UNITS for layout in detailed.values())
    are_side_by_side = len(detailed) > 1 and are_few
    return [
        build_picture(
            draw(layout, width_in=NARROW_IN if are_side_by_side else WIDTH_IN),
            narrow=draw(layout, width_in=NARROW_IN) if are_few and not are_side_by_side else None,
            title=f"Plan of {setting.scene.name} with {name}",
            caption=(
                "Coloured outlines: the ground in each sensor's field of view, up to "
                f"{_PLAN_RANGE_M:g} m; they see farther. Walls and parked cars hide parts "
                "of it, which is taken into account in the numbers but not drawn here."
            ),
            alt="Plan of the junction, north up. " + _units_in_words(layout),
        )
        for name, layout in detailed.items()
    ]


def _units_in_words(layout: Layout) -> str:
    if len(layout.units) > _MAX_UNITS_IN_WORDS:
        return f"{len(layout.units)} units: where each is says the table above."
    labels = unit_labels(layout)
    return " ".join(
        f"{labels[unit.id]} at {number(unit.pose.position_m[0], 1)} m east, "
        f"{number(unit.pose.position_m[1], 1)} m north, {looking_words(unit)}."
        for unit in layout.units
    )
