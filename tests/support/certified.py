"""A small problem with many wishes, and certificates as an optimisation writes them."""

from dataclasses import replace
from typing import Any

import numpy as np

from placement.detection_table import pack_table
from placement.optimiser import Floor, Limits, PlacementProblem, Solution
from placement.proof_files import build_certificate
from scenarios.aeb import AebRule
from scenarios.runs import FrameAxis

Document = dict[str, Any]


def document_of(problem: PlacementProblem, solution: Solution) -> Document:
    """Certificate of a solution."""
    return build_certificate(
        problem,
        solution.certificate,
        pose_index=solution.pose_index,
        units=[{"id": f"U{row}", "site": ""} for row in solution.pose_index],
        presolve=solution.presolve,
        seconds={"optimise": 1.0},
        versions={"place-rsus": "0"},
    )


def two_of_twelve(frame_axis: FrameAxis, rule: AebRule) -> PlacementProblem:
    """Of 12 poses on 6 sites two units for money, one that must reach a floor when one
    fails.
    """
    rng = np.random.default_rng(7)
    detected = rng.random((12, frame_axis.n_frames)) < 0.6
    return PlacementProblem(
        table=pack_table(tuple("abcdefghijkl"), frame_axis, detected),
        limits=Limits(
            site_index=np.arange(12) // 2,
            site_capacity=np.ones(6, dtype=np.int64),
            budget_units=2,
            budget_eur=1000.0,
            unit_cost_eur=100.0 + np.arange(12.0),
            is_forbidden=np.arange(12) == 3,
            rivals=np.array([[0, 1]]),
        ),
        fusion="any",
        rule=replace(rule, n_confirmations=2),
        floors=(Floor(name="--target", share=0.25, n_failures=1),),
    )
