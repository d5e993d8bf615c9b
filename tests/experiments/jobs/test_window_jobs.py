"""``place-rsus solve``: placement problems in files, and other questions about them."""

from dataclasses import replace

import numpy as np
import pytest
from command_results import answer, refusal
from small_tables import RULE

from placement.detection_table import pack_table
from placement.optimiser import (
    Floor,
    Limits,
    PlacementProblem,
    apr,
    solve_placement,
    sturdy_problem,
)
from placement.proof_files import save_problem


@pytest.fixture
def problem(frame_axis):
    """Pose 0 avoids run 1, pose 1 run 0, nothing run 2; each at a site of its own."""
    axis = replace(
        frame_axis,
        time_s=np.array([-0.2, -0.1, 0.0, -0.4, -0.3, -0.2, -0.1, 0.0, -0.1, 0.0])
        - 0.1,
    )
    detected = np.zeros((2, 10), dtype=bool)
    detected[0, 3:6] = True
    detected[1, 0:2] = True
    return PlacementProblem(
        table=pack_table(("west", "east"), axis, detected),
        limits=Limits(
            site_index=np.array([0, 1]),
            site_capacity=np.array([1, 1]),
            budget_units=1,
            unit_cost_eur=np.array([5.0, 7.0]),
        ),
        fusion="any",
        rule=replace(RULE, n_confirmations=2),
    )


@pytest.fixture
def solve(ask, tmp_path):
    """The answer to a question about a problem in a file."""

    def write_and_solve(problem, *arguments):
        save_problem(tmp_path / "one.npz", problem)
        return ask("solve", tmp_path / "one.npz", *arguments)

    return write_and_solve


@pytest.fixture
def refuse(run, tmp_path):
    """The line that refuses a question about a problem in a file."""

    def write_and_refuse(problem, *arguments):
        save_problem(tmp_path / "one.npz", problem)
        return refusal(run("solve", tmp_path / "one.npz", *arguments, "--quiet"))

    return write_and_refuse


def test_a_placement_problem_is_solved_as_it_was_asked(solve, problem):
    summary = solve(problem)
    assert summary["chosen_names"] == ["east"]
    assert summary["objective"] == 0.5
    assert summary["bound"] == 0.5
    assert summary["gap"] == 0.0
    assert summary["cost"] == 7.0
    assert [stage["name"] for stage in summary["stages"]][-1] == "cost_eur"


def test_another_question_may_be_asked(solve, problem):
    assert solve(problem, "--budget", 2)["chosen_names"] == [
        "west",
        "east",
    ]
    assert solve(problem, "--budget-cost", 5)["chosen_names"] == ["west"]

    both = solve(problem, "--budget-cost", 20)
    assert both["chosen_names"] == ["east"]  # the file's one unit holds

    summary = solve(problem, "--target", "max")
    assert summary["goal"] == "fewest"
    assert summary["objective"] == 2.0
    assert summary["chosen"] == [0, 1]
    assert solve(problem, "--target", "0.2")["objective"] == 1.0


def test_a_question_without_an_answer_says_the_best_there_is(refuse, problem):
    assert refuse(problem, "--target 0.9") == (
        "--target: got 0.9; expected at most 0.75, which all candidate"
        " poses together reach"
    )


def test_tracks_may_be_asked_to_live_for_another_time(solve, problem):
    seen = problem.table.detected(slice(None))
    seen[0, 5] = False  # west loses sight 0.2 s before the last moment
    table = pack_table(problem.table.pose_ids, problem.table.axis, seen)
    problem = replace(problem, table=table)
    lasting, short = (
        solve(problem, "--budget", 2, "--track-memory", memory_s)["objective"]
        for memory_s in ("inf", "0.1")
    )
    both = replace(problem, rule=replace(problem.rule, track_memory_s=0.1))

    assert short == apr(both, [0, 1])
    assert short < lasting == apr(problem, [0, 1])


def test_a_memory_shorter_than_a_frame_is_refused(run, problem, tmp_path):
    save_problem(tmp_path / "one.npz", problem)
    for memory in ("0.05", "-1", "nan"):
        code, _, err = run("solve", tmp_path / "one.npz", "--track-memory", memory)
        assert code == 2
        assert "--track-memory: got " in err
        assert "expected seconds, at least " in err


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ("--budget", 3, "--target", "max"),
            (
                "--target: got it beside --budget; expected one of --budget,"
                " --budget-cost, --target"
            ),
        ),
        (
            ("--budget", 0),
            "--budget: got '0'; expected a whole number of units, at least 1",
        ),
    ],
)
def test_wrong_options_are_told_in_one_line(refuse, problem, arguments, message):
    line = refuse(problem, *arguments)
    assert line.startswith(f"{message}")


def test_a_file_without_a_placement_problem_is_refused_in_one_line(run, tmp_path):
    path = tmp_path / "scp41.txt"
    path.write_text("3 4\n1 2 3 4\n")
    for file in (path, tmp_path / "none"):
        line = refusal(run("solve", file, "--quiet"))
        assert line.startswith(f"{file}: got ")


@pytest.fixture
def demanding(problem):
    """A quarter of the runs at least, also when a unit fails; with two units there is
    more.
    """
    floors = (
        Floor(name="target", share=0.2),
        Floor(
            name="min_case_apr in A",
            share=1.0,
            is_counted=np.array([False, True, False]),
        ),
    )
    return replace(problem, floors=floors, survive=1)


def test_a_budget_takes_the_place_of_the_files_own_and_no_other_demand(
    solve, demanding
):
    own = solve(demanding)
    assert own["chosen_names"] == ["west"]
    assert own["replaced"] == []

    two = solve(demanding, "--budget", 2)
    assert two["replaced"] == ["at most 1 unit"]
    assert two["question"] == [
        "the best layout",
        "first the highest APR that is left when any unit fails",
        "at most 2 units",
        "target: an APR of at least 20 %",
        "min_case_apr in A: an APR of at least 100 % in 1 of 3 runs",
    ]

    cheap = solve(demanding, "--budget-cost", 100)
    assert cheap["chosen_names"] == ["west"]
    assert cheap["replaced"] == []
    assert "at most 1 unit" in cheap["question"]


def test_a_floor_that_a_smaller_budget_does_not_reach_is_refused(
    run, demanding, tmp_path
):
    floors = (Floor(name="target", share=0.7),)
    save_problem(
        tmp_path / "one.npz",
        replace(
            demanding, floors=floors, limits=replace(demanding.limits, budget_units=2)
        ),
    )
    assert refusal(run("solve", tmp_path / "one.npz", "--budget 1 --quiet")) == (
        "--target: got 0.7; expected at most 0.5, what the best set found reaches"
    )


def test_a_target_takes_the_place_of_the_files_own_and_of_its_number_of_units(
    solve, demanding
):
    summary = solve(demanding, "--target", 0.7)
    assert summary["replaced"] == [
        "the best layout",
        "at most 1 unit",
        "target: an APR of at least 20 %",
    ]
    assert summary["question"][-2:] == [
        "min_case_apr in A: an APR of at least 100 % in 1 of 3 runs",
        "--target: an APR of at least 70 %",
    ]
    assert summary["chosen_names"] == ["west", "east"]


@pytest.mark.parametrize("solver", ["auto", "greedy"])
def test_every_solver_reaches_the_files_floors_or_refuses(
    solve, run, demanding, tmp_path, solver
):
    summary = solve(demanding, "--solver", solver)
    assert summary["chosen_names"] == ["west"]  # east is worth more, and misses a floor

    beyond = replace(
        demanding, floors=(*demanding.floors, Floor(name="more", share=0.7))
    )
    save_problem(tmp_path / "two.npz", beyond)
    assert refusal(
        run("solve", tmp_path / "two.npz", "--solver", solver, "--quiet")
    ).startswith("more: got 0.7; expected ")


def test_the_first_lines_say_what_is_asked_and_what_was_replaced(
    run, demanding, tmp_path
):
    save_problem(tmp_path / "one.npz", demanding)
    out = answer(run("solve", tmp_path / "one.npz", "--budget 2 --quiet"))
    words = " ".join(out.split())

    assert words.startswith(
        "one.npz: best layout asked: the best layout; first the highest APR that is"
        " left when any unit fails; at most 2 units; target: an APR of at least 20 %;"
        " min_case_apr in A: an APR of at least 100 % in 1 of 3 runs; fusion any in"
        " place of the file's own: at most 1 unit "
    )


def test_what_may_be_given_up_is_found_anew_for_another_budget(solve, problem):
    file = sturdy_problem(problem, solve_placement(problem), 0.1)
    assert file.floors[0].share == pytest.approx(0.4)
    # Two units reach 75 %: of these a tenth of the runs may be given up.
    assert solve(file, "--budget", 2)["question"] == [
        "the best layout",
        "first the highest APR that is left when any unit fails",
        "at most 2 units",
        "give_up: an APR of at least 65 %",
    ]

    # Of a single unit nothing is given up.
    one = solve(file, "--budget", 1)
    assert one["question"] == ["the best layout", "at most 1 unit"]
    assert one["chosen_names"] == ["east"]

    shorter = solve(file, "--target", 0.5)
    assert shorter["question"] == [
        "the fewest units",
        "--target: an APR of at least 50 %",
    ]


def test_a_budget_is_refused_for_a_file_that_asks_for_the_fewest_units(refuse, problem):
    floors = (Floor(name="target", share=0.5),)
    fewest = replace(
        problem,
        goal="fewest",
        floors=floors,
        limits=replace(problem.limits, budget_units=None),
    )
    assert refuse(fewest, "--budget 2") == (
        "--budget: got it for a file that asks for the fewest units; expected"
        " --target, or a file that asks for the best layout"
    )
