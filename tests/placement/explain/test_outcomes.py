import math
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given
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
from scenarios.aeb import load_aeb_rule
from scenarios.runs import FrameAxis

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
        seen_by_vut=problem.seen_by_vut,
    )


@given(problem=problems(), fusion=st.sampled_from(["any", "single"]), seed=st.integers(0, 99))
def test_the_outcome_is_what_the_optimiser_says(problem, fusion, seed):
    rng = np.random.default_rng(seed)
    n_poses = problem.table.n_poses
    chosen = sorted(rng.choice(n_poses, size=rng.integers(1, n_poses + 1), replace=False).tolist())
    problem = replace(problem, fusion=fusion, sample_index=None, tail=1.0)
    value = placement_value(problem, chosen)
    outcome = find_outcome(watched_of(problem, chosen, fusion))
    assert outcome.worth.apr == pytest.approx(value.apr)
    assert outcome.worth.apr_one_failed == pytest.approx(value.apr_one_failed)
    if outcome.worth.smallest_margin_s is None:
        assert value.apr == 0.0
    else:
        assert outcome.worth.smallest_margin_s == pytest.approx(value.smallest_margin_s)


@given(problem=problems(), share=st.sampled_from([0.0, 0.3, 1.0]))
def test_a_share_of_cars_that_see_is_the_weighted_sum(problem, share):
    everyone = list(range(problem.table.n_poses))
    seen = np.arange(problem.table.axis.n_frames) % 4 > 0
    watched = replace(watched_of(problem, everyone, problem.fusion), seen_by_vut=seen)
    seeing, blind = find_outcome(watched), find_outcome(replace(watched, seen_by_vut=None))
    mixed = find_outcome(replace(watched, cars=share))
    for name in ("apr", "apr_one_failed"):
        expected = share * getattr(seeing.worth, name) + (1 - share) * getattr(blind.worth, name)
        assert getattr(mixed.worth, name) == pytest.approx(expected)
    expected = share * seeing.avoided_share + (1.0 - share) * blind.avoided_share
    assert mixed.avoided_share == pytest.approx(expected)


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


@pytest.mark.parametrize("memory_s", [0.1, 0.2, math.inf])
@pytest.mark.parametrize("fusion", ["any", "single"])
@pytest.mark.parametrize("packet_loss", [0.0, 0.3, 1.0])
@pytest.mark.parametrize("cars", [0.0, 0.3, 1.0])
def test_expected_shares_are_those_of_all_ways_to_lose_messages(
    few_frames, fusion, packet_loss, memory_s, cars
):
    rule = replace(few_frames.rule, track_memory_s=memory_s)
    watched = replace(few_frames, fusion=fusion, rule=rule)
    if cars:
        seen = np.array([0, 0, 1, 0, 0, 0, 1, 1, 0, 1], dtype=bool)
        watched = replace(watched, seen_by_vut=seen, cars=cars)
    outcome = find_expected_outcome(watched, packet_loss=packet_loss)
    by_hand = expected_by_hand(watched, packet_loss)
    assert outcome.avoided_share == pytest.approx(by_hand)
    assert outcome.worth.apr == pytest.approx(by_hand @ watched.axis.weight)
    alone = [
        expected_by_hand(
            replace(watched, units=(watched.units[kept],), detected=watched.detected[[kept]]),
            packet_loss,
        )
        for kept in (0, 1)
    ]
    left = min(share @ watched.axis.weight for share in alone)
    assert outcome.worth.apr_one_failed == pytest.approx(left)
    assert outcome.worth.smallest_margin_s is None


@given(
    seed=st.integers(0, 2**32 - 1),
    n_confirmations=st.integers(1, 3),
    memory_s=st.sampled_from([0.1, 0.2, 0.3, 0.5]),
    packet_loss=st.sampled_from([0.0, 0.2, 0.7]),
    latency_s=st.sampled_from([None, 0.0, 0.15]),
)
def test_expected_shares_of_tracks_that_are_lost_are_those_of_all_ways(
    seed, n_confirmations, memory_s, packet_loss, latency_s
):
    """Two runs of up to twelve frames, six detections of two units."""
    rng = np.random.default_rng(seed)
    lengths = rng.integers(4, 13, size=2)
    axis = FrameAxis(
        run_ids=("a", "b"),
        cases=("A",) * 2,
        approaches=("north",) * 2,
        weathers=("day",) * 2,
        vut_speed_kmh=np.full(2, 30.0),
        weight=np.array([0.75, 0.25]),
        last_brake_time_s=-rng.uniform(0.0, 0.9, size=2),
        run_start=np.cumsum([0, *lengths]),
        time_s=np.concatenate([np.arange(1 - n, 1) / 10.0 for n in lengths]),
    )
    detected = np.zeros((2, axis.n_frames), dtype=bool)
    detected.ravel()[rng.permutation(detected.size)[:6]] = True
    watched = Watched(
        units=(unit("a"), unit("b", latency_s=latency_s)),
        detected=detected,
        axis=axis,
        rule=replace(
            load_aeb_rule(),
            n_confirmations=n_confirmations,
            latency_s=0.05,
            track_memory_s=memory_s,
        ),
    )
    outcome = find_expected_outcome(watched, packet_loss=packet_loss)
    assert outcome.avoided_share == pytest.approx(expected_by_hand(watched, packet_loss))


def test_a_unit_keeps_its_own_latency(few_frames):
    late = replace(few_frames, rule=replace(few_frames.rule, latency_s=9.0))
    alone = replace(late, units=late.units[1:], detected=late.detected[1:])
    assert find_outcome(few_frames).worth.apr == pytest.approx(0.75)
    assert find_outcome(late).worth.apr == find_outcome(alone).worth.apr == pytest.approx(0.25)


def test_a_single_unit_leaves_nothing_and_lost_runs_are_named(few_frames):
    alone = replace(few_frames, units=few_frames.units[:1], detected=few_frames.detected[:1])
    assert find_outcome(alone).worth.apr_one_failed == 0.0
    assert find_expected_outcome(alone, packet_loss=0.5).worth.apr_one_failed == 0.0
    planned = find_outcome(few_frames)
    assert runs_lost(planned, planned) == []
    sure = np.flatnonzero(planned.avoided_share == 1.0).tolist()
    assert runs_lost(planned, find_expected_outcome(few_frames, packet_loss=0.5)) == sure
