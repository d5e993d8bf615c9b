"""Road users who move otherwise than their cases say."""

import re
from dataclasses import replace

import numpy as np
import pytest
from met_cases import MET_CASES
from numpy.testing import assert_allclose, assert_array_equal
from placed_bodies import parked_at

from geometry.actors import pick_actor
from geometry.errors import InputError
from geometry.study_scene import load_study_scene
from placement.sampling.uncertainty import (
    MeasuredPeople,
    RoadUsers,
    Uncertainty,
    load_uncertainty,
)
from placement.sampling.worlds import (
    RandomStreams,
    change_motion,
    draw_road_users,
    draw_samples,
)
from scenarios.aeb import last_brake_time_s
from scenarios.cases import load_cases, select_cases
from scenarios.encounters import first_contact_s
from scenarios.obstructions import is_way_free
from scenarios.runs import build_runs, frames_at

MPS_PER_KMH = 1.0 / 3.6
CASES = {
    "CPNA-25": 40.0,
    "CBNA-50": 30.0,
    "CPTAfs-50": 15.0,
    "CBLA-50": 45.0,
}
ROBUSTNESS = load_uncertainty("robustness").road_users
STRAIGHT = replace(ROBUSTNESS, heading_deg={}, path_m={})  # on the planned way
SCENE = load_study_scene()


def _changed(run, **changes):
    """The run with another encounter, frame by frame; None where there is none."""
    encounter = change_motion(run, **changes)
    if encounter is None:
        return None
    return replace(run, encounter=encounter, **frames_at(encounter, run.time_s))


def _lay(rule, *cases):
    """Runs of cases from the east."""
    runs, _ = build_runs(
        SCENE,
        cases,
        vut=pick_actor("vut", "test"),
        rule=rule,
        approaches=["east"],
    )
    return runs


@pytest.fixture(scope="module")
def laid(rule):
    """Runs of four kinds of cases, and those of a car and a motorcyclist."""
    known = load_cases()
    named = [
        replace(known[name], vut_speeds_kmh=(speed_kmh,))
        for name, speed_kmh in CASES.items()
    ]
    return _lay(rule, *named, *select_cases(str(MET_CASES)).cases)


def _run_of(laid, case):
    """The run of a case."""
    return next(run for run in laid if run.case.name == case)


def _drawn(rule, runs, users, index=0):
    """The runs with road users that are drawn anew."""
    drawn, _ = draw_road_users(
        runs,
        users,
        rule,
        _streams(index).rng,
        SCENE,
    )
    return drawn


def _end_of(motion):
    """Way until the impact, and the yaw there. [m, deg]"""
    whole_m = float(motion.distance_m(0.0))
    return whole_m, float(motion.path.at(whole_m)[1])


def _streams(index=0, seed=3):
    """Streams of a world."""
    return RandomStreams(seed=seed, purpose="choose", index=index)


@pytest.mark.parametrize("faster_kmh", [-1.5, 2.0])
def test_a_changed_run_is_the_run_laid_with_that_speed(laid, rule, faster_kmh):
    n_compared = 0
    for run in laid:
        case = replace(run.case, vru_speed_kmh=run.case.vru_speed_kmh + faster_kmh)
        again = _lay(rule, case)
        if not again:  # the VUT would come from beyond the mapped lane
            continue
        (anew,) = again
        speed_mps = case.vru_speed_kmh * MPS_PER_KMH

        changed = _changed(run, speed_mps=speed_mps)

        n = min(len(anew.time_s), len(changed.time_s))
        time_s = changed.time_s[-n:]

        assert_allclose(anew.time_s[-n:], time_s, atol=1e-9)

        for body in ("vut", "vru"):
            # The planned VUT sets off no earlier, and before that it stands.
            sets_off_s = max(
                getattr(one.encounter, f"{body}_motion").start_time_s
                for one in (anew, changed)
            )
            moves = time_s >= sets_off_s

            assert moves.sum() > 20

            for name in (f"{body}_position_m", f"{body}_yaw_deg"):
                found = getattr(changed, name)[-n:][moves]
                expected = getattr(anew, name)[-n:][moves]
                assert_allclose(
                    found,
                    expected,
                    atol=2e-5,
                    err_msg=run.id,
                )

        last_s = last_brake_time_s(changed.encounter, rule)

        assert_array_equal(changed.vru_shape[-n:], anew.vru_shape[-n:])
        assert last_s == pytest.approx(anew.last_brake_time_s, abs=1e-5)

        n_compared += 1

    assert n_compared >= 5


def test_a_nearer_start_is_nearer_by_its_share(laid):
    for run in laid:
        planned = run.encounter.vru_motion

        nearer = _changed(
            run,
            speed_mps=planned.speed_mps,
            nearer_share=0.25,
        )

        whole_m = float(planned.distance_m(0.0))
        left_m = float(nearer.encounter.vru_motion.distance_m(0.0))
        start_m, _ = planned.path.at(0.25 * whole_m)

        assert left_m == pytest.approx(0.75 * whole_m, abs=1e-6)
        assert_allclose(nearer.vru_position_m[-1], run.vru_position_m[-1], atol=1e-6)
        assert_allclose(nearer.vru_position_m[0], start_m, atol=1e-6)


@pytest.mark.parametrize(
    ("turn_deg", "aside_m"),
    [
        (20.0, 0.0),
        (-10.0, 0.0),
        (15.0, 0.5),
        (0.0, -0.5),
    ],
)
def test_a_way_is_turned_about_the_impact_and_lies_aside(laid, turn_deg, aside_m):
    n_met = 0
    for run in laid:
        motion = run.encounter.vru_motion
        other = _changed(
            run,
            speed_mps=motion.speed_mps,
            turn_deg=turn_deg,
            aside_m=aside_m,
        )
        if other is None:  # who is followed and turns leaves the VUT's way
            continue
        n_met += 1

        assert first_contact_s(other.encounter) == pytest.approx(0.0, abs=1e-6)

        path = other.encounter.vru_motion.path
        distances_m = np.linspace(0.0, 20.0, 30)
        whole_m = float(motion.distance_m(0.0))
        there_m, yaw_deg = motion.path.at(whole_m)
        # As far from the impact as before, and by so much to the left of the turned
        # heading.
        angle = np.radians(yaw_deg + turn_deg)
        shifted_m = there_m + aside_m * np.array([-np.sin(angle), np.cos(angle)])
        planned, planned_yaw = motion.path.at(distances_m)
        positions, yaws = path.at(distances_m)
        expected = np.hypot(*(planned - there_m).T)

        assert_allclose(
            np.hypot(*(positions - shifted_m).T),
            expected,
            atol=1e-6,
        )
        assert_allclose(path.at(whole_m)[0], shifted_m, atol=1e-9)
        assert_allclose(yaws - planned_yaw, turn_deg, atol=1e-9)

    assert n_met >= 4


@pytest.mark.long
def test_headings_are_drawn_for_the_cases_named_alone_and_nobody_walks_through_a_car(
    laid, rule
):
    turned = {run.case.family: [] for run in laid}
    for index in range(25):
        drawn = _drawn(rule, laid, ROBUSTNESS, index)
        for run, other in zip(laid, drawn, strict=True):
            motion = other.encounter.vru_motion
            _, planned_deg = _end_of(run.encounter.vru_motion)
            _, yaw_deg = _end_of(motion)
            turned[run.case.family].append(yaw_deg - planned_deg)

            assert is_way_free(other.encounter.vru, motion, SCENE, run.obstruction)

    for family, angles in turned.items():
        low, high = ROBUSTNESS.heading_deg.get(family, (0.0, 0.0))
        # Towed bodies turn by themselves.
        assert low - 1.0 <= min(angles) <= max(angles) <= high + 1.0
        if high > low:
            assert max(angles) - min(angles) > 0.7 * (high - low)


def test_a_way_through_a_parked_car_is_not_free(laid):
    run = _run_of(laid, "CPNA-25")
    motion = run.encounter.vru_motion
    (east_m, north_m), _ = motion.path.at(0.5 * float(motion.distance_m(0.0)))
    on_the_way = parked_at("parked-car-small", east_m, north_m)
    aside = parked_at("parked-car-small", east_m + 30.0, north_m)

    assert is_way_free(run.encounter.vru, motion, SCENE, [])
    assert not is_way_free(run.encounter.vru, motion, SCENE, [on_the_way])
    assert is_way_free(run.encounter.vru, motion, SCENE, [aside])


def test_whom_the_vut_does_not_reach_moves_as_planned(laid, rule):
    run = _run_of(laid, "CBLA-50")
    planned_mps = run.encounter.vru_motion.speed_mps
    vut_mps = run.vut_speed_kmh * MPS_PER_KMH
    away = RoadUsers(cyclist_kmh=(0.0, 50.0))

    speeds_mps = []
    for index in range(15):
        (drawn,) = _drawn(rule, [run], away, index)
        speeds_mps.append(drawn.encounter.vru_motion.speed_mps)

    assert max(speeds_mps) < vut_mps
    assert 0 < speeds_mps.count(planned_mps) < 15
    assert _changed(run, speed_mps=vut_mps) is None
    assert _changed(run, speed_mps=0.0) is None


@pytest.mark.long
def test_speeds_and_starts_are_drawn_evenly_within_their_limits(laid, rule):
    by_class = {run.encounter.vru.class_name: run for run in laid}
    assert set(by_class) == {"pedestrian", "cyclist", "motorcyclist", "car"}

    for name, run in by_class.items():
        low, high = ROBUSTNESS.speed_kmh(name)
        planned = run.encounter.vru_motion
        whole_m, _ = _end_of(planned)
        faster_kmh = []
        nearer = []
        for index in range(60):
            (other,) = _drawn(rule, [run], STRAIGHT, index)
            motion = other.encounter.vru_motion
            left_m, _ = _end_of(motion)
            faster_kmh.append((motion.speed_mps - planned.speed_mps) / MPS_PER_KMH)
            nearer.append(1.0 - left_m / whole_m)

        # Mean and deviation of a uniform distribution, to four standard errors.
        for values, least, most in (
            (faster_kmh, low, high),
            (nearer, 0.0, 0.25),
        ):
            spread = (most - least) / np.sqrt(12.0)
            middle = pytest.approx(0.5 * (least + most), abs=4 * spread / 60**0.5)

            assert least - 1e-6 <= min(values) <= max(values) <= most + 1e-6
            assert np.mean(values) == middle
            assert np.std(values) == pytest.approx(spread, rel=0.2)


@pytest.mark.long
def test_the_same_seed_draws_the_same_and_a_run_not_by_the_others(laid, rule):
    def speeds(runs, streams):
        drawn, _ = draw_road_users(
            runs,
            ROBUSTNESS,
            rule,
            streams.rng,
            SCENE,
        )
        return [run.encounter.vru_motion.speed_mps for run in drawn]

    first = speeds(laid, _streams())

    assert speeds(laid, _streams()) == first
    assert speeds(laid[::-1], _streams())[::-1] == first
    assert speeds(laid[2:3], _streams()) == first[2:3]

    for other in (
        speeds(laid, _streams(index=1)),
        speeds(laid, _streams(seed=4)),
    ):
        for one, another in zip(first, other, strict=True):
            assert one != another


def test_a_run_is_the_same_in_all_weathers(laid, rule):
    rainy = [replace(run, id=f"{run.id}/rain", weather="rain") for run in laid]
    drawn = _drawn(rule, [*laid, *rainy], ROBUSTNESS)

    for dry, wet in zip(drawn[: len(laid)], drawn[len(laid) :], strict=True):
        assert dry.encounter is wet.encounter
        assert dry.vru_position_m is wet.vru_position_m
        assert dry.weather == "day"
        assert wet.weather == "rain"


# Worlds


def test_worlds_differ_in_what_people_do_and_in_nothing_else(setting, candidates):
    uncertain = Uncertainty(road_users=ROBUSTNESS)

    worlds = list(draw_samples(setting, candidates, uncertain, n_samples=2, seed=0))

    for sample in worlds:
        assert not sample.looks_as_planned
        assert sample.candidates is sample.planned
        assert sample.setting.axis.run_ids == setting.axis.run_ids
        assert np.array_equal(sample.setting.axis.time_s, setting.axis.time_s)

        for run, last_s in zip(
            sample.setting.runs, sample.setting.axis.last_brake_time_s, strict=True
        ):
            assert run.last_brake_time_s == last_s

    one, other = (sample.setting.runs for sample in worlds)

    for a, b in zip(one, other, strict=True):
        assert not np.allclose(a.vru_position_m, b.vru_position_m)


# Files


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "pedestrian_kmh = [1.0, 3.0]",
            "pedestrian_kmh: got [1.0, 3.0]; expected [low, high] in km",
        ),
        (
            "heading_deg = {CPNA = [5, 10]}",
            "heading_deg.CPNA: got [5.0, 10.0]; expected [low, high] in",
        ),
        (
            "heading_deg = {CPXY = [0, 10]}",
            "heading_deg: got 'CPXY'; expected one of CBFA, ",
        ),
        ("path_m = 3", "path_m: got 3; expected a section"),
        ("start_nearer_share = 1.5", "start_nearer_share: got 1.5; expected 0 to 0.9"),
    ],
)
def test_limits_that_cannot_be_are_refused(tmp_path, text, message):
    fields = {
        "pedestrian_kmh": "[-2.0, 3.0]",
        "cyclist_kmh": "[0, 0]",
        "motorcyclist_kmh": "[0, 0]",
        "car_kmh": "[0, 0]",
        "start_nearer_share": "0.25",
    }
    key, _, value = text.partition(" = ")
    lines = "\n".join(
        f"{name} = {number}" for name, number in {**fields, key: value}.items()
    )
    path = tmp_path / "mine.toml"
    path.write_text(f"[road_users]\n{lines}\n")

    with pytest.raises(InputError, match=re.escape(message)):
        load_uncertainty(str(path))


def test_a_file_may_take_the_rest_from_a_name(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('as = "robustness"\n[messages]\npacket_loss = 0.2\n')
    mine = load_uncertainty(str(path))

    assert mine.road_users == ROBUSTNESS
    assert mine.packet_loss == 0.2
    assert mine.name == "mine.toml"
    assert mine.mounting == load_uncertainty("default").mounting

    path.write_text('as = "best"\n')

    with pytest.raises(
        InputError, match="as: got 'best'; expected one of as-measured, default, "
    ):
        load_uncertainty(str(path))


# ---------- people as they were measured
MEASURED = load_uncertainty("as-measured").road_users


def test_measured_speeds_are_drawn_as_often_as_measured():
    people = MeasuredPeople(
        probability=(0.1, 0.5, 0.9),
        speed_kmh=(4.0, 5.0, 8.0),
        start_mps2=(0.5, 1.0, 1.5),
    )
    rng = np.random.default_rng(4)
    drawn = np.array([people.draw(rng, 5.0) for _ in range(4000)])
    shares = [0.2, 0.5, 0.7]

    for column, values in zip(
        drawn.T, (people.speed_kmh, people.start_mps2), strict=True
    ):
        expected = np.interp(shares, people.probability, values)
        assert_allclose(np.quantile(column, shares), expected, atol=0.1)

    assert abs(np.corrcoef(drawn.T)[0, 1]) < 0.05
    assert {people.draw(rng, 8.5)[0] for _ in range(20)} == {8.5}


def test_each_run_has_people_of_its_own(laid, rule):
    drawn = _drawn(rule, laid, MEASURED)
    speeds_kmh = []
    for run, planned in zip(drawn, laid, strict=True):
        before = planned.encounter.vru_motion
        motion = run.encounter.vru_motion
        measured = MEASURED.measured.get(run.encounter.vru.class_name)
        if measured is None or motion is before:
            assert motion.speed_mps == before.speed_mps
            continue

        speeds_kmh.append(motion.speed_mps / MPS_PER_KMH)

        assert measured.speed_kmh[0] <= speeds_kmh[-1] <= measured.speed_kmh[-1]
        assert abs(first_contact_s(run.encounter)) < 1e-6

        if before.acceleration_distance_m > 0.0:
            start = 0.5 * motion.speed_mps**2 / motion.acceleration_distance_m
            assert measured.start_mps2[0] <= start <= measured.start_mps2[-1]

    assert len(speeds_kmh) >= 3
    assert len(set(speeds_kmh)) == len(speeds_kmh)

    again = _drawn(rule, laid, MEASURED, 1)

    assert [run.encounter.vru_motion.speed_mps for run in again] != [
        run.encounter.vru_motion.speed_mps for run in drawn
    ]


def test_who_starts_faster_is_at_the_impact_in_the_same_moment(laid):
    run = next(run for run in laid if run.encounter.vru_motion.acceleration_distance_m)
    speed_mps = run.encounter.vru_motion.speed_mps

    quick = _changed(
        run,
        speed_mps=speed_mps,
        start_mps2=2.0,
    ).encounter.vru_motion

    assert quick.acceleration_distance_m == pytest.approx(speed_mps**2 / 4.0)
    assert quick.acceleration_mps2 == pytest.approx(2.0)

    expected = float(run.encounter.vru_motion.distance_m(0.0))

    assert quick.distance_m(0.0) == pytest.approx(expected, abs=1e-6)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "speed_kmh = [5, 4], start_mps2 = [1, 2]",
            "speed_kmh: got [5.0, 4.0]; expected at least",
        ),
        (
            "speed_kmh = [5], start_mps2 = [1, 2]",
            "people.pedestrian.speed_kmh: got [5.0]",
        ),
        (
            "pace = [5, 6]",
            "people.pedestrian: got 'pace'; expected one of speed_kmh, start_mps2",
        ),
    ],
)
def test_people_that_cannot_be_are_told_in_one_line(tmp_path, text, message):
    path = tmp_path / "own.toml"
    path.write_text(f"[people]\nprobability = [0.1, 0.9]\npedestrian = {{ {text} }}\n")

    with pytest.raises(InputError) as caught:
        load_uncertainty(str(path))

    refusal = str(caught.value)

    assert message in refusal
    assert "\n" not in refusal
