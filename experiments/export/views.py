"""What a layout's cameras see of the ground, as polygons."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from geometry.actors import LOOK_AT_M
from geometry.arrays import BoolArray, FloatArray
from geometry.scene import Scene
from geometry.sensors import CameraModel
from placement.ground import REACH_M, GroundSurvey
from placement.layout import Layout

UNSEEN = "unseen"
NOTE = (
    f"squares of 1 m, {LOOK_AT_M:g} m above the road, up to {REACH_M:g} m from the"
    " middle"
)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """Area that a camera sees, or road that no camera sees."""

    # Its id; empty: what no camera sees.
    unit: str
    # Shapely's polygons without overlap, in any coordinates.
    area: Any
    area_m2: float

    def record(self) -> dict[str, Any]:
        """Fields of it in a table."""
        return {
            "id": f"view of {self.unit}" if self.unit else UNSEEN,
            "unit": self.unit,
            "area_m2": self.area_m2,
            "note": NOTE,
        }


def find_views(
    layout: Layout,
    scene: Scene,
    move: Callable[[FloatArray], FloatArray] = np.asarray,
) -> list[View]:
    """Views of a layout's cameras, in its order, then the road that none sees.

    `move` takes points of the world frame, (n, 2), all at once to the coordinates that
    are wanted.
    """
    import shapely

    survey = GroundSurvey(scene)
    missed = survey.is_road.copy()
    masks = {}
    for unit in layout.units:
        if isinstance(unit.sensor, CameraModel):
            masks[unit.id] = survey.density(unit) > 0.0
            missed &= ~masks[unit.id]
    masks[""] = missed
    areas = [_outline(mask, survey.east_m, survey.north_m) for mask in masks.values()]
    moved = shapely.transform(np.array(areas, dtype=object), move)
    return [
        View(unit=name, area=there, area_m2=float(area.area))
        for name, area, there in zip(masks, areas, moved, strict=True)
    ]


def _outline(mask: BoolArray, east_m: FloatArray, north_m: FloatArray) -> Any:
    """Union of the cells of a mask, (n_north, n_east)."""
    import shapely

    x_m, y_m = (
        np.append(middles_m - 0.5 * step_m, middles_m[-1] + 0.5 * step_m)
        for middles_m in (east_m, north_m)
        for step_m in [middles_m[1] - middles_m[0]]
    )
    # Of each row its stretches: fewer boxes than cells.
    steps = np.diff(np.pad(mask, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    row, first = np.nonzero(steps > 0)
    _, end = np.nonzero(steps < 0)
    stretches = shapely.box(x_m[first], y_m[row], x_m[end], y_m[row + 1])
    return shapely.simplify(shapely.union_all(stretches), 0.0)
