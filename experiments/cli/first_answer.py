"""First lines of an answer: layout, APR and proof, not yet judged."""

from geometry.junction import compass_bearing_deg
from geometry.scene import Scene
from placement.candidates import CandidatePose, above_ground
from placement.optimiser.problem import Objective, apr
from placement.pipeline import Placement

from ..jobs.search import FoundLayout
from ..language import tr, trn
from ..results.numbers import percent


def first_answer(found: FoundLayout) -> list[str]:
    """Lines that say what was found, on the detection table.

    A sentence, a line for each unit, and what comes next.
    """
    scene = found.job.scene
    placement = found.placement
    return [
        _found_sentence(placement),
        *(_unit_line(unit, scene) for unit in placement.layout.units),
        tr("The evaluator judges this layout next."),
    ]


def _found_sentence(placement: Placement) -> str:
    n_units = len(placement.layout.units)
    share = percent(apr(placement.problem, placement.pose_index))
    if placement.is_proven:
        found = trn(
            "Found and proven on the detection table: {n} unit, APR {share}",
            "Found and proven on the detection table: {n} units, APR {share}",
            n_units,
            share=share,
        )
    else:
        found = trn(
            "Best found in the time given, not proven: {n} unit, APR {share} on"
            " the detection table",
            "Best found in the time given, not proven: {n} units, APR {share} on"
            " the detection table",
            n_units,
            share=share,
        )
    left = {stage.name: stage.objective for stage in placement.certificate.stages}
    one_failed = left.get(Objective.APR_ONE_FAILED)
    if one_failed is None or n_units < 2:
        return f"{found}."
    words = tr("{share} if one of them fails", share=percent(one_failed))
    return f"{found}; {words}."


def _unit_line(unit: CandidatePose, scene: Scene) -> str:
    """Where a unit is mounted, and where it looks; a negative tilt is down."""
    pose = unit.pose
    words = tr(
        "{unit}: {site}, {height:.2f} m above ground, bearing {bearing:.0f}°, tilt"
        " {tilt:.0f}°",
        unit=unit.id,
        site=unit.site_id or tr("no site"),
        height=above_ground(unit, scene).pose.position_m[2],
        bearing=compass_bearing_deg(pose.yaw_deg),
        tilt=pose.pitch_deg,
    )
    return f"  {words}"
