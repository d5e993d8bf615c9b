"""The desk that several browsers look at: one session, its numbers, and what is worked on."""

import asyncio
import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from geometry.catalogue import Sensor, load_cameras
from geometry.errors import InputError, Unquoted
from geometry.files import pick, write_atomically
from geometry.lidar import load_lidars
from placement.candidates import CandidatePose
from placement.compute import Compute
from placement.layout import Layout, check_layout
from placement.live import LiveTable, table_verdict
from placement.planning import build_grid
from placement.private_ground import PrivateGround, PrivateSight, load_private_ground
from placement.setting import Setting

from ..report.interactive.records import unit_records
from .background import MAX_BYTES as MAX_IMAGE_BYTES
from .background import Background, background_message
from .messages import (
    Ask,
    Cancel,
    ChooseSensors,
    DropProposal,
    ShowCoverage,
    TakeProposal,
    read_message,
)
from .numbers import (
    cost_record,
    coverage_record,
    key_of,
    plan_text,
    private_record,
    scene_record,
    state_record,
    table_numbers,
)
from .session import (
    AddUnit,
    ChangeUnit,
    History,
    Plan,
    Redo,
    Stock,
    Undo,
    Variant,
    add_variant,
    begin_history,
    change_state,
)
from .tasks import Work
from .worker import Cancelled, DiedError, TaskError, Worker

Listener = Callable[[dict[str, Any]], None]

MAX_PLAN_BYTES = 16_000_000
MAX_MAP_BYTES = 300_000_000
"""Of files that browsers send."""

_REST_S = 0.3  # without a change, before pixels are asked
_MAX_KNOWN = 300  # of layouts by the evaluator
_MAX_PROPOSALS = 12
_MAX_ALONE = 60  # units of which each one's own APR is told while something is dragged


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Proposal:
    """An answer of the optimiser, beside one's own plan."""

    number: int
    title: str
    words: str
    units: tuple[CandidatePose, ...]
    fields: dict[str, Any]


def _words_of(sensors: str) -> dict[str, str]:
    """By the name of each model that may be mounted, how ``--sensors`` calls it."""
    words = {name: name for name in (*load_cameras(), *load_lidars())}
    for word in filter(None, sensors.split(",")):
        for model in build_grid(word).sensors:
            words[model.name] = f"{word}:{model.name}" if word.endswith(".toml") else word
    return words


_Private = tuple[PrivateGround | None, PrivateSight | None]


class Desk:
    """One session: what is planned, who looks at it, and the processes that work for it.

    All methods but :meth:`stop_processes` are called from the server's event loop.

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
        self.work, self.setting, self._make_worker = work, setting, make_worker
        self.history: History = begin_history(plan.variants if plan else ())
        self.background: Background | None = plan.background if plan else None
        self.revision = 0
        self.listeners: set[Listener] = set()
        self.left_at_s: float | None = None  # since when nobody looks, who looked before
        self.is_lost = False
        self._ground, self._sight = self._private_ground(work, setting)
        self._sight_turn = asyncio.Lock()
        self._save = save
        self._exact, self._advice = make_worker(work), make_worker(work)
        self._live = self._new_table()
        self._known: OrderedDict[tuple[object, ...], dict[str, Any]] = OrderedDict()
        self._failed: dict[tuple[object, ...], str] = {}
        self._died: set[tuple[object, ...]] = set()
        self._by_table: dict[tuple[object, ...], str] = {}
        self._proposals: list[Proposal] = []
        self._numbers_of_proposals = count(1)
        self._words = _words_of(work.question.sensors)
        self._models: dict[str, Sensor] = {
            model.name: model for word in self._words.values() for model in build_grid(word).sensors
        }
        self._chosen: list[str] = [
            sensor.name for sensor in build_grid(work.question.sensors).sensors
        ]
        self._shows_coverage = False
        self._changed, self._rests = asyncio.Event(), asyncio.Event()
        self._tasks: set[asyncio.Task[None]] = set()
        self._doing: dict[str, Any] = {}

    @staticmethod
    def _private_ground(work: Work, setting: Setting) -> _Private:
        """Areas of ``--no-look`` in a scene. Raises InputError if they cannot lie there."""
        if not work.question.no_look:
            return None, None
        ground = load_private_ground(Path(work.question.no_look), setting.scene)
        return ground, PrivateSight(setting.scene, ground)

    def _new_table(self) -> LiveTable:
        compute = Compute(seed=self.work.seed, workers=self.work.workers, rays=self.work.rays)
        return LiveTable(self.setting, compute=compute)

    # ---------- life

    def start(self) -> None:
        """Begin to count and to judge."""
        for loop in (self._count(), self._judge()):
            self._spawn(loop)
        self._changed.set()

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

    def join(self, listener: Listener) -> None:
        """A browser comes: it is told all that there is."""
        self.listeners.add(listener)
        self.left_at_s = None
        listener(self._scene_message())
        listener(self._state_message())
        listener(self._proposals_message())
        listener(background_message(self.background))
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
                ground=self._ground,
            ),
            "isKept": self._save is not None,
            "mostBytes": {"plan": MAX_PLAN_BYTES, "map": MAX_MAP_BYTES, "image": MAX_IMAGE_BYTES},
        }

    def _stock(self) -> Stock:
        return Stock(scene=self.setting.scene, models=self._models)

    def _state_message(self) -> dict[str, Any]:
        record = state_record(self.history, self.setting.scene)
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
            self._go_to(self.history.undone())
        elif isinstance(message, Redo):
            self._go_to(self.history.redone())
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
            self._go_to(self.history.went_on(state, gesture=gesture))

    def lay_background(self, background: Background | None) -> None:
        """Show another image below the plan, or none."""
        self.background = background
        self.tell(background_message(self.background))
        self._changed.set()  # it is kept when the plan rests

    def open_plan(self, plan: Plan) -> None:
        """Add variants from a file; an only one that is empty gives way to them.

        Raises InputError if a unit cannot hang in this scene, or there are too many.
        """
        variants = plan.variants
        for variant in variants:
            if variant.units:
                check_layout(variant.layout(self.setting.scene), self.setting.scene)
        state = self.history.state
        if len(state.variants) == 1 and not state.variant.units:
            state = begin_history(variants).state
        else:
            for variant in variants:
                state = add_variant(state, variant)
        if plan.background is not None:
            self.lay_background(plan.background)
        self._go_to(self.history.went_on(state))

    def _go_to(self, history: History) -> None:
        self.history = history
        self.revision += 1
        self.tell(self._state_message())
        self._changed.set()

    # ---------- numbers

    async def _count(self) -> None:
        """Numbers of the newest state, at once: by the table unless the evaluator's are known."""
        while True:
            await self._changed.wait()
            self._changed.clear()
            live = self._live
            if live.n_mounts == 0:
                self._do("rays", "prepare the rays")
                await asyncio.to_thread(self._by_rays, live, self._first_units())
                self._do("rays", "")
            revision, units = self.revision, self.history.state.variant.units
            try:
                numbers = self._known.get(key_of(units))
                if numbers is None:
                    numbers = await asyncio.to_thread(self._by_rays, live, units)
                private = await self._private(units)
                numbers = self._known.get(key_of(units), numbers)  # the evaluator was no slower
                self.tell({"type": "numbers", "revision": revision, **numbers, **private})
                self._tell_variants()
                if self._shows_coverage and not self._changed.is_set():
                    found = await asyncio.to_thread(coverage_record, self.setting.scene, units)
                    self.tell({"type": "coverage", "revision": revision, **found})
            except Exception as error:  # the next change may be one that can be counted
                self.tell({"type": "notice", "text": f"no numbers: {error}"})
            self._rests.set()

    def _first_units(self) -> tuple[CandidatePose, ...]:
        """A unit that hangs nowhere: with it, all is got ready that the first drag needs."""
        scene = self.setting.scene
        free = [site.id for site in scene.sites if site.use != "forbidden"]
        model = self._chosen[0] if self._chosen else build_grid("").sensors[0].name
        if not free:
            return ()
        empty = begin_history(()).state
        return change_state(empty, AddUnit(site=free[0], sensor=model), self._stock()).variant.units

    def _by_rays(self, live: LiveTable, units: Sequence[CandidatePose]) -> dict[str, Any]:
        if not units:
            return {"source": "none"}
        detected = live.detected(units)
        together = table_verdict(units, detected, self.setting)
        alone = {
            unit.id: table_verdict([unit], detected[index : index + 1], self.setting)
            for index, unit in enumerate(units[:_MAX_ALONE])
        }
        numbers = table_numbers(units[:_MAX_ALONE], together, alone, self.setting)
        self._by_table[key_of(units)] = numbers["apr"]
        return numbers

    async def _private(self, units: Sequence[CandidatePose]) -> dict[str, Any]:
        """Private areas in view, as a part of the numbers; nothing without any area."""
        ground, sight = self._ground, self._sight
        if ground is None or sight is None:
            return {}
        allowed = self.work.question.no_look_share or 0.0
        async with self._sight_turn:
            found = await asyncio.to_thread(private_record, units, ground, sight, max_share=allowed)
        return {"private": found}

    async def private_view(self, unit_id: str) -> list[list[int]]:
        """Places of private ground that a unit has in its picture, a metre apart, centimetres.

        Raises InputError if there is no such unit.
        """
        unit = next((u for u in self.history.state.variant.units if u.id == unit_id), None)
        if unit is None:
            raise InputError("unit", unit_id, "one that hangs there")
        if self._ground is None or self._sight is None:
            return []
        async with self._sight_turn:
            seen = await asyncio.to_thread(self._sight.seen, unit)
        places: list[list[int]] = (
            np.rint(100.0 * self._ground.points_m[seen, :2]).astype(int).tolist()
        )
        return places

    async def _judge(self) -> None:
        """Numbers by the evaluator, of whatever is shown and rests: the newest first."""
        while True:
            await self._rests.wait()
            self._rests.clear()
            await asyncio.sleep(_REST_S)
            if self._rests.is_set() or self._changed.is_set():
                continue
            self._write_plan()
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
            if key not in self._known and key not in self._failed
        ]

    async def _evaluate(self, units: tuple[CandidatePose, ...]) -> None:
        key, setting = key_of(units), self.setting
        layout = Layout(name="plan", units=units, scene_name=setting.scene.name)
        self._do("evaluator", "evaluate")
        try:
            numbers = await self._exact.call(
                "evaluate", layout, on_progress=self._stages("evaluator")
            )
        except Cancelled:
            return
        except TaskError as error:
            if isinstance(error, DiedError) and key not in self._died:
                self._died.add(key)  # once more, by a new process
                self.tell({"type": "notice", "text": f"{error}; it is tried again"})
                self._rests.set()
                return
            self._failed[key] = str(error)
            self.tell({"type": "notice", "text": f"not evaluated: {error}"})
            return
        finally:
            self._do("evaluator", "")
        if setting is not self.setting:  # another scene was opened meanwhile
            return
        self._known[key] = numbers
        while len(self._known) > _MAX_KNOWN:
            self._known.popitem(last=False)
        if key == key_of(self.history.state.variant.units):
            revision, private = self.revision, await self._private(units)
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
        numbers = self._known.get(key)
        cost = cost_record(units, self.setting.scene)
        return {
            "units": len(units),
            "cost": cost["all"] if cost else "",
            "apr": numbers["apr"] if numbers else self._by_table.get(key, ""),
            "source": "evaluator" if numbers else "table" if key in self._by_table else "none",
            "byCase": numbers["byCase"] if numbers else {},
            "oneFails": numbers["oneFails"] if numbers else "",
            "problem": self._failed.get(key, ""),
        }

    def _write_plan(self) -> None:
        if self._save is None:
            return
        text = self.plan_text()
        try:
            write_atomically(self._save, text)
        except OSError as error:
            self.tell({"type": "notice", "text": f"not saved: {error.strerror or error}"})

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
            self.tell({"type": "notice", "text": "The optimiser was stopped."})
            return
        except TaskError as error:
            self.tell({"type": "notice", "text": str(error)})
            return
        finally:
            self._do("optimiser", "")
        for answer in answers:
            proposal = Proposal(
                number=next(self._numbers_of_proposals),
                title=answer["title"],
                words=answer["words"],
                units=answer["units"],
                fields={name: answer[name] for name in ("apr", "bound", "isProven")},
            )
            self._proposals = [*self._proposals, proposal][-_MAX_PROPOSALS:]
        self.tell(self._proposals_message())
        self._rests.set()

    def _proposals_message(self) -> dict[str, Any]:
        scene = self.setting.scene
        return {
            "type": "proposals",
            "proposals": [
                {
                    "number": each.number,
                    "title": each.title,
                    "words": each.words,
                    **each.fields,
                    **self._summary(each.units),
                    "onTable": each.fields["apr"],
                    "drawn": unit_records(
                        Layout(name=each.title, units=each.units, scene_name=scene.name), scene
                    ),
                }
                for each in self._proposals
            ],
        }

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
        self._go_to(self.history.went_on(state))
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

    async def open_scene(self, path: str) -> None:
        """Go on in another scene, from nothing. Raises TaskError if it has no runs."""
        work = replace(self.work, question=replace(self.work.question, scene=path))
        exact = self._make_worker(work)
        try:
            setting: Setting = await exact.call("open_setting", on_progress=self._stages("scene"))
            ground, sight = None, None
            try:
                ground, sight = await asyncio.to_thread(self._private_ground, work, setting)
            except InputError as error:  # of another place: the scene can be planned without them
                question = replace(work.question, no_look="", no_look_share=None)
                work = replace(work, question=question)
                exact.stop()
                exact = self._make_worker(work)
                self.tell({"type": "notice", "text": f"without private areas: {error}"})
        except BaseException:
            exact.stop()
            raise
        finally:
            self._do("scene", "")
        self.stop_processes()
        self.work, self.setting = work, setting
        self._ground, self._sight = ground, sight
        self._exact, self._advice = exact, self._make_worker(work)
        self._live = self._new_table()
        for known in (self._known, self._failed, self._by_table, self._died):
            known.clear()
        self._proposals = []
        self.history, self.background = begin_history(()), None
        self.revision += 1
        self.tell(self._scene_message())
        self.tell(self._state_message())
        self.tell(self._proposals_message())
        self.tell(background_message(self.background))
        self._changed.set()
