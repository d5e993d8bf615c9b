"""What a layout is placed in and judged by: scene, runs, braking rule, detectors, radio."""

from dataclasses import dataclass, field

from geometry.errors import InputError
from geometry.scene import Scene
from geometry.sensors import CameraModel
from scenarios.aeb import AebRule
from scenarios.runs import FrameAxis, Refusal, Run

from .detectors import Detector, PlanningDetector
from .links import Links

VUT_SENSORS = ("camera", "lidar")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Setting:
    """The question, but for the layout.

    Attributes
    ----------
    scene : Scene
        What stands still, and the mount sites.
    runs : tuple of Run
        What happens there.
    axis : FrameAxis
        Frames and weights of `runs`.
    rule : AebRule
        From detected frames to braking.
    detector : Detector
        Of cameras, in the evaluator.
    planner : PlanningDetector
        Of cameras, in the detection table.
    refusals : tuple of Refusal
        What was asked for, but cannot be driven.
    links : Links
        From detections to the VUT.
    vut_sensors : tuple of str
        Of ``VUT_SENSORS``: what the VUT itself looks with.
    vut_camera : CameraModel, optional
        In place of the study's.
    """

    scene: Scene
    runs: tuple[Run, ...]
    axis: FrameAxis
    rule: AebRule
    detector: Detector
    planner: PlanningDetector
    refusals: tuple[Refusal, ...] = ()
    links: Links = field(default_factory=Links)
    vut_sensors: tuple[str, ...] = VUT_SENSORS[:1]
    vut_camera: CameraModel | None = None

    def __post_init__(self) -> None:
        for name in self.vut_sensors or ("none",):
            if name not in VUT_SENSORS:
                raise InputError("vut_sensors", name, "one or more of " + ", ".join(VUT_SENSORS))

    def __repr__(self) -> str:
        return f"Setting({self.scene.name!r}, {len(self.runs)} runs)"
