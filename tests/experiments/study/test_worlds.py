"""The study of worlds: what it computes, resumes and tells."""

from dataclasses import replace
from pathlib import Path

import msgspec
import numpy as np
import pytest
from click.testing import CliRunner

from experiments.study import worlds
from experiments.study.worlds import Chosen, Records, Row, Where, _read, main
from geometry.errors import InputError
from placement.question import Question

PLAN = Where(scene="", cars="blind", n_worlds=0)
CHOSEN = Chosen(
    budget=1,
    tail=1.0,
    found=(3,),
    greedy=(5,),
    value=0.9,
    bound=0.9,
    processor_s=1.0,
    memory_mib=1.0,
)


def row(found: list[float], greedy: list[float], *, tail: float = 1.0) -> Row:
    chosen = msgspec.structs.replace(CHOSEN, tail=tail)
    return Row(where=PLAN, chosen=chosen, found=np.array(found), greedy=np.array(greedy))


def test_ahead_of_greedy_is_by_students_t_of_the_differences() -> None:
    # Differences 0.1, 0.2, 0.3: mean 0.2, error 0.1 / sqrt(3), t(2) = 4.3027 (any table of t).
    low, high = row([0.5, 0.7, 0.9], [0.4, 0.5, 0.6]).ahead
    reach = 4.302653 * 0.1 / np.sqrt(3.0)
    assert (low, high) == pytest.approx((0.2 - reach, 0.2 + reach), abs=1e-6)


def test_the_worst_quarter_is_compared_by_the_worst_quarter() -> None:
    # The found layout has the better mean, and a worst quarter that is worse by 0.1 in any draw.
    found, greedy = [1.0, 1.0, 1.0, 1.0], [0.9, 0.9, 0.9, 0.9]
    low, high = row(found, greedy, tail=0.25).ahead
    assert low == high == pytest.approx(0.1)


def test_equal_values_are_not_compared() -> None:
    assert row([0.5, 0.7], [0.5, 0.7]).is_same
    assert row([0.5, 0.7], [0.5, 0.7]).cells()[6] == "-"


def test_records_of_another_question_are_refused_and_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "records.json"
    records = _read(path, Question(budget=1))
    path.write_bytes(msgspec.json.encode(records))
    assert _read(path, Question(budget=1)) == records
    with pytest.raises(InputError, match="another question"):
        _read(path, Question(budget=2))
    path.write_text("{")
    with pytest.raises(InputError, match="records"):
        _read(path, Question(budget=1))
    assert path.read_text() == "{"


def test_the_default_is_counted_by_itself() -> None:
    default = msgspec.structs.replace(CHOSEN, given=0.01)
    worse = replace(row([0.90, 0.90] * 30, [0.94, 0.96] * 30), chosen=default)
    better = replace(row([0.98, 0.98] * 30, [0.96, 0.98] * 30), chosen=default)
    other = row([0.0, 0.0, 0.1], [1.0, 1.0, 1.0])
    told = worlds._of_default([worse, other, better])
    assert "behind in 1 of its 2, ahead in 1: -2.00 points in the mean, -5.00 at worst" in told
    told = worlds._of_default([replace(worse, takes_greedy=True), other, better])
    assert "behind in 0 of its 2, ahead in 1: +0.50 points in the mean, +0.00 at worst" in told


def test_the_answer_is_counted_not_what_was_found() -> None:
    worse = row([0.90, 0.91] * 5, [0.94, 0.96] * 5)
    told = worlds._headline(STUDY, [worse])
    assert "the answer is behind greedy choice, beyond chance, in 1 of 1 settings" in told
    taken = replace(worse, takes_greedy=True)
    told = worlds._headline(STUDY, [taken, row([0.9, 0.9], [0.9, 0.9])])
    assert "the answer is behind greedy choice, beyond chance, in 0 of 1 settings" in told
    assert "in 1 it is greedy choice's" in told
    assert "The layout found is behind in 1." in told
    assert (taken.cells()[7], worse.cells()[7]) == ("greedy", "found")
    assert taken.cells()[8].startswith("95.0 %")
    assert worse.cells()[8].startswith("90.5 %")


@pytest.mark.parametrize(
    ("ahead", "asks", "takes"),
    [([0.95, 0.96], True, True), ([0.95, 0.96], False, False), ([0.7, 1.0], True, False)],
)
def test_worlds_that_judge_nothing_decide(ahead: list[float], asks: bool, takes: bool) -> None:
    plan = PLAN.name
    records = Records(question={}, code="")
    wanted = [msgspec.structs.replace(CHOSEN, given=given) for given in (0.0, 0.01)]
    records.chosen[plan] = [msgspec.structs.replace(one, asks_worlds=asks) for one in wanted]
    study = replace(STUDY, samples=(), cars=("blind",))
    values = {"3": [0.9] * 10, "5": [0.8] * 10}
    records.fresh[plan] = values
    if asks:  # those worlds are still missing
        rows, missing = worlds.rows_of(study, records, "", "blind")
        assert (rows, missing) == ([], ["1 in plan, highest APR", "1 in plan, default"])
    records.deciding[plan] = {"3": [0.9, 0.9] * 30, "5": ahead * 30}
    rows, missing = worlds.rows_of(study, records, "", "blind")
    assert [one.takes_greedy for one in rows] == [takes, takes]
    assert not missing
    assert rows[0].answer.tolist() == values["5" if takes else "3"]


def test_the_time_is_up_and_what_is_done_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _here(monkeypatch, [])
    out = tmp_path / "out.md"
    command = [str(tmp_path / "f"), "--units=1", "--samples=4", "--cars=blind", f"--out={out}"]
    for _ in range(2):  # the plan's layouts, and their fresh worlds
        answer = CliRunner().invoke(main, [*command, "--hours=0"], catch_exceptions=False)
        assert "The time is up" in answer.output
    text = out.read_text()
    assert "| 1 | plan, default | mean |" in text
    assert "Not done yet for study, cars blind (units in): 1 in 4 worlds." in text
    assert not [*tmp_path.glob("*.png")]


@pytest.mark.parametrize("text", ["", "0", "1,x", "-1", "1.5"])
def test_numbers_of_units_are_whole(text: str, tmp_path: Path) -> None:
    answer = CliRunner().invoke(main, [str(tmp_path / "f"), f"--units={text}"])
    assert answer.exit_code == 2
    assert "whole numbers" in answer.output
    assert not (tmp_path / "f").exists()


def test_a_map_that_is_not_there_is_refused_before_anything_is_computed(tmp_path: Path) -> None:
    answer = CliRunner().invoke(main, [str(tmp_path / "f"), f"--map={tmp_path / 'no.osm'}"])
    assert answer.exit_code == 2
    assert "no.osm" in answer.output
    assert not (tmp_path / "f").exists()


def _here(monkeypatch: pytest.MonkeyPatch, asked: list[str]) -> None:
    def choose(
        question: Question, where: Where, wanted: list[worlds.Wanted], compute: object
    ) -> list[Chosen]:
        asked.append(where.name)
        return [
            msgspec.structs.replace(CHOSEN, budget=k, tail=tail, given=given)
            for k, tail, given in wanted
        ]

    monkeypatch.setattr(worlds, "choose", choose)
    monkeypatch.setattr(
        worlds,
        "plan_values",
        lambda q, w, layouts, c: {str(rows[0]): (0.9, 0.5) for rows in layouts},
    )
    monkeypatch.setattr(
        worlds,
        "judge",
        lambda q, w, layouts, first, n, c: {str(rows[0]): [0.9] * n for rows in layouts},
    )
    monkeypatch.setattr(worlds, "in_own_process", lambda function, *arguments: function(*arguments))


def test_a_run_that_was_cut_off_goes_on_where_it_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    _here(monkeypatch, asked)
    study = worlds.Study(
        question=Question(),
        scenes=("",),
        budgets=(1, 2),
        samples=(8,),
        n_blocks=2,
        n_judged=20,
    )
    path = tmp_path / "records.json"
    whole = worlds.run(study, path, worlds.Compute())
    assert len(asked) == 2 * (1 + 2)  # cars of either kind: the plan, and two blocks
    pictures = {"layouts": "layouts.png", "study": "study.png"}
    text = worlds.describe(study, whole, pictures)
    less = msgspec.json.decode(path.read_bytes(), type=Records)
    name = Where(scene="", cars="see", n_worlds=8, block=1).name
    del less.chosen[name]
    path.write_bytes(msgspec.json.encode(less))
    asked.clear()
    again = worlds.run(study, path, worlds.Compute())
    assert asked == [name]
    assert worlds.describe(study, again, pictures) == text


STUDY = worlds.Study(
    question=Question(), scenes=("",), budgets=(1,), samples=(4, 8), n_blocks=1, n_judged=10
)


def test_parts_of_some_hours_each_come_to_the_same(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    _here(monkeypatch, asked)
    whole = worlds.run(STUDY, tmp_path / "whole.json", worlds.Compute())
    asked.clear()
    path = tmp_path / "parts.json"
    while True:
        before = len(asked)
        try:
            found = worlds.run(STUDY, path, worlds.Compute(), until_s=-np.inf)  # a part each
            break
        except worlds.TimeUp:
            assert len(asked) <= before + 1
    assert found == whole
    assert len(set(asked)) == len(asked) == 6  # cars of either kind: the plan, 4 and 8 worlds
    command = [str(tmp_path / "f"), "--units=1", "--samples=4", "--hours=0"]
    command += [f"--out={tmp_path / 'out.md'}"]
    answer = CliRunner().invoke(main, command)
    assert answer.exit_code == 0
    assert "The time is up" in answer.output
    assert (tmp_path / "f/records.json").exists()


def test_worlds_that_do_not_fit_into_memory_are_left_out_and_told(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    _here(monkeypatch, asked)
    fitting = worlds.choose

    def choose(question: Question, where: Where, *rest: object) -> list[Chosen]:
        if where.n_worlds == 8:
            raise InputError("memory", "8 worlds", "less")
        return fitting(question, where, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(worlds, "choose", choose)
    path = tmp_path / "records.json"
    records = worlds.run(STUDY, path, worlds.Compute())
    assert len(records.too_large) == 2  # cars of either kind
    text = worlds.describe(STUDY, records, {})
    assert "Not in the memory of this machine: study, cars blind, 8 worlds, block 1." in text
    assert "| 1 | 4 worlds |" in text
    assert "| 8 worlds |" not in text
    assert worlds.run(STUDY, path, worlds.Compute()) == records  # not tried again

    def broken(*_: object) -> list[Chosen]:
        raise InputError("sites", "none", "some")

    monkeypatch.setattr(worlds, "choose", broken)
    with pytest.raises(InputError, match="sites"):
        worlds.run(STUDY, tmp_path / "other.json", worlds.Compute())


@pytest.mark.long
def test_a_small_study_from_the_command_line(tmp_path: Path) -> None:
    arguments = [
        *(str(tmp_path / "parts"), "--units=1", "--samples=2", "--blocks=2", "--judge=10"),
        *("--speeds=40", f"--out={tmp_path / 'worlds.md'}"),
    ]
    answer = CliRunner().invoke(main, arguments, catch_exceptions=False)
    assert answer.exit_code == 0, answer.output
    text = (tmp_path / "worlds.md").read_text()
    assert "## study, cars see" in text
    assert "| 1 | 2 worlds | mean |" in text
    assert (tmp_path / "worlds_layouts.png").stat().st_size > 10_000
    assert CliRunner().invoke(main, arguments).exit_code == 0
    assert (tmp_path / "worlds.md").read_text() == text
