"""What is to come: another question, or another scene, while the page shows the old one."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from placement.question import Question
from placement.setting import Setting

from .browsers import Browsers, question_message
from .files import MapFile, free_path
from .plan import History
from .tasks import Work
from .worker import Cancelled, Worker
from .workers import Coroutines, Workers
from .workspace import Shown, Workspace, build_workspace

MAX_WORKSPACES = 5
"""With those that Undo leads back to."""


# ---------- another question


@dataclass(frozen=True, slots=True, kw_only=True)
class _Coming:
    """A question that is to come, and the worker that builds its setting."""

    question: Question
    worker: Worker


class QuestionChange:
    """Goes on with another question when its runs are there; of several the newest counts.

    Parameters
    ----------
    current : callable
        What is shown by now.
    go_to : callable
        Shows the state of a history, whose evaluator is there already.
    begun : Question
        What was asked at first.
    browsers, workers, coroutines
        Those of the session.
    """

    def __init__(
        self,
        current: Callable[[], Shown],
        go_to: Callable[[History, Worker], None],
        *,
        begun: Question,
        browsers: Browsers,
        workers: Workers,
        coroutines: Coroutines,
    ) -> None:
        self._current = current
        self._go_to = go_to
        self._begun = begun
        self._browsers = browsers
        self._workers = workers
        self._coroutines = coroutines
        self._coming: _Coming | None = None

    @property
    def newest(self) -> Question:
        """The question that is to come, or else the one that is asked now."""
        if self._coming is not None:
            return self._coming.question
        return self._current().workspace.work.question

    def stop(self) -> None:
        """End the process that works for what is to come; from any thread."""
        coming = self._coming
        if coming is not None:
            coming.worker.stop()

    def ask(self, question: Question) -> None:
        """Begin to go on with a question; the one that is asked now: stay with that."""
        # What was asked before is not wanted any longer.
        self.stop()
        self._coming = None
        self._browsers.tell_stage("setting", "")
        shown = self._current()
        now = shown.workspace.work
        if question == now.question:
            self._browsers.send(question_message(shown, self._begun))
            return
        work = replace(now, question=question)
        worker = self._workers.make(work)
        self._coming = _Coming(question=question, worker=worker)
        self._coroutines.start(self._build(work, worker))

    async def _build(self, work: Work, worker: Worker) -> None:
        """Build the setting of a question, and show it; the layout stays, Undo leads back."""
        before = self._current().workspace
        workspace: Workspace | None = None
        problem = ""
        tell = self._browsers.stages("setting")
        tell("start", 0, 0)
        try:
            setting = await worker.call("open_setting", on_progress=tell)
            workspace, problem = await asyncio.to_thread(
                build_workspace, work, setting, title=before.title, save=before.save
            )
        except Cancelled:
            pass
        except Exception as error:  # whatever it is, what was asked before goes on
            problem = str(error)
        if self._coming is None or self._coming.worker is not worker:
            # Something else is asked by now
            worker.stop()
            return
        self._coming = None
        tell("", 0, 0)
        self._browsers.notice(problem)
        shown = self._current()
        # It failed, was stopped, or another scene was opened.
        if workspace is None or shown.workspace is not before:
            worker.stop()
            self._browsers.send(question_message(shown, self._begun))
            return
        # The image may have been laid while the setting was built.
        workspace.background = shown.workspace.background
        state = replace(shown.state, workspace=workspace)
        history = shown.history.went_on(state)
        self._go_to(history.of_newest(MAX_WORKSPACES), worker)


# ---------- another scene


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OpenedScene:
    """A scene that can be shown: its workspace, the evaluator that has read it, a notice."""

    workspace: Workspace
    evaluator: Worker
    notice: str


class SceneOpening:
    """Reads maps and scenes; one at a time, and :meth:`cancel` stops it."""

    def __init__(
        self, current: Callable[[], Shown], *, browsers: Browsers, workers: Workers
    ) -> None:
        self._current = current
        self._browsers = browsers
        self._workers = workers
        self._at_work: Worker | None = None

    def cancel(self) -> Worker | None:
        """Open nothing; gives the worker that is still to be stopped, if there is one."""
        stopped = self._at_work
        self._at_work = None
        return stopped

    def stop(self) -> None:
        """End the process that works at what is to come; from any thread."""
        worker = self._at_work
        if worker is not None:
            worker.stop()

    async def survey(self, file: MapFile) -> MapFile:
        """A map or a scene with what is in it. Raises TaskError, Cancelled."""
        reader = self._workers.reader
        self._at_work = reader
        tell = self._browsers.stages("scene")
        given: dict[str, Any] = {}
        if "keeps_left" in file.options:
            given["keeps_left"] = file.options["keeps_left"]
        try:
            found = await reader.call(
                "survey", str(file.path), on_progress=tell, **given
            )
        finally:
            self._at_work = None
            tell("", 0, 0)
        return replace(file, found=found)

    async def open(
        self,
        path: str,
        title: str = "",
        *,
        of: MapFile | None = None,
        junction: str = "",
    ) -> OpenedScene:
        """Read a scene, or cut it out of a map around a junction.

        Parameters
        ----------
        path : str
            The scene; it is written there if it is cut out of a map.
        title : str
            For people; by default the scene's name.
        of : MapFile, optional
            The map.
        junction : str
            Id of the junction in that map.

        Raises
        ------
        TaskError
            It cannot be made, or has no runs.
        Cancelled
            It was stopped, or another one is asked for.
        """
        tell = self._browsers.stages("scene")
        now = self._current().workspace.work
        work = replace(now, question=replace(now.question, scene=path))
        evaluator = self._workers.make(work)
        # `_at_work` says whose turn it is; whoever cancels takes it away.
        try:
            if of is not None:
                await self._cut(of, junction, path)
            self._at_work = evaluator
            setting: Setting = await evaluator.call("open_setting", on_progress=tell)
            workspace, notice = await asyncio.to_thread(
                build_workspace, work, setting, title=title, save=self._free_save()
            )
            if self._at_work is not evaluator:
                raise Cancelled
        except BaseException:
            evaluator.stop()
            raise
        finally:
            self._at_work = None
            tell("", 0, 0)
        # The question has changed: without private areas
        if notice:
            evaluator.stop()
            evaluator = self._workers.make(workspace.work)
        return OpenedScene(workspace=workspace, evaluator=evaluator, notice=notice)

    async def _cut(self, of: MapFile, junction: str, path: str) -> None:
        """Cut a junction out of a map, into a folder."""
        reader = self._workers.reader
        self._at_work = reader
        await reader.call(
            "import_junction",
            str(of.path),
            junction,
            path,
            on_progress=self._browsers.stages("scene"),
            **of.options,
        )
        # It was stopped, or another one is asked for
        if self._at_work is not reader:
            raise Cancelled

    def _free_save(self) -> Path | None:
        """File of the new scene's plan; None where the plan that is shown has none."""
        save = self._current().workspace.save
        if save is None:
            return None
        return free_path(save)
