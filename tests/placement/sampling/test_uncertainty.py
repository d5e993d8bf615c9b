"""What uncertainties refuse, and the latencies that they draw."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.random import default_rng
from refusals import refused_with

from geometry.actors import load_actors
from geometry.errors import InputError
from placement.latency import load_latency_budget
from placement.sampling.uncertainty import (
    LatencyJitter,
    MountingErrors,
    StandingTraffic,
    Uncertainty,
    VehicleKind,
)


def _kind(parked=1.0, waiting=1.0):
    """A van, parked and waiting with these shares."""
    return VehicleKind(
        actor=load_actors()["parked-van"],
        parked_share=parked,
        waiting_share=waiting,
    )


@pytest.mark.parametrize(
    ("build", "field"),
    [
        (MountingErrors, "yaw_sd_deg"),
        (MountingErrors, "pitch_sd_deg"),
        (MountingErrors, "height_sd_m"),
        (LatencyJitter, "mean_s"),
        (LatencyJitter, "sd_s"),
        (Uncertainty, "packet_loss"),
        (StandingTraffic, "taken_share"),
        (StandingTraffic, "waiting_share"),
        (StandingTraffic, "following_share"),
        (StandingTraffic, "bus_lane_share"),
        (StandingTraffic, "free_place_m"),
        (StandingTraffic, "parked_gap_m"),
        (StandingTraffic, "clear_of_mouth_m"),
        (StandingTraffic, "waiting_gap_m"),
        (StandingTraffic, "crosswalk_gap_m"),
        (StandingTraffic, "along_arm_m"),
        (StandingTraffic, "clearance_m"),
    ],
)
@pytest.mark.parametrize("value", [-0.1, np.nan, np.inf, "1", True, None])
def test_every_number_is_checked(build, field, value):
    with pytest.raises(InputError) as caught:
        build(**{field: value})
    assert caught.value.where == field


@pytest.mark.parametrize("field", ["parked_share", "waiting_share"])
@pytest.mark.parametrize("value", [-0.1, 1.1, np.nan, True])
def test_shares_of_a_kind_are_shares(field, value):
    with pytest.raises(InputError, match=rf"^{field}: got "):
        replace(_kind(), **{field: value})


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (
            lambda: MountingErrors(height_sd_m=2),
            "height_sd_m: got 2; expected 0 to 0.5 metres",
        ),
        (
            lambda: LatencyJitter(sd_s=0.01),
            "sd_s: got 0.01; expected less spread around a mean of 0 s: none below 0",
        ),
        (
            lambda: LatencyJitter(distribution="uniform", mean_s=0.01, sd_s=0.006),
            (
                "sd_s: got 0.006; expected less spread around a mean of 0.01 s: none"
                " below 0"
            ),
        ),
        (
            lambda: LatencyJitter(mean_s=0.01, budget=load_latency_budget("cpm-50ms")),
            "budget: got 'cpm-50ms'; expected no mean_s and sd_s beside it",
        ),
        (
            lambda: Uncertainty(draws_detections=1),
            "draws_detections: got 1; expected true or false",
        ),
        (
            lambda: StandingTraffic(taken_share=0.5),
            "vehicles: got none; expected at least one kind of vehicle",
        ),
    ],
)
def test_what_cannot_be_is_said(build, message):
    with refused_with(message):
        build()


def test_a_mix_that_nobody_is_drawn_from_may_be_anything():
    traffic = StandingTraffic(taken_share=0.5, vehicles=(_kind(waiting=0.2),))
    assert not traffic.is_empty
    assert StandingTraffic(following_share=1.0).is_empty


# Latency


@given(
    st.sampled_from(["gamma", "uniform"]),
    st.floats(0.001, 0.2),
    st.floats(0.05, 0.57),
    st.integers(0, 1000),
)
def test_latency_has_its_mean_and_deviation_and_is_never_negative(
    kind, mean_s, ratio, seed
):
    jitter = LatencyJitter(distribution=kind, mean_s=mean_s, sd_s=ratio * mean_s)
    drawn = jitter.draw_s(default_rng(seed), 4000, rule_latency_s=0.025)

    assert drawn.min() >= 0.0
    # Six standard errors of the mean; the deviation's own error is at most some 2 %.
    assert abs(drawn.mean() - mean_s) <= 6.0 * ratio * mean_s / np.sqrt(4000)
    assert drawn.std() == pytest.approx(ratio * mean_s, rel=0.15)

    if kind == "uniform":
        assert np.abs(drawn - mean_s).max() <= np.sqrt(3.0) * ratio * mean_s * (
            1.0 + 1e-9
        )


def test_latency_without_spread_is_its_mean():
    jitter = LatencyJitter(mean_s=0.04)
    drawn = jitter.draw_s(default_rng(0), 3, rule_latency_s=0.0)

    assert drawn.tolist() == [0.04] * 3


def test_latency_of_a_sample_is_drawn_once_that_of_a_run_every_time():
    rng = default_rng(1)
    once = LatencyJitter(mean_s=0.01, sd_s=0.01, drawn_per="sample")
    every = replace(once, drawn_per="run")

    assert len(set(once.draw_s(rng, 8, rule_latency_s=0.0).tolist())) == 1
    assert len(set(every.draw_s(rng, 8, rule_latency_s=0.0).tolist())) == 8


def test_a_budget_stands_in_for_the_rules_latency():
    budget = load_latency_budget("cpm-100ms")
    jitter = LatencyJitter(budget=budget)
    drawn = jitter.draw_s(default_rng(2), 3000, rule_latency_s=0.06)
    total = drawn + 0.06

    assert total.min() >= budget.best_s - 1e-12
    assert total.max() <= budget.worst_s + 1e-12
    assert total.mean() == pytest.approx(budget.mean_s, abs=0.004)
    assert drawn.min() < 0.0  # quicker than the rule

    study = load_latency_budget("study")
    same = LatencyJitter(budget=study).draw_s(
        default_rng(2), 3, rule_latency_s=study.mean_s
    )

    assert same.tolist() == [0.0] * 3
