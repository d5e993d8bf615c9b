"""Bends of lanes that are sharper than their speed limits allow."""

from collections.abc import Iterator

import numpy as np

from geometry.actors import pick_actor
from geometry.errors import InputError
from geometry.junction import Arm, Junction, build_junction
from geometry.notes import Finding
from geometry.scene import Lane, Scene

from . import courses
from .paths import MPS_PER_KMH
from .staging import load_way_rules
from .ways import free_aside_m

# ---------- bends that are too sharp
# From the junction: at 50 km/h, seven seconds.
_REACH_M = 100.0
# Bends are taken over a metre, as those of runs.
_OVER_M = 1.0


def find_sharp_bends(scene: Scene) -> Iterator[Finding]:
    """Warn of each arm whose lanes bend too sharply.

    The speed is their limit, or 50 km/h.
    """
    rules = load_way_rules()
    try:
        junction = build_junction(scene)
    except InputError:
        # Another finding says so.
        return
    for arm in junction.arms.values():
        bends = _bends(junction, arm)
        speed_kmh, distance_m, lane = min(
            bends, key=lambda one: one[0] - _limit_kmh(one[2])
        )
        if speed_kmh < _limit_kmh(lane):
            why = (
                f"lane {lane.id} bends {distance_m:.0f} m from the junction:"
                f" a lateral acceleration of {rules.max_lateral_mps2:g} m/s^2 allows"
                f" {speed_kmh:.0f} km/h there, and faster runs are not driven"
            )
            yield Finding(level="warning", what=f"arm {arm.name}", why=why)


def _limit_kmh(lane: Lane) -> float:
    return lane.speed_limit_kmh or load_way_rules().town_kmh


def _bends(junction: Junction, arm: Arm) -> Iterator[tuple[float, float, Lane]]:
    """Speed at each lane's sharpest bend in km/h, distance, and lane.

    The distance is that of the bend from the junction.
    """
    vut = pick_actor("vut", "vut")
    # Points of a course lie a centimetre apart.
    step = round(_OVER_M / 0.01)
    yield np.inf, 0.0, (*arm.lanes_in, *arm.lanes_out)[0]
    for is_in, lanes in ((True, arm.entry_lanes), (False, arm.exit_lanes)):
        for lane in lanes:
            if is_in:
                followed = junction.followed(lane)
            else:
                followed = lane
            free_m = free_aside_m(vut, followed)
            course = courses.follow_gently(
                [followed.centreline_m], [free_m], origin=int(is_in)
            )
            if is_in:
                reach = (-_REACH_M, 0.0)
            else:
                reach = (0.0, _REACH_M)
            near = course.between(*reach)
            bend_per_m = np.abs(near.yaw_rad[step:] - near.yaw_rad[:-step]) / _OVER_M
            if not len(bend_per_m):
                continue
            # The sharpest metre allows the least speed.
            at = int(bend_per_m.argmax())
            speed_mps = np.sqrt(
                load_way_rules().max_lateral_mps2 / max(bend_per_m[at], 1e-9)
            )
            yield float(speed_mps / MPS_PER_KMH), abs(near.begin_m + 0.01 * at), lane
