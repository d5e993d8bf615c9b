"""How well a layout knows where people stand, on the ground around a junction."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from geometry.actors import load_actors
from geometry.arrays import BoolArray, FloatArray, freeze
from geometry.scene import Scene
from geometry.sensors import CameraModel
from geometry.terrain import on_ground, terrain_of
from scenarios.decision import load_decision_rule

from .candidates import CandidatePose
from .decisions import AIMS
from .ground import GroundSurvey
from .positions import (
    aim_sd_deg,
    box_noise_of,
    camera_errors,
    covariance_matrices_m2,
)

_BODY = "adult"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PositionMap:
    """Errors of reported places over the roads around a junction.

    Attributes
    ----------
    east_m, north_m : (n_east,), (n_north,) float
        Middles of the cells. World frame. [m]
    sd_m : (n_aims, n_north, n_east) float
        Standard deviation in the worst direction, of one frame of all cameras that see
        the cell, with aims as in AIMS; infinite: none does. [m]
    is_road : (n_north, n_east) bool
        Cells on a lane or in the junction.
    """

    east_m: FloatArray
    north_m: FloatArray
    sd_m: FloatArray
    is_road: BoolArray


def find_position_map(
    scene: Scene, units: Sequence[CandidatePose], detector: object
) -> PositionMap:
    """Errors of the places of adults, cell by cell, for a layout and a detector.

    A camera counts where it sees the cell and an adult is high enough in its picture
    for the detector. Cameras are fused by their covariances. LiDARs do not count.
    """
    survey = GroundSurvey(scene)
    rule = load_decision_rule()
    body = load_actors()[_BODY]
    least_px = getattr(detector, "min_box_height_px", 0.0)
    grid_m = np.stack(np.meshgrid(survey.east_m, survey.north_m), axis=-1)
    feet_m = on_ground(grid_m.reshape(-1, 2), terrain_of(scene))
    size_m = np.tile([body.height_m, body.width_m], (len(feet_m), 1))
    # Sums of inverse covariances, of each aim and cell.
    information = np.zeros((len(AIMS), len(feet_m), 2, 2))
    for unit in units:
        # Of LiDARs no pixel density is known.
        if not isinstance(unit.sensor, CameraModel):
            continue
        height_px = survey.density(unit).ravel() * body.height_m
        seen = np.flatnonzero((height_px > 0.0) & (height_px >= least_px))
        for number, aimed in enumerate(AIMS):
            errors = camera_errors(
                unit.pose.position_m,
                feet_m[seen],
                size_m[seen],
                rule=rule,
                box_noise_share=box_noise_of(detector, rule),
                aim_sd_deg=aim_sd_deg(aimed),
            )
            matrices_m2 = covariance_matrices_m2(errors.covariance_m2())
            information[number, seen] += np.linalg.inv(matrices_m2)
    # The least information is in the direction of the largest error.
    least = np.linalg.eigvalsh(information)[..., 0]
    with np.errstate(divide="ignore"):
        sd_m = 1.0 / np.sqrt(np.maximum(least, 0.0))
    return PositionMap(
        east_m=freeze(survey.east_m),
        north_m=freeze(survey.north_m),
        sd_m=freeze(sd_m.reshape(len(AIMS), *survey.is_road.shape)),
        is_road=freeze(survey.is_road),
    )
