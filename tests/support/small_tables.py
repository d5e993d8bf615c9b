"""Problems written out by hand: which pose avoids which run."""

from collections.abc import Sequence

import numpy as np
from tiny_worlds import axis_of_runs

from placement.detection_table import DetectionTable, pack_table
from placement.optimiser import Limits, PlacementProblem
from scenarios.aeb import AebRule

RULE = AebRule(
    deceleration_mps2=7.72,
    latency_s=0.025,
    n_confirmations=1,
    frame_rate_hz=10.0,
)


def avoiding_table(
    rows: Sequence[str], ids: Sequence[str] = (), weights: Sequence[float] = ()
) -> DetectionTable:
    """A table of runs with one frame that counts: "101" is a pose that avoids the outer
    two.
    """
    n_runs = len(rows[0])
    share = np.array(weights or [1.0] * n_runs)
    axis = axis_of_runs(
        np.arange(0, 2 * n_runs + 1, 2),
        np.tile([-0.1, 0.0], n_runs),
        -0.01,
        weight=share / share.sum(),
        ids=[f"run{index}" for index in range(n_runs)],
    )
    avoids = np.array([[letter == "1" for letter in row] for row in rows])
    detected = np.zeros((len(rows), axis.n_frames), dtype=bool)
    detected[:, ::2] = avoids
    return pack_table(tuple(ids) or tuple(map(str, range(len(rows)))), axis, detected)


def avoiding_problem(
    rows: Sequence[str],
    *,
    price_eur: Sequence[float] = (),
    weights: Sequence[float] = (),
    budget_units: int | None = None,
) -> PlacementProblem:
    """Poses on sites of their own, 1000 EUR each unless said."""
    n_poses = len(rows)
    return PlacementProblem(
        table=avoiding_table(rows, weights=weights),
        limits=Limits(
            site_index=np.arange(n_poses),
            site_capacity=np.ones(n_poses, dtype=np.int64),
            budget_units=budget_units,
            unit_cost_eur=np.array(price_eur or [1000.0] * n_poses),
        ),
        fusion="any",
        rule=RULE,
    )
