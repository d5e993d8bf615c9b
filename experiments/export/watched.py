"""A run with the frames in which each unit detects: what formats show that move."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from geometry.arrays import BoolArray
from geometry.scene import Scene
from placement.compute import DEFAULT_COMPUTE, Compute
from placement.detectors import load_detector, load_planning_detector
from placement.layout import Layout
from placement.setting import Setting
from scenarios.aeb import AebRule, load_aeb_rule
from scenarios.runs import Run, build_frame_axis


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class WatchedRun:
    """A run, and what a layout's units detect of whoever the VUT meets.

    Attributes
    ----------
    run : Run
        What happens.
    detected : mapping of unit's id to (n_frames,) bool
        Frames in which the evaluator's detector finds the road user.
    rule : AebRule
        From detected frames to braking.
    """

    run: Run
    detected: Mapping[str, BoolArray]
    rule: AebRule


def watch_run(
    layout: Layout, scene: Scene, run_id: str, *, compute: Compute = DEFAULT_COMPUTE
) -> WatchedRun:
    """Run that an id names, watched by a layout with the default detector.

    Raises InputError if the id names no run of the scene.
    """
    from placement.evaluator.evaluate import unit_key, watch

    from ..perception_lab.render import find_run

    run, rule = find_run(run_id, scene), load_aeb_rule()
    setting = Setting(
        scene=scene,
        runs=(run,),
        axis=build_frame_axis((run,), np.ones(1)),
        rule=rule,
        detector=load_detector(),
        table_detector=load_planning_detector(),
    )
    found = watch(setting, {unit_key(unit): unit for unit in layout.units}, compute=compute)
    detected = {unit.id: found[unit_key(unit)] for unit in layout.units}
    return WatchedRun(run=run, detected=detected, rule=rule)
