import json

from click.testing import CliRunner

from experiments.bench.__main__ import PARTS, main, run_part


def test_a_part_whose_time_is_up_is_ended_and_says_so():
    figures = run_part("single", budget=1, limit_s=0.01)
    assert figures == {"single: ended after so many seconds, not finished": 0.01}


def test_figures_of_other_parts_stay_in_the_file(tmp_path):
    path = tmp_path / "bench.json"
    path.write_text(json.dumps({"rays": {"rays cast": 7}, "of another time": 1.0}))
    words = ["--parts", "single", "--limit", "0.01", "--out", str(path)]
    result = CliRunner().invoke(main, words)
    assert result.exit_code == 0, result.output
    figures = json.loads(path.read_text())
    assert list(figures) == ["machine", "rays", "single"]
    assert figures["rays"] == {"rays cast": 7}


def test_an_unknown_part_is_told_with_those_there_are():
    result = CliRunner().invoke(main, ["--parts", "single, speed"])
    assert result.exit_code == 2
    assert f"speed: expected some of {', '.join(PARTS)}" in " ".join(
        result.output.split()
    )
