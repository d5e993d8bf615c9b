"""A sketch of each case from above: how car and road user meet, and what hides them."""

from collections.abc import Sequence

import numpy as np

from geometry.actors import PlacedActor
from geometry.arrays import FloatArray
from geometry.footprints import footprint_corners
from scenarios.runs import Run

from .section import Sketch

HALF_M = 16.0  # half the side of the ground that is shown
_PER_M = 10  # units of the drawing
_USER_M = 0.6  # radius of the mark of who is met


def sketch_case(run: Run) -> Sketch:
    """A sketch of the case of a run; the car drives upwards, and hits in the middle."""
    title = run.case.title.replace("VUT", "car") or run.case.name
    is_near = [
        (abs(places - run.vut_position_m[-1]).max(axis=1) <= HALF_M)
        for places in (run.vut_position_m, run.vru_position_m)
    ]
    first = int(is_near[0].argmax())
    turn = np.radians(90.0 - run.vut_yaw_deg[first])
    rotation = np.array([[np.cos(turn), np.sin(turn)], [-np.sin(turn), np.cos(turn)]])

    def drawn(places_m: FloatArray) -> FloatArray:
        return np.asarray((places_m - run.vut_position_m[-1]) @ rotation * (_PER_M, -_PER_M))

    car = run.encounter.vut
    shape = {"length_m": car.length_m, "width_m": car.width_m}
    at_first = footprint_corners(run.vut_position_m[first], run.vut_yaw_deg[first], **shape)
    user = int(is_near[1].argmax())
    angle = np.linspace(0.0, 2.0 * np.pi, 12, endpoint=False)
    circle = _USER_M * np.column_stack([np.cos(angle), np.sin(angle)])
    return Sketch(
        title=f"{title[:1].upper()}{title[1:]}",
        code=run.case.name,
        half=round(HALF_M * _PER_M),
        paths=[
            *(("body", _path(drawn(corners), is_closed=True)) for corners in _bodies(run)),
            ("way", _path(drawn(run.vut_position_m[first:]))),
            ("car", _path(drawn(at_first), is_closed=True)),
            ("user-way", _path(drawn(run.vru_position_m[user:]))),
            ("user", _path(drawn(run.vru_position_m[user] + circle), is_closed=True)),
        ],
    )


def _bodies(run: Run) -> list[FloatArray]:
    """Footprints of what hides somebody."""

    def is_near(body: PlacedActor) -> bool:
        away_m = body.pose.position_m[:2] - run.vut_position_m[-1]
        return bool(np.hypot(*away_m) <= 2.0 * HALF_M)

    return [body.footprint_m for body in run.obstruction if is_near(body)]


def _path(places: Sequence[Sequence[float]] | FloatArray, *, is_closed: bool = False) -> str:
    """Data of an SVG path through places (n, 2), whole numbers; equal ones in a row once."""
    points = dict.fromkeys(f"{round(x)} {round(y)}" for x, y in np.asarray(places))
    return "M" + "L".join(points) + ("Z" if is_closed else "")
