"""Advice against brute force on a table that is made up: every pose tried, every set
priced.
"""

from dataclasses import replace
from itertools import combinations

import pytest
from changes import changed
from small_results import build_small_grid, build_small_setting
from tiny_worlds import unit_at

from geometry.catalogue import load_cameras
from geometry.errors import InputError
from placement import candidates as poses
from placement.candidates import CandidatePose
from placement.compute import Compute
from placement.layout import Certificate, Stage, find_layout
from placement.live import LiveTable, table_verdict
from placement.pipeline import assemble
from placement.question import Question
from placement.retrofit import Adviser, free_name


@pytest.fixture(scope="module")
def setting():
    """A few runs."""
    return build_small_setting()


@pytest.fixture(scope="module")
def adviser(setting, tmp_path_factory):
    """Advises on the small question."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(poses, "load_candidate_grid", build_small_grid)
        assembly = assemble(
            Question(),
            setting=setting,
            counts_money=True,
            compute=Compute(cache_folder=tmp_path_factory.mktemp("tables")),
        )

    return Adviser(assembly, build_small_grid())


@pytest.fixture(scope="module")
def weak(setting):
    """Two cameras that look away from the junction."""
    camera = load_cameras()["carla-ncap-rgb"]

    def unit(name, site, yaw_deg):
        return unit_at(
            name,
            site.position_m + [0.0, 0.0, 5.3],
            yaw_deg=yaw_deg,
            pitch_deg=-18,
            site_id=site.id,
            sensor=camera,
        )

    return (
        unit("U1", setting.scene.sites[0], 20.0),
        unit("mine", setting.scene.sites[2], 235.0),
    )


@pytest.fixture(scope="module")
def apr_of(setting):
    """Finds the APR of units."""
    live = LiveTable(setting)

    def apr(units):
        verdict = table_verdict(units, live.detected(units), setting)
        return float(verdict.is_avoided @ setting.axis.weight)

    return apr


@pytest.mark.long
def test_the_best_next_unit_is_the_best_of_all_that_can_be_added(
    adviser, weak, apr_of, setting
):
    found = adviser.best_next(weak)

    assert [unit.id for unit in found.units[:2]] == ["U1", "mine"]
    assert found.units[2].id == "U2"
    assert found.is_proven

    candidates = adviser._assembly.candidates
    capacity = {site.id: site.capacity_units for site in setting.scene.sites}
    taken = [unit.site_id for unit in weak]
    free = [
        one
        for one in candidates
        if taken.count(one.site_id) < capacity.get(one.site_id, 1)
    ]

    expected = max(apr_of([*weak, one]) for one in free)

    assert found.after.apr == pytest.approx(expected)
    assert found.before.apr == pytest.approx(apr_of(weak))
    assert found.bound == found.after.apr


def test_to_complete_keeps_what_hangs_and_reaches_its_bound(adviser, weak, apr_of):
    found = adviser.complete(weak, n_units=3)
    expected = apr_of(found.units)

    assert {unit.id for unit in weak} <= {unit.id for unit in found.units}
    assert len(found.units) == 3
    assert found.after.apr == pytest.approx(expected)
    assert found.after.apr == pytest.approx(adviser.best_next(weak).after.apr)
    # All tried: proven at once.
    assert found.n_compared == adviser.best_next(weak).n_compared


@pytest.mark.long
def test_a_unit_named_as_a_pose_of_the_grid_is_mounted_once_and_hides_no_candidate(
    adviser, apr_of
):
    """The study's poses are among the grid's: a mounted unit may be one of them, turned
    or not.
    """
    (unit,) = find_layout("carlancap-12").units[:1]

    assert unit.id in {one.id for one in adviser._assembly.candidates}

    turned = changed(unit, "pose.yaw_deg", unit.pose.yaw_deg + 120.0)

    for standing in (unit, turned):
        other = adviser.best_next([replace(standing, id="mine")])
        found = adviser.best_next([standing])

        assert found.n_compared == other.n_compared > 1
        assert found.after == other.after
        assert found.after.cost_eur > 0.0

        completed = adviser.complete([standing], n_units=3)
        expected = apr_of(completed.units)

        assert len(completed.units) == 3
        assert completed.units[0] is standing
        assert completed.after.apr == pytest.approx(expected)

        again = adviser.complete([replace(standing, id="mine")], n_units=3)

        assert completed.after == again.after


def test_an_answer_is_proven_by_what_is_asked_for(adviser, weak):
    found = adviser.best_next(weak)
    stages = (
        Stage(
            name="cost_eur",
            objective=4040.0,
            bound=4040.0,
            gap=0.0,
            seconds=1.0,
        ),
        Stage(
            name="apr",
            objective=0.8,
            bound=0.9,
            gap=0.1,
            seconds=1.0,
        ),
    )
    cheap = replace(
        found,
        n_compared=0,
        certificate=Certificate(stages=stages, solver=""),
    )

    assert cheap.is_proven is True
    assert cheap.is_all_proven is False
    assert cheap.bound == 0.9

    certificate = Certificate(stages=stages[::-1], solver="")
    open_ = replace(cheap, certificate=certificate)

    assert open_.is_proven is False
    assert open_.is_all_proven is False

    with pytest.raises(
        InputError, match="units in all: got 2; expected more than the 2"
    ):
        adviser.complete(weak, n_units=2)


def test_re_aiming_keeps_every_place_and_is_the_best_of_all_directions(
    adviser, weak, apr_of
):
    found = adviser.re_aim(weak)

    for before, after in zip(weak, found.units, strict=True):
        assert before.id == after.id
        assert before.site_id == after.site_id
        assert (before.pose.position_m == after.pose.position_m).all()

    grid = build_small_grid()

    def aims(unit):
        return [
            unit_at(
                unit.id,
                unit.pose.position_m,
                yaw_deg=yaw,
                pitch_deg=pitch,
                site_id=unit.site_id,
                sensor=unit.sensor,
            )
            for yaw, pitch in grid.directions_deg(unit.sensor)
        ] + [unit]

    best = max(apr_of([a, b]) for a in aims(weak[0]) for b in aims(weak[1]))

    assert found.after.apr == pytest.approx(best)
    assert found.after.apr > found.before.apr
    assert found.is_proven


@pytest.mark.long
def test_the_cheapest_is_as_good_and_no_dearer(adviser, setting, apr_of):
    units = find_layout("carlancap-12").units[:3]
    found = adviser.cheapest(units)

    assert apr_of(found.units) >= apr_of(units) - 1e-9
    assert found.after.cost_eur <= found.before.cost_eur
    assert found.is_proven

    cheaper = [
        one
        for one in adviser._assembly.candidates
        if apr_of([one]) >= apr_of(units) - 1e-9
    ]

    assert bool(cheaper) == (len(found.units) == 1)


def test_what_is_mounted_already_costs_nothing_in_all_answers(adviser):
    units = find_layout("carlancap-12").units[:3]
    names = [unit.id for unit in units]

    found = adviser.cheapest(units, paid=names)

    assert found.before.cost_eur == 0.0
    assert found.after.cost_eur == 0.0
    assert {unit.id for unit in found.units} <= set(names)

    dear = adviser.cheapest(units, paid=names[:1])
    alone = adviser.cheapest(units)

    assert 0.0 < dear.before.cost_eur < alone.before.cost_eur
    assert dear.after.cost_eur <= alone.after.cost_eur


def test_why_not_a_pole_says_what_it_can_do_beside_and_instead(adviser, weak, apr_of):
    site = "corner-sw"
    beside, instead = adviser.why_not(weak[:1], site)

    assert beside.units[-1].site_id == site

    at_site = [one for one in adviser._assembly.candidates if one.site_id == site]

    assert beside.after.apr == pytest.approx(
        max(apr_of([weak[0], one]) for one in at_site)
    )
    assert [unit.site_id for unit in instead.units] == [site]
    assert instead.after.apr == pytest.approx(max(apr_of([one]) for one in at_site))


def test_where_nothing_hangs_there_is_nothing_to_turn_or_to_keep(adviser):
    with pytest.raises(InputError, match="re-aim: got no unit"):
        adviser.re_aim(())
    with pytest.raises(
        InputError, match="the cheapest with at least this APR: got no unit"
    ):
        adviser.cheapest(())
    with pytest.raises(InputError, match="why not corner-ne: got no unit"):
        adviser.why_not((), "corner-ne")


def test_a_site_that_is_full_has_no_place_for_another(adviser, setting, weak):
    full = tuple(
        CandidatePose(
            id=f"F{n}",
            site_id="corner-ne",
            pose=weak[0].pose,
            sensor=weak[0].sensor,
        )
        for n in range(setting.scene.sites[0].capacity_units)
    )
    assert setting.scene.sites[0].id == "corner-ne"
    with pytest.raises(InputError, match="why not corner-ne: got no pose of the grid"):
        adviser.why_not(full, "corner-ne")


def test_names_are_free():
    assert free_name(set()) == "U1"

    for taken in combinations(("U1", "U2", "U3"), 2):
        assert free_name(set(taken)) not in taken
