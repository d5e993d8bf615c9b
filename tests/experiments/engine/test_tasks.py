"""The seam: order, tries, errors, and what the caller has to do with it."""

from concurrent.futures import Future

import pytest

from experiments.engine.tasks import TRIES, Engine, Here, map_tasks
from geometry.errors import InputError


class Later(Engine):
    """Answers the last of `capacity` tasks first, when no more are handed over."""

    capacity = 3

    def __init__(self):
        super().__init__()
        self.given = []
        self.most = 0

    def submit(self, function, shared, task):
        future = Future()
        self.given.append((future, function, (*shared, task)))
        self.most = max(self.most, len(self.given))
        return future

    def watch(self):
        future, function, arguments = self.given.pop()
        try:
            answer = function(*arguments)
        except Exception as error:
            future.set_exception(error)
        else:
            future.set_result(answer)


def test_answers_come_as_they_end_and_tasks_are_made_when_somebody_is_free():
    engine = Later()
    made = []

    def tasks():
        for number in range(7):
            made.append(number)
            yield number

    n_made = []
    found = {}
    for task, answer in map_tasks(pow, tasks(), engine=engine, shared=(2,)):
        found[task] = answer
        n_made.append(len(made))

    assert found == {number: 2**number for number in range(7)}
    assert next(iter(found)) == 2  # the last of the first three
    assert engine.most == 3
    assert n_made == [3, 4, 5, 6, 7, 7, 7]


def fail_at(number, calls):
    """A function that fails at one task, and notes which it was given."""

    def function(task):
        calls.append(task)
        if task == number:
            raise KeyError(task)
        return task

    return function


@pytest.mark.parametrize("engine", [Here, Later])
def test_a_task_that_raises_is_tried_thrice_and_then_answered_by_the_caller(engine):
    calls = []
    answers = map_tasks(
        fail_at(1, calls),
        range(3),
        engine=engine(),
        failed=lambda task, error: f"{task}: {error!r}",
    )

    assert dict(answers) == {0: 0, 1: "1: KeyError(1)", 2: 2}
    assert calls.count(1) == TRIES
    with pytest.raises(KeyError):
        list(map_tasks(fail_at(1, []), range(3), engine=engine()))


@pytest.mark.parametrize("engine", [Here, Later])
def test_what_nobody_can_answer_ends_all_at_once(engine):
    calls = []

    def refuse(task):
        calls.append(task)
        raise InputError("here", task, "nothing")

    with pytest.raises(InputError, match="here: got 0; expected nothing"):
        list(map_tasks(refuse, [0], engine=engine(), failed=lambda *given: None))
    assert calls == [0]


def test_an_interruption_is_no_answer():
    def interrupt(task):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        list(map_tasks(interrupt, [0], engine=Here(), failed=lambda *given: None))
