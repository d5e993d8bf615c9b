"""``--sensors``: several models in one question, with their prices among the
objectives.
"""

import pytest

from experiments.cli.answers import unit_notes
from experiments.results.record import UnitRecord
from placement.candidates import build_candidates, build_grid
from placement.layout import load_carlancap_layout
from placement.pipeline import Assembly, place
from placement.question import Question
from placement.wishes import Wishes

COSTS_EUR = {
    "carla-ncap-rgb": 1500.0,
    "basler-aca1920-50gc-16mm": 1900.0,
    "carla-ncap-lidar": 4000,
}
BUDGET_EUR = 5600.0


def model_of(unit):
    """Name of a unit's model."""
    return unit.get("camera") or unit["lidar"]


# Quickly: tests/placement/optimiser/test_limits.py, with prices made up
@pytest.mark.long
def test_cameras_a_longer_lens_and_a_lidar_compete_for_the_money(
    ask, small_study, without_figures
):
    """No single model spends the same money better."""
    found = ask(
        "--sensors", ",".join(COSTS_EUR), "--budget-cost", BUDGET_EUR, "--site-cost 0"
    )
    assert found["gap"] == 0.0
    assert found["spent_eur"] == sum(
        COSTS_EUR[model_of(unit)] for unit in found["layout"]
    )
    assert found["spent_eur"] <= BUDGET_EUR

    study = load_carlancap_layout().units  # always among the candidates
    n_candidates = len(study)
    for model in COSTS_EUR:
        candidates = build_candidates(
            small_study.scene, build_grid(Question(sensors=model))
        )
        n_candidates += len(candidates)
        alone = place(
            Assembly(
                setting=small_study,
                candidates=candidates,
                wishes=Wishes(budget_eur=BUDGET_EUR),
            )
        )
        assert alone.certificate.stages[0].objective <= found["apr"] + 1e-9

    assert found["candidates"] == n_candidates


def test_what_is_mounted_is_told_where_it_is_not_the_default():
    def unit(name, **model):
        pose = {
            "x_m": 1.0,
            "y_m": 2.0,
            "z_m": 6.0,
            "yaw_deg": 0.0,
            "pitch_deg": -15.0,
        }
        return UnitRecord(id=name, site="lamp", **pose, **model)

    wide, long = ({"camera": model} for model in list(COSTS_EUR)[:2])
    mixed = [unit("U1", **wide), unit("U2", **long), unit("U3", **long)]

    assert unit_notes(mixed)[1:] == [
        "models: carla-ncap-rgb (U1); basler-aca1920-50gc-16mm (U2, U3)"
    ]
    assert unit_notes([unit("U1", lidar="carla-ncap-lidar")])[1:] == [
        "models: carla-ncap-lidar (U1)"
    ]
    assert unit_notes([unit("U1", **wide)])[1:] == []
