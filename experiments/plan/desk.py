"""The desk that several browsers look at: one session, its numbers, and what is worked on."""

import asyncio
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import Any

from geometry.catalogue import Sensor
from geometry.errors import InputError, Unquoted
from geometry.files import pick, write_atomically
from placement.candidates import CandidatePose, load_candidate_grid
from placement.layout import Layout
from placement.planning import build_grid, own_models
from placement.setting import Setting

from ..parts.player import view_paths
from .background import MAX_BYTES as MAX_IMAGE_BYTES
from .background import Background, background_message
from .messages import (
    Ask,
    Cancel,
    ChooseSensors,
    DropProposal,
    Revert,
    ShowCoverage,
    TakeProposal,
    read_message,
)
from .numbers import (
    cost_record,
    coverage_record,
    key_of,
    plan_text,
    scene_record,
    state_record,
)
from .place import Key, Place, Visit, build_place, free_path
from .proposals import Proposal, sensor_words
from .session import (
    MAX_PLAN_BYTES,
    ChangeUnit,
    History,
    Plan,
    PlanState,
    Redo,
    Stock,
    Undo,
    Variant,
    add_variant,
    begin_history,
    change_state,
    check_plan,
    first_units,
)
from .tasks import Work
from .worker import Cancelled, DiedError, TaskError, Worker

Listener = Callable[[dict[str, Any]], None]

MAX_MAP_BYTES = 300_000_000
"""Of a file that a browser sends."""

_REST_S = 0.3  # without a change, before pixels are asked
_MAX_PROPOSALS = 12
_MAX_PLACES = 4  # scenes that Undo leads back to


class Desk:
    """One session: what is planned, who looks at it, and the processes that work for it.

    All methods but :meth:`stop` are called from the server's event loop.

    Parameters
    ----------
    work : Work
        What is asked, and where files of the session are.
    setting : Setting
        As :func:`placement.setting.build_setting` builds it for the same question.
    plan : Plan, optional
        To begin with.
    save : Path, optional
        File that gets the plan whenever it rests.
    make_worker : function of Work
        Makes what runs the tasks.
    """

    def __init__(
        self,
        work: Work,
        setting: Setting,
        *,
        plan: Plan | None = None,
        save: Path | None = None,
        make_worker: Callable[[Work], Worker] = Worker,
    ) -> None:
        self.place = Place(work, setting, save=save)
        self._make_worker = make_worker
        self.history: History = begin_history(plan.variants if plan else ())
        self.background: Background | None = plan.background if plan else None
        self._earlier: list[Visit] = []  # other scenes that Undo and Redo lead to
        self._later: list[Visit] = []
        self.revision = 0
        self.listeners: set[Listener] = set()
        self.left_at_s: float | None = None  # since when nobody looks, who looked before
        self.is_lost = False
        self._exact, self._advice = make_worker(work), make_worker(work)
        self._proposals: list[Proposal] = []
        self._numbers_of_proposals = count(1)
        self._words = sensor_words(work.question.sensors)
        self._models: dict[str, Sensor] = {
            model.name: model
            for word in self._words.values()
            for model in own_models(word).values()
            for word in self._words.values()
            for model in own_models(word).values()
        }
        self._chosen: list[str] = [sensor.name for sensor in build_grid(work.question).sensors]
        self._shows_coverage = False
        self._changed, self._rests, self._moved = asyncio.Event(), asyncio.Event(), asyncio.Event()
        self._views: dict[str, tuple[Key, dict[str, Any]]] = {}  # by unit, with its pose
        self._tasks: set[asyncio.Task[None]] = set()
        self._doing: dict[str, Any] = {}

    @property
    def work(self) -> Work:
        """What is asked, and where files of the session are."""
        return self.place.work

    @property
    def setting(self) -> Setting:
        """Scene and runs."""
        return self.place.setting

    # ---------- life

    def start(self) -> None:
        """Begin to count and to judge."""
        for loop in (self._count(), self._judge(), self._look()):
            self._spawn(loop)
        self._changed.set()
        self._moved.set()

    def stop(self) -> None:
        """End all work, here and in other processes; from any thread."""
        self.place.is_over.set()
        self.stop_processes()

    def stop_processes(self) -> None:
        """End everything that works in other processes; from any thread."""
        for worker in (self._exact, self._advice):
            worker.stop()

    def _spawn(self, work: Any) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    # ---------- talk

    def tell(self, message: dict[str, Any]) -> None:
        """Tell every browser."""
        for listener in [*self.listeners]:
            listener(message)

    def _notice(self, text: str) -> None:
        if text:
            self.tell({"type": "notice", "text": text})

    def join(self, listener: Listener) -> None:
        """A browser comes: it is told all that there is."""
        self.listeners.add(listener)
        self.left_at_s = None
        listener(self._scene_message())
        listener(self._state_message())
        listener(self._proposals_message())
        listener(background_message(self.background))
        for _, view in self._views.values():
            listener(view)
        if self._doing:
            listener(self._doing)
        self._changed.set()

    def leave(self, listener: Listener, *, is_lost: bool = False) -> None:
        """A browser goes: its page was closed, or the connection to it is lost."""
        self.listeners.discard(listener)
        if not self.listeners:
            self.left_at_s, self.is_lost = time.monotonic(), is_lost

    def _scene_message(self) -> dict[str, Any]:
        return {
            "type": "scene",
            **scene_record(
                self.setting,
                models=[*self._models.values()],
                chosen=self._chosen,
                ground=self.place.ground,
            ),
            "title": self.place.title,
            "isKept": self.place.save is not None,
            "mostBytes": {"plan": MAX_PLAN_BYTES, "map": MAX_MAP_BYTES, "image": MAX_IMAGE_BYTES},
        }

    def _stock(self) -> Stock:
        return Stock(scene=self.setting.scene, models=self._models)

    def _state_message(self) -> dict[str, Any]:
        record = state_record(self.history, self.setting.scene)
        record["canUndo"] |= bool(self._earlier)
        record["canRedo"] |= bool(self._later)
        return {"type": "state", "revision": self.revision, **record}

    def _do(self, who: str, stage: str, done: int = 0, total: int = 0) -> None:
        """Tell what is worked on; an empty stage: nothing more."""
        self._doing = {"type": "doing", "who": who, "stage": stage, "done": done, "total": total}
        self.tell(self._doing)

    # ---------- changes

    def handle(self, text: bytes) -> None:
        """Do what a browser asks for. Raises InputError if it cannot be done."""
        message = read_message(text)
        if isinstance(message, Undo):
            self._undo()
        elif isinstance(message, Redo):
            self._redo()
        elif isinstance(message, Revert):
            self._go_to(self.history.reverted(message.gesture))
        elif isinstance(message, Ask):
            self._ask(message)
        elif isinstance(message, Cancel):
            self._spawn(asyncio.to_thread(self._advice.stop))
        elif isinstance(message, TakeProposal):
            self._take(message)
        elif isinstance(message, DropProposal):
            self._proposals = [each for each in self._proposals if each.number != message.number]
            self.tell(self._proposals_message())
        elif isinstance(message, ShowCoverage):
            self._shows_coverage = message.is_shown
            self._changed.set()
        elif isinstance(message, ChooseSensors):
            for name in message.names:  # files are not named by browsers
                pick(self._models, name, "sensors")
            self._chosen = message.names
            self.tell({"type": "sensors", "grid": self._chosen})
        else:
            state = change_state(self.history.state, message, self._stock())
            gesture = message.gesture if isinstance(message, ChangeUnit) else ""
            self._go_on(state, gesture=gesture)

    def lay_background(self, background: Background | None) -> None:
        """Show another image below the plan, or none."""
        self.background = background
        self.tell(background_message(self.background))
        self._changed.set()  # it is kept when the plan rests

    def open_plan(self, plan: Plan, source: str) -> None:
        """Add variants from a file; an only one that is empty gives way to them.

        `source` is the file's name, for variants whose own name is taken. Raises InputError if a
        unit cannot be mounted in this scene, or there are too many.
        """
        check_plan(plan, self.setting.scene)
        state = self.history.state
        if len(state.variants) == 1 and not state.variant.units:
            state = begin_history(plan.variants).state
        else:
            for variant in plan.variants:
                state = add_variant(state, variant, source=source)
        if plan.background is not None:
            self.lay_background(plan.background)
        self._go_on(state)

    def _go_on(self, state: PlanState, *, gesture: str = "") -> None:
        """One state further."""
        self._later.clear()
        self._go_to(self.history.went_on(state, gesture=gesture))

    def _go_to(self, history: History) -> None:
        self.history = history
        self.revision += 1
        self.tell(self._state_message())
        self._changed.set()
        self._moved.set()

    def _undo(self) -> None:
        if self.history.can_undo or not self._earlier:
            self._go_to(self.history.undone())
        else:
            self._later.append(self._visit())
            self._enter(self._earlier.pop())

    def _redo(self) -> None:
        if self.history.can_redo or not self._later:
            self._go_to(self.history.redone())
        else:
            self._earlier.append(self._visit())
            self._enter(self._later.pop())

    def _visit(self) -> Visit:
        return Visit(place=self.place, history=self.history, background=self.background)

    def _enter(self, visit: Visit, exact: Worker | None = None) -> None:
        """Go on in another scene; `exact` has read it already."""
        self._notice(self.keep_plan())
        self.stop_processes()
        self.place, self.history, self.background = visit.place, visit.history, visit.background
        self._exact = self._make_worker(self.work) if exact is None else exact
        self._advice = self._make_worker(self.work)
        self._proposals = []
        self._views.clear()
        self.tell(self._scene_message())
        self._go_to(self.history)
        self.tell(self._proposals_message())
        self.tell(background_message(self.background))

    # ---------- numbers

    async def _count(self) -> None:
        """Numbers of the newest state, at once: by the table unless the evaluator's are known."""
        while True:
            await self._changed.wait()
            self._changed.clear()
            place = self.place
            if place.live.n_mounts == 0:
                self._do("rays", "prepare the rays")
                await asyncio.to_thread(place.numbers_by_table, self._first_units())
                self._do("rays", "")
            revision, units = self.revision, self.history.state.variant.units
            try:
                numbers = place.known.get(key_of(units))
                if numbers is None:
                    numbers = await asyncio.to_thread(place.numbers_by_table, units)
                private = await asyncio.to_thread(place.private_areas, units)
                numbers = place.known.get(key_of(units), numbers)  # the evaluator was no slower
                self.tell({"type": "numbers", "revision": revision, **numbers, **private})
                self._tell_variants()
                if self._shows_coverage and not self._changed.is_set():
                    scene = place.setting.scene
                    found = await asyncio.to_thread(coverage_record, scene, units)
                    self.tell({"type": "coverage", "revision": revision, **found})
            except Cancelled:
                return
            except Exception as error:  # the next change may be one that can be counted
                self._notice(f"no numbers: {error}")
            self._rests.set()

    async def _look(self) -> None:
        """Views of all units that are shown; first of those whose rays have been cast."""
        while True:
            await self._moved.wait()
            self._moved.clear()
            while todo := self._without_view():
                place = self.place
                unit = next((each for each in todo if place.views.has_rays(each)), todo[0])
                found = await asyncio.to_thread(place.view_record, unit)
                if place is self.place:
                    self._views[unit.id] = key_of([unit]), {"type": "view", **found}
                    self.tell(self._views[unit.id][1])

    def _without_view(self) -> list[CandidatePose]:
        units = {unit.id: unit for unit in self.history.state.variant.units}
        self._views = {name: view for name, view in self._views.items() if name in units}
        drawn = {key for key, _ in self._views.values()}
        return [unit for unit in units.values() if key_of([unit]) not in drawn]

    def _first_units(self) -> tuple[CandidatePose, ...]:
        """A unit that is mounted nowhere: with it, all is got ready that the first drag needs."""
        model = self._chosen[0] if self._chosen else load_candidate_grid().sensors[0].name
        return first_units(self._stock(), model)

    async def private_view(self, unit_id: str) -> list[list[int]]:
        """Places of private ground that a unit has in its picture, see :class:`.place.Place`.

        Raises InputError if there is no such unit.
        """
        unit = next((u for u in self.history.state.variant.units if u.id == unit_id), None)
        if unit is None:
            raise InputError("unit", unit_id, "one that is mounted there")
        return await asyncio.to_thread(self.place.private_places, unit)

    async def _judge(self) -> None:
        """Numbers by the evaluator, of whatever is shown and rests: the newest first."""
        while True:
            await self._rests.wait()
            self._rests.clear()
            await asyncio.sleep(_REST_S)
            if self._rests.is_set() or self._changed.is_set():
                continue
            self._notice(self.keep_plan())
            for units in self._unknown():
                await self._evaluate(units)
                if self._rests.is_set():
                    break

    def _unknown(self) -> list[tuple[CandidatePose, ...]]:
        """Layouts that are shown and not evaluated yet, the one that is worked on first."""
        state = self.history.state
        shown = [each.units for each in (state.variant, *state.variants)]
        shown += [each.units for each in self._proposals]
        shown.append(self._first_units())  # so that the car's own sensors are known
        found = {key_of(units): units for units in shown if units}
        return [
            units
            for key, units in found.items()
            if key not in self.place.known and key not in self.place.failed
        ]

    async def _evaluate(self, units: tuple[CandidatePose, ...]) -> None:
        key, place = key_of(units), self.place
        layout = Layout(name="plan", units=units, scene_name=self.setting.scene.name)
        self._do("evaluator", "evaluate")
        try:
            numbers = await self._exact.call(
                "evaluate", layout, on_progress=self._stages("evaluator")
            )
        except Cancelled:
            return
        except TaskError as error:
            if isinstance(error, DiedError) and key not in place.died:
                place.died.add(key)  # once more, by a new process
                self._notice(f"{error}; it is tried again")
                self._rests.set()
                return
            place.failed[key] = str(error)
            self._notice(f"not evaluated: {error}")
            return
        finally:
            self._do("evaluator", "")
        place.learn(units, numbers)
        if place is not self.place:  # another scene was opened meanwhile
            return
        if key == key_of(self.history.state.variant.units):
            revision = self.revision
            private = await asyncio.to_thread(place.private_areas, units)
            self.tell({"type": "numbers", "revision": revision, **numbers, **private})
        self._tell_variants()
        self.tell(self._proposals_message())

    def _stages(self, who: str) -> Callable[[str, int, int], None]:
        return lambda stage, done, total: self._do(who, stage, done, total)

    def _tell_variants(self) -> None:
        """What all variants achieve, as far as that is known."""
        self.tell(
            {
                "type": "variants",
                "variants": [
                    {"name": variant.name, **self._summary(variant.units)}
                    for variant in self.history.state.variants
                ],
            }
        )

    def _summary(self, units: Sequence[CandidatePose]) -> dict[str, Any]:
        key = key_of(units)
        numbers = self.place.known.get(key)
        cost = cost_record(units, self.setting.scene)
        return {
            "units": len(units),
            "cost": cost["all"] if cost else "",
            "apr": numbers["apr"] if numbers else self.place.by_table.get(key, ""),
            "source": "evaluator" if numbers else "table" if key in self.place.by_table else "none",
            "byCase": numbers["byCase"] if numbers else {},
            "oneFails": numbers["oneFails"] if numbers else "",
            "problem": self.place.failed.get(key, ""),
        }

    def keep_plan(self) -> str:
        """Write the plan to its file, if there is one; returns what went wrong.

        An empty plan makes no file.
        """
        save = self.place.save
        is_empty = self.background is None and self.history.state.is_empty
        if save is None or (is_empty and not save.exists()):
            return ""
        text = self.plan_text()
        try:
            write_atomically(save, text)
        except OSError as error:
            return f"not saved: {save}: {error.strerror or error}"
        return ""

    def saved_files(self) -> list[str]:
        """Files of the plans of this session, in the order of their scenes."""
        places = [visit.place for visit in (*self._earlier, self._visit(), *self._later[::-1])]
        return [str(place.save) for place in places if place.save and place.save.exists()]

    # ---------- the optimiser

    def _ask(self, ask: Ask) -> None:
        if self._advice.is_busy:
            raise InputError("the optimiser", Unquoted("another request"), "one at a time")
        self._spawn(self._advise(ask, self.history.state.variant.units))

    async def _advise(self, ask: Ask, units: tuple[CandidatePose, ...]) -> None:
        tell = self._stages("optimiser")
        words = [self._words[name] for name in self._chosen]
        tell("start", 0, 0)
        try:
            await self._advice.call("choose_sensors", ",".join(words), on_progress=tell)
            answers = await self._advice.call(
                "advise", units, ask.request, n_units=ask.units, site=ask.site, on_progress=tell
            )
        except Cancelled:
            self._notice("The optimiser was stopped.")
            return
        except TaskError as error:
            self._notice(str(error))
            return
        finally:
            self._do("optimiser", "")
        place = self.place
        for answer in answers:
            views = await asyncio.to_thread(view_paths, answer["units"], place.views)
            if place is not self.place:
                return
            proposal = Proposal(
                number=next(self._numbers_of_proposals),
                title=answer["title"],
                words=answer["words"],
                units=answer["units"],
                views=tuple(views),
                fields={name: answer[name] for name in ("apr", "bound", "isProven")},
            )
            self._proposals = [*self._proposals, proposal][-_MAX_PROPOSALS:]
        self.tell(self._proposals_message())
        self._rests.set()

    def _proposals_message(self) -> dict[str, Any]:
        scene = self.setting.scene
        records = [each.record(self._summary(each.units), scene) for each in self._proposals]
        return {"type": "proposals", "proposals": records}

    def _take(self, message: TakeProposal) -> None:
        proposal = next((each for each in self._proposals if each.number == message.number), None)
        if proposal is None:
            raise InputError("proposal", message.number, "one that is shown")
        state = self.history.state
        if message.as_variant:
            state = add_variant(state, Variant(name=proposal.title, units=proposal.units))
        else:
            state = state.with_units(proposal.units)
        self._proposals = [each for each in self._proposals if each is not proposal]
        self._go_on(state)
        self.tell(self._proposals_message())

    # ---------- what is asked for by address

    def plan_text(self) -> bytes:
        """The plan as a file has it."""
        return plan_text(self.history.state, self.setting.scene, self.background).encode()

    def layout(self) -> Layout:
        """The layout that is worked on. Raises InputError if nothing hangs."""
        return self.history.state.variant.layout(self.setting.scene)

    async def call(self, method: str, *args: Any, is_long: bool = False) -> Any:
        """What a task returns, by the evaluator's process, or the optimiser's if it takes long.

        Raises TaskError, or Cancelled.
        """
        worker, who = (self._advice, "optimiser") if is_long else (self._exact, "evaluator")
        try:
            return await worker.call(method, *args, on_progress=self._stages(who))
        finally:
            self._do(who, "")

    async def open_scene(self, path: str, title: str = "") -> None:
        """Go on in another scene, from nothing; Undo leads back.

        Raises TaskError if it has no runs. Where the plan is kept in a file, the new scene's gets
        another one.
        """
        work = replace(self.work, question=replace(self.work.question, scene=path))
        exact = self._make_worker(work)
        try:
            setting: Setting = await exact.call("open_setting", on_progress=self._stages("scene"))
            save = None if self.place.save is None else free_path(self.place.save)
            place, notice = await asyncio.to_thread(
                build_place, work, setting, title=title, save=save
            )
        except BaseException:
            exact.stop()
            raise
        finally:
            self._do("scene", "")
        if notice:
            exact.stop()
            exact = self._make_worker(place.work)
        self._notice(notice)
        self._later.clear()
        self._earlier = [*self._earlier, self._visit()][-_MAX_PLACES:]
        self._enter(Visit(place=place, history=begin_history(()), background=None), exact)
        if save is not None:
            before = self._earlier[-1].place
            self._notice(f"The plan at {before.title} is in {before.save}; this one: {save}.")
