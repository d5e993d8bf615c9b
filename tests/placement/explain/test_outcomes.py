from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import problems

from geometry.catalogue import load_cameras
from geometry.poses import Pose
from placement.candidates import CandidatePose
from placement.explain.sensitivity import (
    Watched,
    find_expected_outcome,
    find_outcome,
    runs_lost,
)
from placement.optimiser import placement_value

CAMERA = load_cameras()["carla-ncap-rgb"]
POSE = Pose(position_m=np.array([0.0, 0.0, 5.0]), yaw_deg=0.0)


def unit(name, latency_s=None):
    return CandidatePose(id=name, site_id="", pose=POSE, sensor=CAMERA, latency_s=latency_s)


def watched_of(problem, chosen, fusion):
    return Watched(
        units=tuple(unit(f"{pose}") for pose in chosen),
        detected=problem.table.detected(list(chosen)),
        axis=problem.table.axis,
        rule=problem.rule,
        fusion=fusion,
    )


@settings(max_examples=60)
@given(problem=problems(), fusion=st.sampled_from(["any", "single"]), seed=st.integers(0, 99))
def test_the_outcome_is_what_the_optimiser_says(problem, fusion, seed):
    rng = np.random.default_rng(seed)
    n_poses = problem.table.n_poses
    chosen = sorted(rng.choice(n_poses, size=rng.integers(1, n_poses + 1), replace=False).tolist())
    problem = replace(problem, fusion=fusion, sample_index=None, tail=1.0)
    value = placement_value(problem, chosen)
    outcome = find_outcome(watched_of(problem, chosen, fusion))
    assert outcome.apr == pytest.approx(value.apr)
    assert outcome.apr_one_failed == pytest.approx(value.apr_one_failed)
    if outcome.smallest_margin_s is None:
        assert value.apr == 0.0
    else:
        assert outcome.smallest_margin_s == pytest.approx(value.smallest_margin_s)


def expected_by_hand(watched, packet_loss):
    """Every way in which messages of detected frames may arrive, each by its probability."""
    unit_index, frame_index = np.nonzero(watched.detected)
    total = np.zeros(watched.axis.n_runs)
    for arrives in product([False, True], repeat=len(unit_index)):
        detected = np.zeros_like(watched.detected)
        detected[unit_index, frame_index] = arrives
        n_arrived = sum(arrives)
        probability = (1.0 - packet_loss) ** n_arrived * packet_loss ** (len(arrives) - n_arrived)
        avoided = find_outcome(replace(watched, detected=detected)).avoided_share
        total += probability * avoided
    return total


@pytest.fixture
def few_frames(frame_axis, rule):
    """Two units with latencies of their own and without, eight detections."""
    detected = np.array(
        [
            [1, 1, 0, 1, 1, 0, 0, 0, 1, 0],
            [0, 1, 0, 0, 1, 1, 0, 0, 0, 0],
        ],
        dtype=bool,
    )
    return Watched(
        units=(unit("a"), unit("b", latency_s=0.0)),
        detected=detected,
        axis=replace(frame_axis, last_brake_time_s=np.array([-0.05, -0.15, -0.1])),
        rule=replace(rule, n_confirmations=2, latency_s=0.05),
        fusion="any",
    )


@pytest.mark.parametrize("fusion", ["any", "single"])
@pytest.mark.parametrize("packet_loss", [0.0, 0.3, 1.0])
def test_expected_shares_are_those_of_all_ways_to_lose_messages(few_frames, fusion, packet_loss):
    watched = replace(few_frames, fusion=fusion)
    outcome = find_expected_outcome(watched, packet_loss=packet_loss)
    by_hand = expected_by_hand(watched, packet_loss)
    assert outcome.avoided_share == pytest.approx(by_hand)
    assert outcome.apr == pytest.approx(by_hand @ watched.axis.weight)
    alone = [
        expected_by_hand(
            replace(watched, units=(watched.units[kept],), detected=watched.detected[[kept]]),
            packet_loss,
        )
        for kept in (0, 1)
    ]
    left = min(share @ watched.axis.weight for share in alone)
    assert outcome.apr_one_failed == pytest.approx(left)
    assert outcome.smallest_margin_s is None


def test_a_unit_keeps_its_own_latency(few_frames):
    late = replace(few_frames, rule=replace(few_frames.rule, latency_s=9.0))
    alone = replace(late, units=late.units[1:], detected=late.detected[1:])
    assert find_outcome(few_frames).apr == pytest.approx(0.75)
    assert find_outcome(late).apr == find_outcome(alone).apr == pytest.approx(0.25)


def test_a_single_unit_leaves_nothing_and_lost_runs_are_named(few_frames):
    alone = replace(few_frames, units=few_frames.units[:1], detected=few_frames.detected[:1])
    assert find_outcome(alone).apr_one_failed == 0.0
    assert find_expected_outcome(alone, packet_loss=0.5).apr_one_failed == 0.0
    planned = find_outcome(few_frames)
    assert runs_lost(planned, planned) == []
    sure = np.flatnonzero(planned.avoided_share == 1.0).tolist()
    assert runs_lost(planned, find_expected_outcome(few_frames, packet_loss=0.5)) == sure
