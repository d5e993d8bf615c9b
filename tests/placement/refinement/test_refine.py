"""Layouts refined between the poses of the grid."""

from dataclasses import replace

import numpy as np
import pytest
from changes import changed
from refusals import refused_with
from tiny_worlds import table_of

from geometry.catalogue import pick_sensor
from geometry.lenses import BrownConrady, Fisheye
from placement.candidates import CandidateGrid, build_candidates
from placement.compute import Compute
from placement.layout import check_layout, layout_from_records, layout_records
from placement.optimiser import is_feasible, placement_value
from placement.optimiser.problem import objective_values
from placement.pipeline import Assembly, place
from placement.refinement import improves, refine
from placement.wishes import Wishes


def _grid_of(scene, camera, *, yaw_step_deg, pitch_deg=-15.0, height_m=5.0):
    """Candidates of a grid with one height and pitch."""
    grid = CandidateGrid(
        heights_m=[height_m],
        yaw_step_deg=yaw_step_deg,
        pitches_deg=[pitch_deg],
        sensors=(camera,),
    )
    return build_candidates(scene, grid)


@pytest.fixture(scope="module")
def placements(meadow, meadow_grid, tmp_path_factory):
    """By the question asked."""
    old = replace(meadow_grid[0], id="old")
    questions = {
        "one unit": Wishes(budget_units=1),
        "two units": Wishes(budget_units=2),
        "survives": Wishes(budget_units=2, survive=1),
        "money": Wishes(budget_eur=1500.0),
        "fewest": Wishes(target=np.inf),
        "cheapest": Wishes(target=0.6, saves="cost"),
        "kept": Wishes(budget_units=2, existing=("old",)),
        "apart": Wishes(budget_units=2, separation_m=10.0),
        "alone": Wishes(budget_units=2),
    }
    candidates = (*meadow_grid, old)
    cache = tmp_path_factory.mktemp("cache")
    return {
        name: (
            candidates,
            place(
                Assembly(
                    setting=meadow,
                    candidates=candidates,
                    wishes=wishes,
                    fusion="single" if name == "alone" else "any",
                    compute=Compute(cache_folder=cache),
                )
            ),
        )
        for name, wishes in questions.items()
    }


@pytest.fixture(scope="module")
def refinements(meadow, placements):
    """Refinements of all placements, by name."""
    return {
        name: refine(
            meadow,
            placement,
            candidates,
            compute=Compute(workers=1),
        )
        for name, (candidates, placement) in placements.items()
    }


NAMES = (
    "one unit",
    "two units",
    "survives",
    "money",
    "fewest",
    "cheapest",
    "kept",
    "apart",
    "alone",
)


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_refinement_is_never_worse_in_the_order_of_the_stages(
    name, placements, refinements
):
    _, placement = placements[name]
    refinement = refinements[name]

    assert refinement.before == objective_values(
        placement.problem, placement.pose_index
    )
    assert not improves(refinement.before, refinement.after)
    assert refinement.is_improved == improves(refinement.after, refinement.before)

    stages = placement.certificate.stages

    assert [*refinement.after] == [stage.name for stage in stages]


@pytest.mark.parametrize("name", NAMES)
def test_a_refined_layout_is_within_all_limits_and_what_its_placement_says(
    name, meadow, placements, refinements
):
    refinement = refinements[name]
    refined = refinement.placement
    problem = refined.problem
    units = refined.pose_index
    expected = tuple(c.id for c in refinement.candidates)

    assert is_feasible(problem, units)
    assert refinement.after == objective_values(problem, units)
    assert problem.table.pose_ids == expected
    assert len(set(problem.table.pose_ids)) == len(problem.table.pose_ids)

    check_layout(refined.layout, meadow.scene)

    low_high = {site.id: site.height_range_m for site in meadow.scene.sites}
    places = {site.id: site.position_m[:2] for site in meadow.scene.sites}

    for unit in refined.layout.units:
        low, high = low_high[unit.site_id]
        assert low <= unit.pose.position_m[2] <= high
        assert np.array_equal(unit.pose.position_m[:2], places[unit.site_id])

    # Certificates and explanations take rows and units in the same order.
    for row, unit in zip(units, refined.layout.units, strict=True):
        assert refinement.candidates[row].pose == unit.pose


@pytest.mark.parametrize("name", NAMES)
def test_what_was_refined_is_what_the_builder_of_tables_sees(name, meadow, refinements):
    refined = refinements[name].placement
    units = [refinements[name].candidates[row] for row in refined.pose_index]
    table = table_of(meadow, units)

    assert np.array_equal(
        table.packed, refined.problem.table.packed[list(refined.pose_index)]
    )


def test_most_questions_have_a_better_answer_between_the_poses_of_this_grid(
    refinements,
):
    better = [name for name in NAMES if refinements[name].is_improved]
    assert {"one unit", "two units", "survives", "money", "kept"} <= set(better)

    for name in better:
        certificate = refinements[name].placement.certificate
        for stage, value in zip(
            certificate.stages, refinements[name].after.items(), strict=True
        ):
            assert (stage.name, stage.objective) == value
            if stage.name in ("units", "cost_eur"):
                assert stage.bound <= stage.objective
            else:
                assert stage.bound >= stage.objective

        n_tried = refinements[name].n_tried
        words = f"over 17 grid candidates and {n_tried} further poses tried"

        assert words in certificate.solver
        assert len(refinements[name].candidates) == 17 + n_tried


def test_a_kept_unit_stays_as_it_is_and_the_other_one_moves(placements, refinements):
    candidates, _ = placements["kept"]
    refinement = refinements["kept"]
    units = {unit.id: unit for unit in refinement.placement.layout.units}

    assert units.keys() == {"old", "U1"} or units.keys() == {"old", "U2"}
    assert units["old"].pose is candidates[-1].pose
    assert refinement.is_improved
    for move in refinement.moves:
        assert move.after is None or move.after.id != "old"

    assert refinement.placement.problem.limits.is_forced.sum() == 1


def test_units_that_are_all_kept_are_not_refined(meadow, meadow_grid):
    old = replace(meadow_grid[0], id="old")
    candidates = (*meadow_grid, old)

    wishes = Wishes(budget_eur=0.0, existing=("old",))
    placement = place(
        Assembly(
            setting=meadow,
            candidates=candidates,
            wishes=wishes,
        )
    )

    assert [unit.id for unit in placement.layout.units] == ["old"]

    refinement = refine(meadow, placement, candidates)

    assert refinement.placement is placement
    assert refinement.moves == ()
    assert refinement.after == refinement.before


@pytest.mark.long
def test_the_same_seed_gives_the_same_layout(meadow, placements, refinements):
    candidates, placement = placements["two units"]

    again = refine(
        meadow,
        placement,
        candidates,
        compute=Compute(workers=2),
    )
    first = refinements["two units"]
    expected = layout_records(first.placement.layout)

    assert layout_records(again.placement.layout) == expected
    assert again.n_tried == first.n_tried
    assert again.after == first.after


# Known optima


def test_a_unit_is_turned_to_where_it_sees_earliest(
    build_meadow, build_walk, build_small_setting, narrow_camera, arc
):
    """Steps alone: the walk comes into view from the left, 90 degrees from the middle
    at first.
    """
    scene = build_meadow(("pole", 0.0, 0.0))
    setting = build_small_setting(scene, [build_walk("walk", arc(18.0, 90.0, 10.0))])
    candidates = _grid_of(scene, narrow_camera, yaw_step_deg=360.0)
    candidates = [changed(candidates[0], "pose.yaw_deg", 30.0)]
    placement = place(
        Assembly(setting=setting, candidates=candidates, wishes=Wishes(budget_units=1))
    )

    before = placement_value(placement.problem, placement.pose_index)
    (run,) = setting.runs
    latest_s = run.last_brake_time_s - setting.rule.latency_s - run.time_s[2]

    assert 0.0 < before.mean_margin_s < latest_s - 1.0

    refinement = refine(setting, placement, candidates)

    assert dict(refinement.after)["mean_margin_s"] == pytest.approx(latest_s, abs=1e-9)

    (move,) = refinement.moves

    assert move.turn_deg > 30.0
    assert move.lift_m == 0.0


@pytest.mark.long
@pytest.mark.parametrize(
    "lens", [None, BrownConrady(k1=-0.1, p1=0.002), Fisheye(k1=-0.02)]
)
def test_a_varifocal_lens_zooms_in_on_what_is_far_away(
    build_meadow, build_walk, build_small_setting, lens
):
    camera = replace(pick_sensor("varifocal-1080p", "test"), name="own", lens=lens)
    scene = build_meadow(("pole", 0.0, 0.0))
    walk = np.column_stack([np.full(40, 150.0), np.linspace(-2.0, 2.0, 40)])
    setting = build_small_setting(scene, [build_walk("walk", walk)])
    candidates = _grid_of(
        scene,
        camera,
        yaw_step_deg=90.0,
        pitch_deg=0.0,
    )
    candidates = [one for one in candidates if one.pose.yaw_deg == 0.0]

    placement = place(
        Assembly(setting=setting, candidates=candidates, wishes=Wishes(budget_units=1))
    )

    assert placement_value(placement.problem, placement.pose_index).apr == 0.0

    refinement = refine(setting, placement, candidates)

    assert dict(refinement.after)["apr"] == 1.0

    (unit,) = refinement.placement.layout.units
    low, high = camera.fov_range_deg

    assert low <= unit.sensor.horizontal_fov_deg < high

    (record,) = layout_records(refinement.placement.layout)

    assert record["fov_deg"] == unit.sensor.horizontal_fov_deg

    (back,) = layout_from_records(
        "l",
        [record],
        "f.json",
        sensors={"own": camera},
    ).units

    assert back.sensor == unit.sensor


def test_a_lidar_is_aimed_too(build_meadow, build_walk, build_small_setting, arc):
    """Someone to the left; the grid looks ahead and back, 36 degrees to each side."""
    scene = build_meadow(("pole", 0.0, 0.0))
    setting = build_small_setting(scene, [build_walk("walk", arc(12.0, 93.0, 87.0))])

    lidar = pick_sensor("carla-ncap-lidar", "test")
    candidates = _grid_of(scene, lidar, yaw_step_deg=180.0)

    placement = place(
        Assembly(setting=setting, candidates=candidates, wishes=Wishes(budget_units=1))
    )

    assert placement_value(placement.problem, placement.pose_index).apr == 0.0

    refinement = refine(setting, placement, candidates)
    (unit,) = refinement.placement.layout.units

    assert unit.sensor is lidar
    assert 50.0 <= unit.pose.yaw_deg <= 130.0
    assert dict(refinement.after)["apr"] == 1.0


# Bad input


def test_a_table_of_sampled_worlds_is_refused(meadow, placements):
    candidates, placement = placements["one unit"]
    table = placement.problem.table
    run_ids = tuple(f"{name}#1" for name in table.axis.run_ids)
    axis = replace(table.axis, run_ids=run_ids)
    problem = replace(placement.problem, table=replace(table, axis=axis))

    with refused_with(
        "refine: got a table of sampled worlds; expected a table of the runs as planned"
    ):
        refine(meadow, replace(placement, problem=problem), candidates)


def test_other_candidates_than_the_rows_of_the_table_are_refused(meadow, placements):
    candidates, placement = placements["one unit"]
    with refused_with(
        "candidates: got other poses; expected the rows of the placement's table"
    ):
        refine(meadow, placement, candidates[1:])
