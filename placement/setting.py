"""What a layout is placed in and judged by: scene, runs, braking rule, detector."""

from dataclasses import dataclass

from geometry.scene import Scene
from scenarios.aeb import AebRule
from scenarios.runs import FrameAxis, Refusal, Run

from .detector import Detector


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
        What counts as a detection.
    refusals : tuple of Refusal
        What was asked for, but cannot be driven.
    """

    scene: Scene
    runs: tuple[Run, ...]
    axis: FrameAxis
    rule: AebRule
    detector: Detector
    refusals: tuple[Refusal, ...] = ()

    def __repr__(self) -> str:
        return f"Setting({self.scene.name!r}, {len(self.runs)} runs)"
