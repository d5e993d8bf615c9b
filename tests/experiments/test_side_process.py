import os
import signal
import sys
import time

import pytest

from experiments.side_process import SideProcess, side_process
from geometry.errors import InputError


def _pid_and(word):
    return os.getpid(), word


def _refuse(where):
    raise InputError(where, 1, "2")


def test_without_a_second_process_parts_are_made_when_they_are_asked_for():
    made = []
    with side_process(False) as side:
        task = side.begin("a part", made.append, "made")
        assert not made
        assert task.result() is None
        task.take()
        assert task.result() is None
    assert made == ["made"]


def test_parts_come_from_two_processes_errors_too_and_none_is_lost_with_one_of_them():
    with side_process(True) as side:
        first = side.begin("first", _pid_and, "one")
        while not (first._future.running() or first._future.done()):
            time.sleep(0.01)
        others = [side.begin(f"{number}", _pid_and, number) for number in range(5)]
        refused = side.begin("refused", _refuse, "here")
        with pytest.raises(InputError, match="here: got 1; expected 2"):
            refused.result()
        for task in reversed(others):  # those that wait, wait for the process to start
            task.take()
        assert [task.result()[1] for task in others] == list(range(5))
        assert others[-1].result()[0] == os.getpid()
        child, word = first.result()
        assert word == "one"
        assert child != os.getpid()
        assert side.begin("first", _pid_and, "again") is first

        last = side.begin("last", _pid_and, "last")
        os.kill(child, signal.SIGKILL)
        for number in range(3):
            task = side.begin(f"after {number}", _pid_and, number)
            assert task.result() == (os.getpid(), number)
        assert last.result()[1] == "last"


def test_the_second_process_ends_when_the_first_has_an_error():
    def fail():
        with side_process(True) as side:
            side.begin("first", _pid_and, "one").result()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()


def test_a_part_is_made_once():
    made = []
    side = SideProcess()
    side.begin("a", made.append, 1).take()
    side.begin("a", made.append, 2).take()
    assert made == [1]


def _runs_of(setting, number):
    return os.getpid(), id(setting), len(setting.runs), number


def test_a_setting_is_sent_to_the_second_process_once(small_setting):
    with side_process(True) as side:
        side.share(small_setting)
        side.share(small_setting)
        tasks = [
            side.begin(f"{number}", _runs_of, small_setting, number)
            for number in range(3)
        ]
        while not all(task._future.done() for task in tasks):
            time.sleep(0.01)
        found = [task.result() for task in tasks]
    assert {pid for pid, *_ in found}.isdisjoint({os.getpid()})
    assert len({identity for _, identity, *_ in found}) == 1
    assert [(n_runs, number) for *_, n_runs, number in found] == [
        (len(small_setting.runs), number) for number in range(3)
    ]


def test_the_second_process_loads_and_prepares_while_nothing_is_to_be_made():
    with side_process(True, modules=["colorsys"], prepare="os:getcwd") as side:
        task = side.begin("loaded", _is_loaded, "colorsys")
        while not task._future.done():
            time.sleep(0.01)
        assert task.result()


def _is_loaded(name):
    return name in sys.modules
