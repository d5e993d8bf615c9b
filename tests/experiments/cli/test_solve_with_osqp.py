"""OSQP takes part in what commands prove."""

import numpy as np
import osqp
import pytest
from synthetic_instances import SyntheticSize, build_synthetic_instance

from placement.optimiser import Limits, PlacementProblem, constants
from placement.proof_files import save_problem
from scenarios.aeb import AebRule

SIZE = SyntheticSize(
    n_sites=6,
    heights_m=(5.0,),
    n_yaws=6,
    pitches_deg=(-8.0, -16.0),
    zooms_deg=(70.0, 90.0),
    n_runs=40,
    n_frames=1200,
)


@pytest.fixture
def instance(tmp_path, monkeypatch, solver):
    """A file with a made-up placement of which four units cannot see everything.

    Where money is limited and sites that can be paid are too many to walk behind, also
    "auto" goes by OSQP's prices.
    """
    monkeypatch.setattr(constants, "MAX_SITE_SETS", 0)
    made = build_synthetic_instance(SIZE, seed=3)
    problem = PlacementProblem(
        table=made.to_table(),
        limits=Limits(
            site_index=made.site_index,
            site_capacity=made.site_capacity,
            budget_units=4,
            unit_cost_eur=np.ones(len(made.site_index)),
            budget_eur=4.0 if solver == "auto" else None,
        ),
        fusion="any",
        rule=AebRule(
            deceleration_mps2=7.72,
            latency_s=0.025,
            n_confirmations=3,
            frame_rate_hz=10.0,
        ),
    )
    path = tmp_path / "instance.npz"
    save_problem(path, problem)
    return path


@pytest.fixture
def calls(monkeypatch):
    """Steps that OSQP took in each of its calls."""
    steps = []
    solve = osqp.OSQP.solve

    def counted(self, *args, **options):
        result = solve(self, *args, **options)
        steps.append(int(result.info.iter))
        return result

    monkeypatch.setattr(osqp.OSQP, "solve", counted)
    return steps


@pytest.mark.parametrize(
    "solver", ["relax", pytest.param("auto", marks=pytest.mark.long)]
)
def test_the_solve_command_bounds_the_apr_by_osqp(ask, instance, calls, solver):
    summary = ask("solve", instance, "--solver", solver)
    assert sum(calls) > 0
    assert f"OSQP {osqp.__version__}" in summary["solver"]

    first = summary["stages"][0]
    assert first["name"] == "apr"
    assert first["objective"] <= first["bound"] < 1.0
    if solver == "auto":
        assert first["gap"] == 0.0
