"""Errors of the ground positions that units report of road users."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from geometry.arrays import FloatArray, IntArray
from geometry.errors import InputError
from geometry.lidar import LidarModel
from geometry.poses import body_rotation
from geometry.terrain import on_ground
from scenarios.decision import DecisionRule
from scenarios.runs import Run

from .candidates import CandidatePose
from .evaluator.surroundings import load_vut_camera
from .sampling.uncertainty import CALIBRATED, load_aims
from .setting import Setting

# Nearer, or lower, a line of sight meets the ground nowhere.
_LEAST_M = 0.1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GroundErrors:
    """Errors of one unit's reports, along and across its line of sight.

    Standard deviations, (n,) each. The error of the aim is the same in all frames; that
    of the box, or of the beams, and of the body changes.

    Attributes
    ----------
    sight : (n, 2) float
        Unit vectors from the unit to the road user on the ground.
    box_along_m, box_across_m : (n,) float
        Of the box with the body: what changes from frame to frame. [m]
    aim_along_m, aim_across_m : (n,) float
        By the error of tilt and of bearing. [m]
    """

    sight: FloatArray
    box_along_m: FloatArray
    box_across_m: FloatArray
    aim_along_m: FloatArray
    aim_across_m: FloatArray

    def covariance_m2(self) -> FloatArray:
        """Variance of east, covariance, variance of north, (n, 3), in m^2."""
        along = self.box_along_m**2 + self.aim_along_m**2
        across = self.box_across_m**2 + self.aim_across_m**2
        east, north = self.sight.T
        return np.column_stack(
            [
                along * east**2 + across * north**2,
                (along - across) * east * north,
                along * north**2 + across * east**2,
            ]
        )

    def draw_m(
        self,
        aims: FloatArray,
        rng: np.random.Generator,
        run_start: IntArray,
        *,
        correlation: float,
    ) -> FloatArray:
        """Errors (n, 2) east and north of reports, in m.

        `aims` are the errors of tilt and bearing, (2,), in standard deviations. What
        changes is a first-order autoregression in each run, which begins at
        `run_start`.
        """
        changing = _linked(
            rng.standard_normal((2, len(self.sight))), run_start, correlation
        )
        along = changing[0] * self.box_along_m + aims[0] * self.aim_along_m
        across = changing[1] * self.box_across_m + aims[1] * self.aim_across_m
        left = np.column_stack([-self.sight[:, 1], self.sight[:, 0]])
        drawn: FloatArray = along[:, None] * self.sight + across[:, None] * left
        return drawn


def covariance_matrices_m2(covariances_m2: FloatArray) -> FloatArray:
    """Covariances (n, 3) of :class:`GroundErrors` as matrices, (n, 2, 2), in m^2."""
    east, both, north = covariances_m2.T
    matrices: FloatArray = np.array([[east, both], [both, north]]).transpose(2, 0, 1)
    return matrices


def _linked(noise: FloatArray, run_start: IntArray, correlation: float) -> FloatArray:
    """Link normal numbers (2, n) to those before, anew in each run."""
    # Takes a while to load.
    from scipy.signal import lfilter

    linked = noise * math.sqrt(1.0 - correlation**2)
    linked[:, run_start[:-1]] = noise[:, run_start[:-1]]
    for begin, end in pairwise(run_start.tolist()):
        linked[:, begin:end] = lfilter(
            [1.0], [1.0, -correlation], linked[:, begin:end], axis=1
        )
    return linked


def camera_errors(
    lens_m: FloatArray,
    foot_m: FloatArray,
    size_m: FloatArray,
    *,
    rule: DecisionRule,
    box_noise_share: float,
    aim_sd_deg: tuple[float, float],
) -> GroundErrors:
    r"""Errors of places where the lower edge of a camera's box meets the ground.

    A body of height :math:`h` at the ground distance :math:`D` from a lens at the
    height :math:`H` above its feet has the angular height :math:`\alpha =
    \arctan(H / D) - \arctan((H - h) / D)`. The lower side of its box is off by a share
    :math:`s_h` of that: an angle, whatever the lens. An angle down moves the place
    along the line of sight by :math:`dD / d\epsilon = (D^2 + H^2) / H` (from :math:`D =
    H / \tan\epsilon`), which for small bodies is :math:`s_h h D / H`; an angle of
    bearing moves it by :math:`D` across. The middle of two sides, each off by a share
    :math:`s_w` of the body's width :math:`w`, is off by :math:`s_w w / \sqrt 2`. Both
    shares are those of the detector's box noise, upright and across.

    .. math::

       \sigma_{along}^2 = \left(\tfrac{D^2 + H^2}{H}\right)^2
           (s_h^2 \alpha^2 + \sigma_{tilt}^2) + \sigma_{body}^2, \qquad
       \sigma_{across}^2 = \tfrac{s_w^2 w^2}{2} + D^2 \sigma_{bearing}^2
           + \sigma_{body}^2

    On PETS predicted and measured errors agree within a third at all distances, see
    ``results/reality.md``.

    Parameters
    ----------
    lens_m : (3,) or (n, 3) float
        Of the camera. World frame. [m]
    foot_m : (n, 3) float
        Where the road user stands. World frame. [m]
    size_m : (n, 2) float
        Height and width of its body. [m]
    rule : DecisionRule
        Error of the body, and how box noise divides.
    box_noise_share : float
        Error of each side, as a share of the box.
    aim_sd_deg : (float, float)
        Errors of bearing and tilt. [deg]

    Notes
    -----
    A lens that is not above the feet (a road that climbs) sees no place where the sight
    meets the ground: the error along it is that of a lens 0.1 m above, which is large.
    """
    sight, distance, height = _line_of_sight(lens_m, foot_m)
    angle = np.arctan2(height, distance) - np.arctan2(height - size_m[:, 0], distance)
    metres_per_rad = (distance**2 + height**2) / height
    bearing_rad, tilt_rad = np.radians(aim_sd_deg)
    height_share = rule.box_height_factor * box_noise_share
    width_share = rule.box_width_factor * box_noise_share
    along_m = metres_per_rad * height_share * angle
    across_m = width_share * size_m[:, 1] / math.sqrt(2.0)
    return GroundErrors(
        sight=sight,
        box_along_m=np.hypot(along_m, rule.body_sd_m),
        box_across_m=np.hypot(across_m, rule.body_sd_m),
        aim_along_m=metres_per_rad * tilt_rad,
        aim_across_m=distance * bearing_rad,
    )


def lidar_errors(
    lens_m: FloatArray,
    lidar: LidarModel,
    foot_m: FloatArray,
    *,
    rule: DecisionRule,
    aim_sd_deg: tuple[float, float],
) -> GroundErrors:
    r"""Errors of places that a LiDAR's points on a body give.

    Along the line of sight by the noise of the range, :math:`\sigma_r`; across it by
    the spacing :math:`\delta` of the beams, within which an edge lies anywhere:
    :math:`D \delta / \sqrt{12}`. A tilt moves a point that is :math:`H` below by
    :math:`H \sigma_{tilt}` along the ground, a bearing by :math:`D
    \sigma_{bearing}`.
    """
    sight, distance, height = _line_of_sight(lens_m, foot_m)
    spacing_rad = math.radians(lidar.horizontal_fov_deg) / lidar.n_columns
    bearing_rad, tilt_rad = np.radians(aim_sd_deg)
    range_noise = np.full(len(distance), lidar.range_noise_m)
    return GroundErrors(
        sight=sight,
        box_along_m=np.hypot(range_noise, rule.body_sd_m),
        box_across_m=np.hypot(distance * spacing_rad / math.sqrt(12.0), rule.body_sd_m),
        aim_along_m=height * tilt_rad,
        aim_across_m=distance * bearing_rad,
    )


def _line_of_sight(
    lens_m: FloatArray, foot_m: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Direction (n, 2), distance on the ground and height above the feet, (n,)."""
    offset = foot_m - lens_m
    distance = np.maximum(np.hypot(offset[:, 0], offset[:, 1]), _LEAST_M)
    height = np.maximum(-offset[:, 2], _LEAST_M)
    return offset[:, :2] / distance[:, None], distance, height


def box_noise_of(detector: object, rule: DecisionRule) -> float:
    """Error of boxes' sides as a share: the detector's own, else the rule's."""
    own = getattr(detector, "box_noise_share", None)
    if own is None:
        return rule.box_noise_share
    if not 0.0 < own < 1.0:
        raise InputError("detector: box_noise_share", own, "0 < share < 1")
    return float(own)


def aim_sd_deg(aimed: str) -> tuple[float, float]:
    """Errors of bearing and tilt of units that are aimed so, in degrees."""
    errors = load_aims()[aimed]
    return errors.yaw_sd_deg, errors.pitch_sd_deg


def unit_errors(
    unit: CandidatePose,
    detector: object,
    feet: "Feet",
    *,
    rule: DecisionRule,
    aim_sd_deg: tuple[float, float],
) -> GroundErrors:
    """Errors of what a unit reports of road users, by its sensor and a detector."""
    if isinstance(unit.sensor, LidarModel):
        return lidar_errors(
            unit.pose.position_m,
            unit.sensor,
            feet.foot_m,
            rule=rule,
            aim_sd_deg=aim_sd_deg,
        )
    return camera_errors(
        unit.pose.position_m,
        feet.foot_m,
        feet.size_m,
        rule=rule,
        box_noise_share=box_noise_of(detector, rule),
        aim_sd_deg=aim_sd_deg,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Feet:
    """Where road users stand in all frames.

    Attributes
    ----------
    foot_m : (n_frames, 3) float
        World frame. [m]
    size_m : (n_frames, 2) float
        Height and width of the body. [m]
    """

    foot_m: FloatArray
    size_m: FloatArray

    def of(self, frames: IntArray | None) -> "Feet":
        """Those in some frames; None: in all."""
        if frames is None:
            return self
        return Feet(foot_m=self.foot_m[frames], size_m=self.size_m[frames])


def build_feet(runs: Sequence[Run]) -> Feet:
    """Feet of the road users of runs, laid end to end."""
    feet = [on_ground(run.vru_position_m, run.terrain) for run in runs]
    sizes = [(run.encounter.vru.height_m, run.encounter.vru.width_m) for run in runs]
    n_frames = [len(run.time_s) for run in runs]
    return Feet(
        foot_m=np.concatenate(feet), size_m=np.repeat(np.array(sizes), n_frames, axis=0)
    )


def vut_errors(setting: Setting, feet: Feet, *, rule: DecisionRule) -> GroundErrors:
    """Errors of what the VUT's own camera reports; its aim is calibrated."""
    camera = load_vut_camera()
    mount = camera.pose_on(setting.runs[0].encounter.vut).position_m
    lens = [
        on_ground(run.vut_position_m, run.terrain)
        + body_rotation(run.vut_yaw_deg) @ mount
        for run in setting.runs
    ]
    return camera_errors(
        np.concatenate(lens),
        feet.foot_m,
        feet.size_m,
        rule=rule,
        box_noise_share=box_noise_of(setting.detector, rule),
        aim_sd_deg=aim_sd_deg(CALIBRATED),
    )
