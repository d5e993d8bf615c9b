from itertools import pairwise

from small_results import build_small_grid

from experiments.bench.growth import measure_growth, plot_growth, proportions
from placement import candidates as poses
from placement.question import Question


def test_amounts_and_costs_are_relative_to_the_least():
    assert proportions({"8": 3.0, "2": 2.0, "4": 5.0}) == [(1.0, 1.0), (2.0, 2.5), (4.0, 1.5)]


def test_a_small_question_is_measured_and_drawn(tmp_path, monkeypatch):
    monkeypatch.setattr(poses, "load_candidate_grid", build_small_grid)
    question = Question(cases="CPNC-50", along_arms="0", approaches="north", budget=1)
    growth = measure_growth(question, n_mounts=(1, 2))
    assert list(growth) == ["mounts", "runs", "weathers", "worlds"]
    for seconds in growth.values():
        amounts = [float(amount) for amount in seconds]
        assert all(a < b for a, b in pairwise(sorted(amounts)))
        assert min(seconds.values()) > 0.0
    plot_growth(growth, tmp_path / "growth.png")
    assert (tmp_path / "growth.png").read_bytes().startswith(b"\x89PNG")
