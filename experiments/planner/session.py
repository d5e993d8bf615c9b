"""One session of the page, shared by several browsers: what each request of theirs leads to."""

import asyncio
from dataclasses import replace
from pathlib import Path
from typing import Any

from geometry.errors import refuse
from geometry.junction import street_names
from placement.layout import Layout
from placement.setting import Setting

from ..language import mark, tr
from . import requests
from .background import Background, background_message
from .browsers import (
    Browsers,
    Listener,
    question_message,
    scene_message,
    state_message,
)
from .changes import change_state
from .counting import Counting
from .files import MapFile, plan_bytes, save_plan
from .numbers import change_question, take_question
from .opening import MAX_WORKSPACES, OpenedScene, QuestionChange, SceneOpening
from .plan import History, Variant, add_variant, begin_history
from .plan_files import Plan, check_plan
from .poles import lay_poles
from .proposals import Proposals, ask_optimiser
from .tasks import Work
from .tiles import TileServer
from .views import Views
from .worker import Worker
from .workers import Coroutines, MakeWorker, Workers
from .workspace import Shown, Workspace, build_sensor_choice


class Session:
    """Carries out what browsers ask: it changes what is :attr:`shown`, and wakes who follows it.

    `shown` is a value, and :meth:`_go_to` alone replaces its history. Each of the parts
    does one job with it: `browsers` are told, `counting` finds the numbers, `views`
    what units see, `proposals` are the optimiser's, `question_change` and
    `scene_opening` work at what is to come, `workers` are the processes.

    All methods but :meth:`stop` and :meth:`stop_processes` are for the thread of the
    event loop.

    Parameters
    ----------
    work, setting
        The question of the session, and its scene and runs.
    begun : Plan, optional
        Plan to begin with.
    save : Path, optional
        File that gets the plan whenever it rests.
    make_worker : callable
        Makes the processes.
    map_file : MapFile, optional
        Map that the scene is cut out of.
    tiles : TileServer, optional
        Tiles behind the plan.

    Raises
    ------
    InputError
        The plan cannot be shown in this scene.
    """

    def __init__(
        self,
        work: Work,
        setting: Setting,
        *,
        begun: Plan | None = None,
        save: Path | None = None,
        make_worker: MakeWorker = Worker,
        map_file: MapFile | None = None,
        tiles: TileServer | None = None,
    ) -> None:
        self.tiles = tiles
        # The map that the scene is of, or that was sent last
        self.map_file = map_file
        self._begun = work.question
        title = ""
        if map_file is not None:
            title = _title_of_streets(setting)
        workspace = Workspace(work, setting, title=title, save=save)
        self.shown = _begin(workspace, begun or Plan(variants=()))
        # Files of plans, in the order of their scenes
        if save is None:
            self._saves = []
        else:
            self._saves = [save]
        self.browsers = Browsers()
        self.workers = Workers(make_worker, work)
        self.proposals = Proposals()
        self._coroutines = Coroutines()
        self.views = Views(self.current, browsers=self.browsers)
        self.counting = Counting(
            self.current,
            browsers=self.browsers,
            workers=self.workers,
            proposals=self.proposals,
        )
        self.question_change = QuestionChange(
            self.current,
            self._go_to,
            begun=self._begun,
            browsers=self.browsers,
            workers=self.workers,
            coroutines=self._coroutines,
        )
        self.scene_opening = SceneOpening(
            self.current, browsers=self.browsers, workers=self.workers
        )

    def current(self) -> Shown:
        """What is shown by now: for the parts, which wait for something in between."""
        return self.shown

    # ---------- life

    def start(self) -> None:
        """Begin to count and to judge."""
        for loop in (self.counting.count(), self.counting.judge(), self.views.look()):
            self._coroutines.start(loop)
        self.counting.changed.set()
        self.views.moved.set()

    def stop(self) -> None:
        """End all work, here and in other processes; from any thread."""
        self.shown.workspace.is_over.set()
        self.stop_processes()

    def stop_processes(self) -> None:
        """End everything that works in other processes; from any thread."""
        self.workers.stop()
        self.question_change.stop()
        self.scene_opening.stop()

    # ---------- browsers come, and ask

    def join(self, listener: Listener) -> None:
        """Add a browser, and send it everything."""
        greetings = [
            self._scene_message(),
            question_message(self.shown, self._begun),
            state_message(self.shown),
            self.proposals.message(self.shown),
            background_message(self.shown.workspace.background),
            *self.views.messages(),
        ]
        self.browsers.join(listener, greetings)
        self.counting.changed.set()

    def _scene_message(self) -> dict[str, Any]:
        map_name = ""
        if self.map_file is not None:
            map_name = self.map_file.name
        return scene_message(self.shown, map_name=map_name, tiles=self.tiles)

    def handle(self, text: bytes) -> None:
        """Carry out a request.

        Parameters
        ----------
        text : bytes
            JSON of one of :data:`.requests.Message`.

        Raises
        ------
        InputError
            It is none, or cannot be done; nothing has changed then.
        """
        message = requests.read_message(text)
        history = self.shown.history
        match message:
            case requests.Undo():
                self._go_to(history.undone())
            case requests.Redo():
                self._go_to(history.redone())
            case requests.Revert(gesture=gesture):
                self._go_to(history.reverted(gesture))
            case requests.ChangeQuestion():
                # Two changes of the question in a row are both meant.
                newest = self.question_change.newest
                self.question_change.ask(change_question(newest, message, self._begun))
            case requests.Ask():
                self._ask_optimiser(message)
            case requests.Cancel():
                self._stop_in_thread(self.workers.optimiser)
            case requests.CancelOpening():
                worker = self.scene_opening.cancel()
                if worker is not None:
                    self._stop_in_thread(worker)
            case requests.TakeProposal():
                self._take_proposal(message)
            case requests.DropProposal(number=number):
                self.proposals.drop(number)
                self.browsers.send(self.proposals.message(self.shown))
            case requests.ShowCoverage(is_shown=is_shown):
                self.counting.shows_coverage = is_shown
                self.counting.changed.set()
            case requests.ShowErrors(is_shown=is_shown):
                self.counting.shows_errors = is_shown
                self.counting.changed.set()
            case requests.ChooseSensors(names=names):
                sensors = self.shown.sensors.choosing(names)
                self.shown = replace(self.shown, sensors=sensors)
                self.browsers.send({"type": "sensors", "grid": list(sensors.chosen)})
            # All that is left changes the plan itself.
            case _:
                state = change_state(self.shown.state, message, self.shown.stock)
                gesture = ""
                if isinstance(message, requests.AddUnit | requests.ChangeUnit):
                    gesture = message.gesture
                self._go_to(history.went_on(state, gesture=gesture))

    def _stop_in_thread(self, worker: Worker) -> None:
        """End a process without waiting for it here."""
        self._coroutines.start(asyncio.to_thread(worker.stop))

    # ---------- changes

    def _go_to(self, history: History, evaluator: Worker | None = None) -> None:
        """Show the state of a history, and wake the loops that follow what is shown.

        Parameters
        ----------
        history : History
            What is shown from here; its state may be in another workspace.
        evaluator : Worker, optional
            Has read the scene of that workspace already.
        """
        is_elsewhere = history.state.workspace is not self.shown.workspace
        # What is of the old scene or question ends before the new one is shown.
        if is_elsewhere:
            self.browsers.notice(save_plan(self.shown))
            self.question_change.stop()
            self.workers.begin(history.state.workspace.work, evaluator)
            self.proposals.clear()
            self.views.clear()
        self.shown = self.shown.with_history(history)
        # Browsers draw the scene before the units in it.
        if is_elsewhere:
            self.browsers.send(self._scene_message())
            self.browsers.send(question_message(self.shown, self._begun))
        self.browsers.send(state_message(self.shown))
        if is_elsewhere:
            self.browsers.send(self.proposals.message(self.shown))
            self.browsers.send(background_message(self.shown.workspace.background))
        self.counting.changed.set()
        self.views.moved.set()

    def lay_background(self, background: Background | None) -> None:
        """Show another image below the plan, or none."""
        self.shown.workspace.background = background
        self.browsers.send(background_message(background))
        # Saved when the plan rests
        self.counting.changed.set()

    def open_plan(self, opened: Plan, source: str) -> None:
        """Add variants from a file; an only one that is empty gives way to them.

        A question that the file brings is asked from here on.

        Parameters
        ----------
        opened : Plan
            Contents of the file.
        source : str
            The file's name: it tells those apart whose own name is taken.

        Raises
        ------
        InputError
            A unit cannot be mounted in this scene, there are too many, or the page
            cannot ask the file's question.
        """
        workspace = self.shown.workspace
        scene = workspace.setting.scene
        opened = check_plan(opened, scene)
        question = self.question_change.newest
        if opened.question is not None:
            question = take_question(question, opened.question, self._begun)
        state = self.shown.state
        # An empty plan is what the page begins with: nobody wants it beside the file's.
        if len(state.variants) == 1 and not state.variant.units:
            first = begin_history(opened.variants, workspace).state
            state = replace(first, poles=state.poles)
        else:
            for variant in opened.variants:
                state = add_variant(state, variant, source=source)
        state = lay_poles(state, opened.poles, scene)
        state = replace(state, existing=(*state.existing, *opened.existing))
        if opened.background is not None:
            self.lay_background(opened.background)
        self._go_to(self.shown.history.went_on(state))
        if question != self.question_change.newest:
            self.question_change.ask(question)

    # ---------- the optimiser

    def _ask_optimiser(self, message: requests.Ask) -> None:
        """Ask for advice; InputError: the optimiser works at another request."""
        if self.workers.optimiser.is_busy:
            refuse(
                mark("the optimiser"), mark("another request"), mark("one at a time")
            )
        self._coroutines.start(self._advise(message, self.shown))

    async def _advise(self, message: requests.Ask, begun: Shown) -> None:
        """Add the optimiser's answers to the proposals, and show them."""
        is_done = await ask_optimiser(
            message,
            begun,
            workers=self.workers,
            proposals=self.proposals,
            browsers=self.browsers,
            current=self.current,
        )
        # Proposals are judged by the evaluator, too.
        if is_done:
            self.browsers.send(self.proposals.message(self.shown))
            self.counting.rests.set()

    def _take_proposal(self, message: requests.TakeProposal) -> None:
        """Take a proposal over; InputError: it is not shown, or there are too many variants."""
        proposal = self.proposals.find(message.number)
        state = self.shown.state
        if message.as_variant:
            variant = Variant(name=proposal.title, units=proposal.units)
            state = add_variant(state, variant)
        else:
            state = state.with_units(proposal.units)
        # Only now: a proposal that cannot be taken over is still shown.
        self.proposals.drop(message.number)
        self._go_to(self.shown.history.went_on(state))
        self.browsers.send(self.proposals.message(self.shown))

    # ---------- answers to addresses

    def layout(self) -> Layout:
        """The layout that is worked on. Raises InputError if nothing is mounted."""
        return self.shown.state.variant.layout(self.shown.setting.scene)

    def existing_ids(self) -> frozenset[str]:
        """Ids of units of that layout that are mounted already."""
        return self.shown.state.existing_ids(self.shown.units)

    def plan_text(self) -> bytes:
        """Contents of the plan's file."""
        return plan_bytes(self.shown)

    def save_plan(self) -> str:
        """Write the plan to its file; an error in words, see :func:`.files.save_plan`."""
        return save_plan(self.shown)

    def saved_files(self) -> list[str]:
        """Files of the plans of this session, in the order of their scenes."""
        return [str(path) for path in self._saves if path.exists()]

    async def call(self, method: str, *args: Any, is_long: bool = False) -> Any:
        """Result of a task for an answer to an address.

        Parameters
        ----------
        method : str
            Of :class:`.tasks.Tasks`.
        *args
            Its arguments.
        is_long : bool
            By the optimiser's process, so that the evaluator can go on.

        Raises
        ------
        TaskError, Cancelled
            As :meth:`.worker.Worker.call`.
        """
        worker = self.workers.evaluator
        who = "evaluator"
        if is_long:
            worker = self.workers.optimiser
            who = "optimiser"
        tell = self.browsers.stages(who)
        try:
            return await worker.call(method, *args, on_progress=tell)
        finally:
            tell("", 0, 0)

    async def open_file(self, file: MapFile) -> MapFile:
        """Survey a map or a scene; another junction is chosen from it. TaskError, Cancelled."""
        self.map_file = await self.scene_opening.survey(file)
        return self.map_file

    async def open_scene(
        self,
        path: str,
        title: str = "",
        *,
        of: MapFile | None = None,
        junction: str = "",
    ) -> None:
        """Go on in another scene, from nothing; Undo leads back.

        Where the plan has a file, that of the new scene gets another one. Parameters
        and errors are those of :meth:`.opening.SceneOpening.open`.
        """
        opened = await self.scene_opening.open(path, title, of=of, junction=junction)
        before = self.shown.workspace
        self.browsers.notice(opened.notice)
        self._show_scene(opened)
        save = opened.workspace.save
        if save is not None:
            self._saves.append(save)
            notice = tr(
                "The plan at {scene} is in {file}; this one: {new}.",
                scene=before.title,
                file=before.save,
                new=save,
            )
            self.browsers.notice(notice)

    def _show_scene(self, opened: OpenedScene) -> None:
        """Show an empty plan in a scene that was opened."""
        state = begin_history((), opened.workspace).state
        history = self.shown.history.went_on(state)
        self._go_to(history.of_newest(MAX_WORKSPACES), opened.evaluator)


def _title_of_streets(setting: Setting) -> str:
    """Names of the streets that meet, each once; empty where the map names none."""
    names = dict.fromkeys(street_names(setting.scene).values())
    return " / ".join(names)


def _begin(workspace: Workspace, begun: Plan) -> Shown:
    """What is shown at first: a plan in a workspace."""
    workspace.background = begun.background
    state = begin_history(begun.variants, workspace).state
    state = lay_poles(state, begun.poles, workspace.setting.scene)
    state = replace(state, existing=begun.existing)
    sensors = build_sensor_choice(workspace.work.question)
    return Shown(history=History(states=(state,)), sensors=sensors)
