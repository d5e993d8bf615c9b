import numpy as np
import pytest

from placement.detection_table import pack_table
from placement.optimiser import Limits, PlacementProblem
from placement.refinement.poses import LOOK_BACK_S, find_weak_spots
from scenarios.weights import weight_per_run


@pytest.fixture(scope="module")
def problem_of(meadow):
    """The three walks of the meadow, with frames seen as given."""

    def build(*rows):
        axis = meadow.axis
        detected = np.zeros((len(rows), axis.n_frames), dtype=bool)
        for row, frames in enumerate(rows):
            detected[row, list(frames)] = True
        return PlacementProblem(
            table=pack_table(tuple(map(str, range(len(rows)))), axis, detected),
            limits=Limits(
                site_index=np.arange(len(rows)), site_capacity=np.ones(len(rows), dtype=int)
            ),
            fusion="any",
            rule=meadow.rule,
        )

    return build


def _share_of_runs(spots, axis):
    run = np.searchsorted(axis.run_start, spots.frame_index, side="right") - 1
    return np.bincount(run, weights=spots.probability, minlength=axis.n_runs)


def test_what_is_not_avoided_is_aimed_at_before_its_deadline(meadow, problem_of):
    """The first walk is seen at once, the others never."""
    spots = find_weak_spots(problem_of(range(3)), [0], meadow.runs)
    axis = meadow.axis
    assert spots.probability.sum() == pytest.approx(1.0)
    # Groups: not avoided (1/2 each of two), lost on failure and slowest (the first alone), all.
    third = 1.0 / 3.0
    assert _share_of_runs(spots, axis) == pytest.approx(
        [0.25 * (1 + 1 + third), 0.25 * (0.5 + third), 0.25 * (0.5 + third)]
    )
    for frame in spots.frame_index[spots.frame_index >= 40]:
        run = frame // 40
        deadline_s = meadow.runs[run].last_brake_time_s - meadow.rule.latency_s
        assert deadline_s - LOOK_BACK_S - 1e-9 <= axis.time_s[frame] <= deadline_s + 1e-9


def test_what_is_avoided_is_aimed_at_before_its_confirmation(meadow, problem_of):
    seen = [*range(20, 40), *range(50, 80), *range(95, 120)]
    spots = find_weak_spots(problem_of(seen), [0], meadow.runs)
    confirmed = {0: 22, 1: 52, 2: 97}
    for frame in spots.frame_index:
        last = confirmed[frame // 40]
        assert last - 10 * LOOK_BACK_S <= frame <= last


def test_the_vru_is_where_its_run_says(meadow, problem_of):
    spots = find_weak_spots(problem_of([]), [0], meadow.runs)
    ground = np.concatenate([run.vru_position_m for run in meadow.runs])
    assert np.array_equal(spots.vru_m[:, :2], ground[spots.frame_index])
    height = meadow.runs[0].encounter.vru.height_m
    assert np.all(spots.vru_m[:, 2] == 0.5 * height)


def test_runs_that_nothing_can_avoid_or_that_do_not_count_are_left_out(
    build_meadow, build_walk, build_small_setting, arc
):
    walks = [
        build_walk("hopeless", arc(15.0, 0.0, 50.0), last_brake_time_s=-np.inf),
        build_walk("normal", arc(15.0, 0.0, 50.0)),
    ]
    setting = build_small_setting(build_meadow(("west", 0.0, 0.0)), walks)
    problem = PlacementProblem(
        table=pack_table(("a",), setting.axis, np.zeros((1, setting.axis.n_frames), dtype=bool)),
        limits=Limits(site_index=np.array([0]), site_capacity=np.array([1])),
        fusion="any",
        rule=setting.rule,
    )
    spots = find_weak_spots(problem, [0], setting.runs)
    assert (spots.frame_index >= 40).all()
    assert len(spots.frame_index) > 5
    assert weight_per_run(walks) == pytest.approx([0.5, 0.5])
