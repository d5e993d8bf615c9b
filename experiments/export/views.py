"""What cameras see of the ground, and what none of them sees, as areas for maps."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from geometry.arrays import BoolArray, FloatArray
from geometry.scene import Scene
from geometry.sensors import CameraModel
from placement.ground import LOOK_AT_M, REACH_M, GroundSurvey
from placement.layout import Layout

UNSEEN = "unseen"
NOTE = f"squares of 1 m, {LOOK_AT_M:g} m above the road, up to {REACH_M:g} m from the middle"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """Area that a camera sees, or road that no camera sees."""

    unit: str  # its id; empty: what no camera sees
    area: Any  # shapely's polygons without overlap

    def record(self) -> dict[str, Any]:
        """Fields of it in a table."""
        return {
            "id": f"view of {self.unit}" if self.unit else UNSEEN,
            "unit": self.unit,
            "area_m2": float(self.area.area),
            "note": NOTE,
        }


def find_views(layout: Layout, scene: Scene) -> list[View]:
    """Views of a layout's cameras, in its order, then the road that none sees; world frame."""
    survey = GroundSurvey(scene)
    missed = survey.is_road.copy()
    masks = {}
    for unit in layout.units:
        if isinstance(unit.sensor, CameraModel):
            masks[unit.id] = survey.density(unit) > 0.0
            missed &= ~masks[unit.id]
    return [
        View(unit=name, area=_outline(mask, survey.east_m, survey.north_m))
        for name, mask in [*masks.items(), ("", missed)]
    ]


def moved(views: Iterable[View], move: Callable[[FloatArray], FloatArray]) -> list[View]:
    """Views in other coordinates, moved all at once: (n, 2) -> (n, 2)."""
    import shapely

    given = list(views)
    areas = shapely.transform(np.array([view.area for view in given], dtype=object), move)
    return [View(unit=view.unit, area=area) for view, area in zip(given, areas, strict=True)]


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
