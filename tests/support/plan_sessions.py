"""A session of few runs and few poses, whose tasks run in a thread of this process."""

import asyncio
import threading

import pytest
from small_results import build_small_grid

from experiments.planner.plan import Variant
from experiments.planner.plan_files import Plan
from experiments.planner.session import Session
from experiments.planner.tasks import Tasks, Work
from experiments.planner.worker import Cancelled, TaskError
from experiments.scene import cause_of
from geometry.errors import InputError
from placement import candidates as poses
from placement.compute import Compute
from placement.question import Question


class InThread:
    """As :class:`experiments.planner.tasks.Worker`, on a setting that is at hand, if
    any.
    """

    def __init__(self, work, setting):
        self._tasks = None
        self._work = work
        self._setting = setting
        self._tell = None
        self._turn = asyncio.Lock()
        self.is_busy = False
        self.is_stopped = threading.Event()

    async def call(self, method, *args, on_progress, **kwargs):
        loop = asyncio.get_running_loop()

        def tell(stage, done, total):
            if self.is_stopped.is_set():
                raise Cancelled
            loop.call_soon_threadsafe(on_progress, stage, done, total)

        async with self._turn:
            self.is_busy = True
            self.is_stopped.clear()
            self._tell = tell  # a task tells whoever asked for it
            if self._tasks is None:
                self._tasks = Tasks(self._work, lambda *stage: self._tell(*stage))
                if self._setting is not None and not self._work.question.scene:
                    self._tasks.setting = self._setting
            try:
                return await asyncio.to_thread(
                    getattr(self._tasks, method), *args, **kwargs
                )
            except InputError as error:
                raise TaskError(str(error), cause_of(error)) from None
            finally:
                self.is_busy = False

    def stop(self):
        self.is_stopped.set()


def small_work(folder, **asked):
    """What tasks need, with a cache of their own."""
    compute = Compute(workers=2, cache_folder=folder)
    return Work(question=Question(**asked), scratch=folder, compute=compute)


def small_session(folder, setting, *, units=(), asked=None, **given):
    """A session that begins with a variant called "mine" of these units, if any."""
    work = small_work(
        folder, cases="CPNC-50", along_arms="0", speeds="50", **(asked or {})
    )
    if units:
        plan = Plan(variants=(Variant(name="mine", units=tuple(units)),))
    else:
        plan = None
    begun = work.question  # another question has other runs
    given.setdefault(
        "make_worker",
        lambda work: InThread(work, setting if work.question == begun else None),
    )
    return Session(work, setting, begun=plan, **given)


@pytest.fixture
def few_poses(monkeypatch):
    """The optimiser chooses among a few directions."""
    monkeypatch.setattr(poses, "load_candidate_grid", build_small_grid)


def start_server(folder, setting, *, keeps_open=True, **given):
    """A server of a session of few runs, which runs."""
    # Only the extra plan has what it needs.
    from experiments.planner.server import RunningServer

    server = RunningServer(
        lambda: small_session(folder, setting, **given),
        host="127.0.0.1",
        port=0,
        keeps_open=keeps_open,
    )
    server.start()
    return server
