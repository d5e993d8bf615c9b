import os
import signal
import time

import pytest

from experiments.report.beside import Beside, drawing_beside
from geometry.errors import InputError


def _pid_and(word):
    return os.getpid(), word


def _refuse(where):
    raise InputError(where, 1, "2")


def test_without_a_second_process_parts_are_made_when_they_are_asked_for():
    made = []
    with drawing_beside(False) as beside:
        part = beside.begin("a part", made.append, "made")
        assert not made
        assert part.result() is None
        part.take()
        assert part.result() is None
    assert made == ["made"]


def test_parts_come_from_two_processes_errors_too_and_none_is_lost_with_one_of_them():
    with drawing_beside(True) as beside:
        first = beside.begin("first", _pid_and, "one")
        while not (first._future.running() or first._future.done()):
            time.sleep(0.01)
        others = [beside.begin(f"{number}", _pid_and, number) for number in range(5)]
        refused = beside.begin("refused", _refuse, "here")
        with pytest.raises(InputError, match="here: got 1; expected 2"):
            refused.result()
        for part in reversed(others):  # those that wait, wait for the process to start
            part.take()
        assert [part.result()[1] for part in others] == list(range(5))
        assert others[-1].result()[0] == os.getpid()
        child, word = first.result()
        assert (word, child == os.getpid()) == ("one", False)
        assert beside.begin("first", _pid_and, "again") is first

        last = beside.begin("last", _pid_and, "last")
        os.kill(child, signal.SIGKILL)
        for number in range(3):
            part = beside.begin(f"after {number}", _pid_and, number)
            assert part.result() == (os.getpid(), number)
        assert last.result()[1] == "last"


def test_the_second_process_ends_when_the_first_has_an_error():
    def fail():
        with drawing_beside(True) as beside:
            beside.begin("first", _pid_and, "one").result()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()


def test_a_part_is_made_once():
    made = []
    beside = Beside()
    beside.begin("a", made.append, 1).take()
    beside.begin("a", made.append, 2).take()
    assert made == [1]


def _runs_of(setting, number):
    return os.getpid(), id(setting), len(setting.runs), number


def test_a_setting_is_sent_to_the_second_process_once(small_setting):
    with drawing_beside(True) as beside:
        parts = [beside.begin(f"{number}", _runs_of, small_setting, number) for number in range(3)]
        while not all(part._future.done() for part in parts):
            time.sleep(0.01)
        found = [part.result() for part in parts]
    assert {pid for pid, *_ in found}.isdisjoint({os.getpid()})
    assert len({identity for _, identity, *_ in found}) == 1
    assert [(n_runs, number) for *_, n_runs, number in found] == [
        (len(small_setting.runs), number) for number in range(3)
    ]
