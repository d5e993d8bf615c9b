"""Retrofits against brute force: every way to keep, turn, take away and add, priced
anew.
"""

from dataclasses import replace
from itertools import chain, combinations, product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from problems import problems
from small_tables import avoiding_problem
from tiny_worlds import unit_at

from geometry.errors import InputError
from geometry.lidar import load_lidars
from placement.candidates import CandidateGrid
from placement.layout import Layout
from placement.optimiser import Limits, is_better, placement_value, run_margins_s
from placement.optimiser.presolve import presolve_freely
from placement.retrofit import (
    Labour,
    RetrofitPoses,
    best_joining,
    build_retrofit_poses,
    find_retrofit,
    load_labour,
)

RE_AIM_EUR = 2.0


def labour():
    """Labour of round prices."""
    return Labour(
        people=1.0,
        wage_eur_per_h=1.0,
        travel_h=1.0,
        lift_eur=0.0,
        re_aim_h=1.0,
        remove_h=0.5,
        source="a test",
    )


@st.composite
def retrofits(draw):
    """Small tables whose first poses hang, whose next ones are re-aims of those."""
    problem = draw(problems())
    seeds = st.integers(0, 2**32 - 1)
    seed = draw(seeds)
    rng = np.random.default_rng(seed)
    n_poses = problem.table.n_poses
    most_units = draw(st.integers(1, 3))
    n_units = min(most_units, n_poses)
    most_aims = draw(st.integers(0, 3))
    n_aims = min(most_aims, n_poses - n_units)
    unit_index = np.full(n_poses, -1)
    unit_index[:n_units] = np.arange(n_units)
    unit_index[n_units : n_units + n_aims] = rng.integers(n_units, size=n_aims)
    few = st.integers(1, 4)
    n_sites = draw(few)
    site_index = rng.integers(n_sites, size=n_poses)
    is_old = unit_index >= 0
    site_index[is_old] = site_index[unit_index[is_old]]
    at_site = np.bincount(site_index[:n_units], minlength=n_sites)
    drawn_capacity = rng.integers(1, 4, size=n_sites)
    capacity = np.maximum(drawn_capacity, at_site)
    site_pairs = combinations(range(n_sites), 2)
    pairs = [pair for pair in site_pairs if rng.random() < 0.2]
    rivals = [(a, b) for a, b in pairs if not (at_site[a] and at_site[b])]
    is_forced = np.arange(n_poses) < n_units
    whole_price = rng.integers(1, 4, n_poses)
    price = whole_price.astype(float)
    limits = Limits(
        site_index=site_index,
        site_capacity=capacity,
        unit_cost_eur=np.where(is_forced, 0.0, price),
        site_cost_eur=np.where(
            at_site > 0, 0.0, rng.integers(0, 3, n_sites).astype(float)
        ),
        is_forced=is_forced,
        is_forbidden=(rng.random(n_poses) < 0.15) & ~is_forced,
        rivals=np.array(rivals, dtype=np.int64).reshape(-1, 2),
    )
    candidates = tuple(_pose(str(index)) for index in range(n_poses))
    poses = RetrofitPoses(candidates=candidates, unit_index=unit_index)
    return replace(problem, limits=limits), poses


def _pose(name):
    """A camera 5 m high."""
    return unit_at(name, [0.0, 0.0, 5.0], pitch_deg=-20.0)


def additions_allowed(problem, poses, new):
    """Do the limits allow new poses beside the old ones?"""
    limits = problem.limits
    if limits.is_forbidden[list(new)].any():
        return False

    mounted = [*range(poses.n_units), *new]
    sites = limits.site_index[mounted]
    counts = np.bincount(sites, minlength=limits.n_sites)
    used = counts > 0
    is_within = (counts <= limits.site_capacity)[used]
    return bool(is_within.all()) and not any(
        used[one] and used[other] for one, other in limits.rivals
    )


def price_of(problem, poses, new):
    """Price of new poses and of the sites that they open. [EUR]"""
    limits = problem.limits
    opened = {int(limits.site_index[pose]) for pose in new} - set(
        limits.site_index[: poses.n_units].tolist()
    )
    return float(
        sum(limits.unit_cost_eur[pose] for pose in new)
        + sum(limits.site_cost_eur[site] for site in opened)
    )


def subsets(items):
    """All subsets."""
    return list(
        chain.from_iterable(combinations(items, n) for n in range(len(items) + 1))
    )


def best_of(problem, options):
    """Best value of sets with prices, the price in place of the cost."""
    values = [
        placement_value(problem, poses)._replace(cost_eur=price)
        for poses, price in options
    ]
    best = values[0]
    for value in values[1:]:
        if is_better(value, best):
            best = value

    return best


def check_change(problem, poses, change):
    """Whether a change says of itself what is true."""
    standing = set(range(poses.n_units))
    removed = set(change.removed)
    added = set(change.added)
    after = (standing - removed) | added
    expected = tuple(sorted(after))

    assert change.pose_index == expected

    ids = np.array(problem.table.axis.run_ids)
    margins_before_s = run_margins_s(problem, sorted(standing))
    was = margins_before_s > -np.inf
    margins_after_s = run_margins_s(problem, sorted(after))
    now = margins_after_s > -np.inf
    gained = set(ids[now & ~was])
    lost = set(ids[was & ~now])
    value = placement_value(problem, sorted(after))

    assert set(change.gained) == gained
    assert set(change.lost) == lost
    assert change.value[:4] == value[:4]
    assert change.is_proven


@given(retrofit=retrofits(), budget_eur=st.sampled_from([None, 0.0, 3.0, 6.0]))
def test_the_best_change_of_each_kind_is_that_of_brute_force(retrofit, budget_eur):
    problem, poses = retrofit
    standing = tuple(range(poses.n_units))

    found = find_retrofit(
        problem,
        poses,
        labour=labour(),
        budget_eur=budget_eur,
    )

    assert found.before == placement_value(problem, standing)

    for change in (*found.removals, *found.re_aims, found.addition, found.combination):
        if change is not None:
            check_change(problem, poses, change)

    # Removals: all of them, the one that loses least first.
    expected = [(unit,) for unit in standing]
    removals = sorted(change.removed for change in found.removals)

    assert removals == expected

    values = [change.value._replace(cost_eur=0.0) for change in found.removals]
    is_any_better = any(is_better(value, values[0]) for value in values)

    assert not is_any_better
    assert all(change.price_eur == labour().remove_eur for change in found.removals)

    # Re-aims: the best of every unit that has any, the best of all first.
    is_aim = poses.unit_index[poses.n_units :] >= 0
    n_aims = int(is_aim.sum())

    for change in found.re_aims:
        (unit,), (aim,) = change.removed, change.added

        assert poses.unit_index[aim] == unit
        assert change.price_eur == RE_AIM_EUR
        assert change.n_compared == n_aims

        options = [
            (tuple(sorted({*standing} - {unit} | {int(row)})), 0.0)
            for row in poses.aims_of(unit)
        ]
        best = best_of(problem, options)

        assert change.value[:4] == pytest.approx(best[:4], abs=1e-9)

    values = [change.value._replace(cost_eur=0.0) for change in found.re_aims]
    is_any_better = any(is_better(value, values[0]) for value in values)

    assert not is_any_better

    # An addition: one new unit, or none where none is better.
    new_rows = np.flatnonzero(poses.unit_index < 0)
    new = [int(row) for row in new_rows]
    if budget_eur is None:
        money = np.inf
    else:
        money = budget_eur

    additions = [
        ((*standing, *rows), price_of(problem, poses, rows))
        for rows in [(), *((row,) for row in new)]
        if additions_allowed(problem, poses, rows)
    ]
    best = best_of(
        problem, [option for option in additions if option[1] <= money + 1e-6]
    )
    value_found = value_of(found.addition, found.before)

    assert value_found == pytest.approx(best, abs=1e-8)

    # All together for the money.
    if budget_eur is None:
        assert found.combination is None
        return

    ways = [[unit, *poses.aims_of(unit).tolist()] for unit in standing]
    together = [
        ((*hanging, *rows), price)
        for hanging in product(*ways)
        for rows in subsets(new)
        if additions_allowed(problem, poses, rows)
        for turned in [sum(pose >= poses.n_units for pose in hanging)]
        for price in [RE_AIM_EUR * turned + price_of(problem, poses, rows)]
        if price <= money + 1e-6
    ]
    best = best_of(problem, together)
    value_together = value_of(found.combination, found.before)

    assert value_together == pytest.approx(best, abs=1e-8)


def value_of(change, before):
    """Value afterwards, with the price in place of the cost."""
    if change is None:
        return before._replace(cost_eur=0.0)
    return change.value._replace(cost_eur=change.price_eur)


def test_what_is_lost_gained_and_paid():
    # A sees runs 0 and 1, B run 1 alone; turned, B sees run 2; a new unit sees 2 and 3.
    problem = avoiding_problem(
        ["1100", "0100", "0010", "0011"], price_eur=[0.0, 0.0, 9.0, 5.0]
    )
    limits = replace(problem.limits, is_forced=[True, True, False, False])
    poses = RetrofitPoses(
        candidates=tuple(map(_pose, ["A", "B", "B/aim", "new"])),
        unit_index=np.array([0, 1, 1, -1]),
    )
    problem = replace(problem, limits=limits)

    found = find_retrofit(
        problem,
        poses,
        labour=labour(),
        budget_eur=6.0,
    )

    assert found.before.apr == 0.5
    assert found.before.apr_one_failed == 0.25
    assert [(change.removed, change.lost) for change in found.removals] == [
        ((1,), ()),
        ((0,), ("run0",)),
    ]

    (re_aim,) = found.re_aims

    assert re_aim.removed == (1,)
    assert re_aim.added == (2,)
    assert re_aim.price_eur == RE_AIM_EUR
    assert re_aim.gained == ("run2",)
    assert re_aim.lost == ()
    assert re_aim.value.apr == 0.75
    assert found.addition is not None
    assert found.addition.added == (3,)
    assert found.addition.price_eur == 5.0
    assert found.addition.gained == ("run2", "run3")
    assert found.addition.value.apr == 1.0
    assert found.combination is not None
    assert found.combination.added == (3,)  # 7 EUR for both would be too much

    poorer = find_retrofit(
        problem,
        poses,
        labour=labour(),
        budget_eur=4.0,
    )

    assert poorer.addition is None


def _layout(*units):
    """A layout of units."""
    return Layout(name="mine", units=units)


@pytest.fixture
def grid(camera):
    """Four directions at two pitches."""
    return CandidateGrid(
        heights_m=[5.0],
        yaw_step_deg=90.0,
        pitches_deg=[-15.0, -30.0],
        sensors=(camera,),
    )


def test_re_aims_keep_place_and_sensor_and_leave_out_where_a_unit_looks_now(
    grid, camera
):
    position = np.array([1.0, 2.0, 7.3])
    unit = unit_at(
        "A",
        position,
        yaw_deg=-180.0,
        pitch_deg=-15.0,
        site_id="corner",
        sensor=camera,
        latency_s=0.2,
    )
    new = replace(unit, id="new")

    poses = build_retrofit_poses(
        _layout(unit, replace(unit, id="B")), grid, [new, unit]
    )
    first_ids = [pose.id for pose in poses.candidates[:2]]

    assert poses.n_units == 2
    assert first_ids == ["A", "B"]
    assert poses.candidates[-1] is new  # the unit itself is not offered once more

    aim_rows = poses.aims_of(0)
    aims = [poses.candidates[row] for row in aim_rows]

    assert len(aims) == 4 * 2 - 1

    expected = set(product([-90.0, 0.0, 90.0, 180.0], [-15.0, -30.0])) - {
        (180.0, -15.0)
    }
    angles_deg = {(aim.pose.yaw_deg, aim.pose.pitch_deg) for aim in aims}

    assert angles_deg == expected

    for aim in aims:
        aim_m = aim.pose.position_m.tolist()
        expected_m = position.tolist()

        assert aim_m == expected_m
        assert aim.sensor == camera
        assert aim.site_id == "corner"
        assert aim.latency_s == 0.2


def test_a_level_ring_is_not_turned(grid):
    """All round: a turn would change nothing, and the grid's tilts are for cameras."""
    ring = replace(_pose("A"), sensor=load_lidars()["ouster-os1-128"])
    pose = replace(ring.pose, yaw_deg=77.0, pitch_deg=0.0)
    level = replace(ring, pose=pose)
    level_poses = build_retrofit_poses(_layout(level), grid, [])
    level_aims = level_poses.aims_of(0)

    assert len(level_aims) == 0

    tilted_pose = replace(ring.pose, yaw_deg=77.0, pitch_deg=-9.0)
    tilted = replace(ring, pose=tilted_pose)

    poses = build_retrofit_poses(_layout(tilted), grid, [])
    aim_rows = poses.aims_of(0)
    aim_ids = [poses.candidates[row].id for row in aim_rows]

    assert aim_ids == ["A/aim/0/0"]


def test_ids_that_clash_are_refused(grid, camera):
    unit = replace(_pose("A"), sensor=camera)
    twin = replace(unit, id="A/aim/0/-30")

    with pytest.raises(
        InputError, match="layout mine: id: got 'A/aim/0/-30'; expected ids"
    ):
        build_retrofit_poses(_layout(unit), grid, [twin])


@given(problem=problems(), n_kept=st.integers(0, 3))
def test_a_pose_that_joins_is_as_good_as_the_set_it_makes(problem, n_kept):
    poses = range(problem.table.n_poses)
    kept = list(poses)[:n_kept]
    every_pose = np.array(poses)
    each = every_pose[n_kept:]
    if not len(each):
        return

    pose_list = each.tolist()
    values = {pose: placement_value(problem, [*kept, pose]) for pose in pose_list}
    joining = best_joining(presolve_freely(problem), kept, each)
    best = values[joining]
    # Nothing tells them apart.
    if not any(value.apr > 0.0 for value in values.values()):
        return

    is_any_better = any(is_better(value, best) for value in values.values())

    assert not is_any_better


def test_equal_poses_are_told_apart_by_price():
    detected = ["1100", "0011", "0010", "0011", "0001"]
    each = np.array([1, 2, 3, 4])
    free = presolve_freely(avoiding_problem(detected))
    joining = best_joining(free, [0], each)

    assert joining == 1

    price_eur = [1.0, 3.0, 1.0, 2.0, 1.0]
    priced = avoiding_problem(detected, price_eur=price_eur)
    cheapest_joining = best_joining(presolve_freely(priced), [0], each)

    assert cheapest_joining == 3


def test_a_visit_is_people_on_the_way_and_at_the_pole_and_a_lift():
    labour = Labour(
        people=2.0,
        wage_eur_per_h=50.0,
        travel_h=1.0,
        lift_eur=100.0,
        re_aim_h=2.0,
        remove_h=0.5,
        source="a test",
    )
    assert labour.re_aim_eur == 2.0 * 50.0 * 3.0 + 100.0
    assert labour.remove_eur == 2.0 * 50.0 * 1.5 + 100.0


def test_prices_of_ours_are_called_an_assumption():
    assert "assumption" in load_labour().source
