"""One session of the page, shared by several browsers: the plan, its numbers, the work on it."""

import asyncio
import threading
import time
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from geometry.catalogue import Sensor, load_cameras
from geometry.errors import InputError, refuse
from geometry.files import pick, write_atomically
from geometry.junction import street_names
from geometry.lidar import load_lidars
from geometry.scene import Scene
from placement.candidates import CandidatePose, build_grid, load_candidate_grid, own_models
from placement.ground import PrivateGround, PrivateSight, load_private_ground
from placement.layout import Layout
from placement.live import LiveTable, table_verdict
from placement.question import Question
from placement.setting import Setting

from ..figures.views import GroundViews
from ..language import mark, tr, tr_error
from ..parts.camera_views import live_picture
from ..parts.player import centimetres, svg_path, unit_records
from . import plan
from .numbers import (
    TileServer,
    change_question,
    cost_record,
    coverage_record,
    key_of,
    plan_text,
    private_record,
    question_record,
    scene_record,
    state_record,
    table_numbers,
    tile_frame,
)
from .plan import Background, History, Plan, Variant
from .tasks import Cancelled, DiedError, TaskError, Work, Worker

Listener = Callable[[dict[str, Any]], None]
Key = tuple[object, ...]

MAX_MAP_BYTES = 300_000_000
"""Of a file that a browser sends."""
MAX_ALONE = 60
"""Units of which each one's own APR is shown while something is dragged."""

_REST_S = 0.3  # without a change, before pixels are asked
_MAX_PROPOSALS = 12
_MAX_WORKSPACES = 5  # with those that Undo leads back to
_AT_ONCE = 16  # units between two looks whether anybody waits
_MAX_KNOWN = 300  # layouts by the evaluator

# ---------- a scene and its numbers


class Workspace:
    """A scene in which somebody plans: rays, views, private ground, and numbers known so far.

    `title` is for people, such as the streets that meet; by default the scene's name. `save` gets
    the plan whenever it rests. Raises InputError: areas of ``--no-look`` cannot lie in this scene.
    """

    def __init__(
        self, work: Work, setting: Setting, *, title: str = "", save: Path | None = None
    ) -> None:
        self.work, self.setting, self.save = work, setting, save
        self.title = title or setting.scene.name
        self.background: Background | None = None
        self.ground: PrivateGround | None = None
        self._sight: PrivateSight | None = None
        if work.question.no_look:
            self.ground = load_private_ground(Path(work.question.no_look), setting.scene)
            self._sight = PrivateSight(setting.scene, self.ground)
        self._sight_turn = threading.Lock()
        self.live = LiveTable(setting, compute=work.compute)
        self.views = GroundViews(setting)
        self.is_over = threading.Event()  # nobody waits for numbers any longer
        self.known: OrderedDict[Key, dict[str, Any]] = OrderedDict()  # by the evaluator
        self.failed: dict[Key, str] = {}
        self.died: set[Key] = set()  # layouts at which the evaluator's process died
        self.by_table: dict[Key, str] = {}

    def learn(self, units: Sequence[CandidatePose], numbers: dict[str, Any]) -> None:
        """Remember numbers by the evaluator."""
        self.known[key_of(units)] = numbers
        while len(self.known) > _MAX_KNOWN:
            self.known.popitem(last=False)

    def numbers_by_table(self, units: Sequence[CandidatePose]) -> dict[str, Any]:
        """Numbers by the detection table, by one thread; Cancelled soon after `is_over` was set."""
        if not units:
            return {"source": "none"}
        rows = []
        for first in range(0, len(units), _AT_ONCE):
            if self.is_over.is_set():
                raise Cancelled
            rows.append(self.live.detected(units[first : first + _AT_ONCE]))
        detected = np.concatenate(rows)
        sees = self.setting.cars == 1.0
        together = table_verdict(units, detected, self.setting, with_vut=sees)
        alone = {
            unit.id: table_verdict([unit], detected[index : index + 1], self.setting)
            for index, unit in enumerate(units[:MAX_ALONE])
        }
        numbers = table_numbers(units[:MAX_ALONE], together, alone, self.setting)
        self.by_table[key_of(units)] = numbers["apr"]
        return numbers

    def private_areas(self, units: Sequence[CandidatePose]) -> dict[str, Any]:
        """Private areas in view, as a part of the numbers; nothing without any area."""
        if self.ground is None or self._sight is None:
            return {}
        allowed = self.work.question.no_look_share or 0.0
        with self._sight_turn:
            found = private_record(units, self.ground, self._sight, max_share=allowed)
        return {"private": found}

    def private_places(self, unit: CandidatePose) -> list[list[int]]:
        """Places of private ground that a unit has in its picture, a metre apart, centimetres."""
        if self.ground is None or self._sight is None:
            return []
        with self._sight_turn:
            seen = self._sight.seen(unit)
        places: list[list[int]] = centimetres(self.ground.points_m[seen, :2])
        return places

    def view_paths(self, units: Sequence[CandidatePose]) -> list[str]:
        """Ground on which each unit can detect a road user, as SVG paths in centimetres."""
        return [svg_path(self.views.shape(unit)) for unit in units]

    def view_record(self, unit: CandidatePose) -> dict[str, Any]:
        """A unit's view on the ground, where it looks from, and how far its detector reaches."""
        return {
            "unit": unit.id,
            "place": centimetres(unit.pose.position_m[:2]),
            "view": self.view_paths([unit])[0],
            "reachM": self.views.reach_m(unit.sensor),
        }


def build_workspace(
    work: Work, setting: Setting, *, title: str, save: Path | None
) -> tuple[Workspace, str]:
    """A workspace, without private areas where they are of another scene; and a notice of that."""
    try:
        return Workspace(work, setting, title=title, save=save), ""
    except InputError as error:
        work = replace(work, question=replace(work.question, no_look="", no_look_share=None))
        notice = tr("without private areas: {reason}", reason=tr_error(error))
        return Workspace(work, setting, title=title, save=save), notice


def free_path(path: Path) -> Path:
    """A path that does not exist, made of another: with -2, -3 .. before the suffix."""
    number = 2
    while (found := path.with_name(f"{path.stem}-{number}{path.suffix}")).exists():
        number += 1
    return found


# ---------- proposals of the optimiser


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Proposal:
    """An answer of the optimiser."""

    number: int
    title: str
    words: str
    units: tuple[CandidatePose, ...]
    views: tuple[str, ...]  # of each unit, as an SVG path
    fields: dict[str, Any]

    def record(self, summary: dict[str, Any], scene: Scene) -> dict[str, Any]:
        """Its message to browsers; `summary` has the numbers known of its units."""
        layout = Layout(name=self.title, units=self.units, scene_name=scene.name)
        records = zip(unit_records(layout, scene), self.views, strict=True)
        return {
            **{"number": self.number, "title": self.title, "words": self.words},
            **self.fields,
            **summary,
            "onTable": self.fields["apr"],
            "drawn": [{"place": record["place"], "view": view} for record, view in records],
        }


def sensor_words(sensors: str) -> dict[str, str]:
    """Words of ``--sensors`` by the names of the models that may be mounted."""
    words = {name: name for name in (*load_cameras(), *load_lidars())}
    for word in filter(None, sensors.split(",")):
        for model in own_models(word).values():
            words[model.name] = f"{word}:{model.name}" if word.endswith(".toml") else word
    return words


# ---------- the session


@dataclass(frozen=True, slots=True, kw_only=True)
class MapFile:
    """A map or a scene that was named or sent; `found` is as :meth:`.tasks.Tasks.survey` tells."""

    path: Path
    name: str
    options: dict[str, Any] = field(default_factory=dict)  # of maps: sites, keeps_left
    found: dict[str, Any] = field(default_factory=dict)  # empty: nobody has looked yet


class Session:
    """The plan, the browsers that show it, and the processes that work for it.

    All methods but :meth:`stop` are called from the server's event loop. It begins with a plan, and
    `save` gets it whenever it rests.
    """

    def __init__(
        self,
        work: Work,
        setting: Setting,
        *,
        begun: Plan | None = None,
        save: Path | None = None,
        make_worker: Callable[[Work], Worker] = Worker,
        map_file: MapFile | None = None,
        tiles: TileServer | None = None,
    ) -> None:
        streets = street_names(setting.scene).values() if map_file else ()
        title = " / ".join(dict.fromkeys(streets))
        self.workspace = Workspace(work, setting, title=title, save=save)
        self.tiles = tiles
        self.map_file = map_file  # that the scene is of, or that was sent last
        self._make_worker = make_worker
        self.workspace.background = begun.background if begun else None
        first = plan.begin_history(begun.variants if begun else (), self.workspace).state
        first = plan.lay_poles(first, begun.poles if begun else (), setting.scene)
        self.history = History(states=(first,))
        self._saves = [save] if save else []
        self.revision = 0
        self.listeners: set[Listener] = set()
        self.left_at_s: float | None = None  # since when nobody looks, who looked before
        self.is_lost = False
        self._exact, self._advice = make_worker(work), make_worker(work)
        self._reader = make_worker(work)  # of maps, which it remembers
        self._opening: Worker | None = None  # who works at another scene that is to come
        self._begun = work.question
        # The question that is to come, and whose worker builds its setting
        self._coming: tuple[Question, Worker | None] = work.question, None
        self._proposals: list[Proposal] = []
        self._numbers_of_proposals = count(1)
        self._words = sensor_words(work.question.sensors)
        self._models: dict[str, Sensor] = {
            model.name: model
            for word in self._words.values()
            for model in own_models(word).values()
        }
        self._chosen: list[str] = [sensor.name for sensor in build_grid(work.question).sensors]
        self._shows_coverage = False
        self._changed, self._rests, self._moved = asyncio.Event(), asyncio.Event(), asyncio.Event()
        self._views: dict[str, tuple[Key, dict[str, Any]]] = {}  # by unit, with its pose
        self._picture_turn, self._newest_picture = asyncio.Lock(), object()
        self._tasks: set[asyncio.Task[None]] = set()
        self._doing: dict[str, Any] = {}

    @property
    def work(self) -> Work:
        """Question and files of the session."""
        return self.workspace.work

    @property
    def setting(self) -> Setting:
        """Scene and runs."""
        return self.workspace.setting

    @property
    def scene(self) -> Scene:
        """The scene with the poles of one's own."""
        return plan.with_poles(self.setting.scene, self.history.state.poles)

    # ---------- life

    def start(self) -> None:
        """Begin to count and to judge."""
        for loop in (self._count(), self._judge(), self._look()):
            self._spawn(loop)
        self._changed.set()
        self._moved.set()

    def stop(self) -> None:
        """End all work, here and in other processes; from any thread."""
        self.workspace.is_over.set()
        self.stop_processes()

    def stop_processes(self) -> None:
        """End everything that works in other processes; from any thread."""
        for worker in (self._exact, self._advice, self._coming[1], self._reader, self._opening):
            if worker is not None:
                worker.stop()

    def _spawn(self, work: Any) -> None:
        task = asyncio.get_running_loop().create_task(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    # ---------- talk

    def send(self, message: dict[str, Any]) -> None:
        """Send a message to every browser."""
        for listener in [*self.listeners]:
            listener(message)

    def _notice(self, text: str) -> None:
        if text:
            self.send({"type": "notice", "text": text})

    def join(self, listener: Listener) -> None:
        """Add a browser, and send it everything."""
        self.listeners.add(listener)
        self.left_at_s = None
        listener(self._scene_message())
        listener(self._question_message())
        listener(self._state_message())
        listener(self._proposals_message())
        listener(plan.background_message(self.workspace.background))
        for _, view in self._views.values():
            listener(view)
        if self._doing:
            listener(self._doing)
        self._changed.set()

    def leave(self, listener: Listener, *, is_lost: bool = False) -> None:
        """Remove a browser: its page was closed, or the connection to it is lost."""
        self.listeners.discard(listener)
        if not self.listeners:
            self.left_at_s, self.is_lost = time.monotonic(), is_lost

    def _scene_message(self) -> dict[str, Any]:
        models, ground = [*self._models.values()], self.workspace.ground
        record = scene_record(self.setting, models=models, chosen=self._chosen, ground=ground)
        tiles = None
        if self.tiles is not None:
            given = {"template": self.tiles.template, "attribution": self.tiles.attribution}
            tiles = {**given, "frame": tile_frame(self.setting.scene)}
        return {
            "type": "scene",
            **record,
            "tiles": tiles,
            "title": self.workspace.title,
            "isKept": self.workspace.save is not None,
            "map": "" if self.map_file is None else self.map_file.name,
            "assumed": [
                tr(one.words) for one in self.setting.scene.notes if one.kind == "junction"
            ],
            "mostBytes": {
                **{"plan": plan.MAX_PLAN_BYTES, "map": MAX_MAP_BYTES},
                "image": plan.MAX_IMAGE_BYTES,
            },
        }

    def _question_message(self) -> dict[str, Any]:
        return {"type": "question", **question_record(self.work.question, self._begun)}

    def _stock(self) -> plan.Stock:
        return plan.Stock(scene=self.scene, models=self._models)

    def _state_message(self) -> dict[str, Any]:
        record = state_record(self.history, self.scene)
        return {"type": "state", "revision": self.revision, **record}

    def _do(self, who: str, stage: str, done: int = 0, total: int = 0) -> None:
        """Show the stage of some work; empty: it has ended."""
        self._doing = {"type": "doing", "who": who, "stage": tr(stage)}
        self._doing |= {"done": done, "total": total}
        self.send(self._doing)

    # ---------- changes

    def handle(self, text: bytes) -> None:
        """Carry out a request. Raises InputError if that cannot be done."""
        message = plan.read_message(text)
        match message:
            case plan.Undo():
                self._go_to(self.history.undone())
            case plan.Redo():
                self._go_to(self.history.redone())
            case plan.Revert(gesture=gesture):
                self._go_to(self.history.reverted(gesture))
            case plan.ChangeQuestion():
                before = self.work.question if self._coming[1] is None else self._coming[0]
                self._ask(change_question(before, message, self._begun))
            case plan.Ask():
                if self._advice.is_busy:
                    refuse(mark("the optimiser"), mark("another request"), mark("one at a time"))
                self._spawn(self._advise(message, self.history.state.variant.units))
            case plan.Cancel():
                self._spawn(asyncio.to_thread(self._advice.stop))
            case plan.CancelOpening():
                stopped, self._opening = self._opening, None
                if stopped is not None:
                    self._spawn(asyncio.to_thread(stopped.stop))
            case plan.TakeProposal():
                self._take(message)
            case plan.DropProposal(number=number):
                self._proposals = [each for each in self._proposals if each.number != number]
                self.send(self._proposals_message())
            case plan.ShowCoverage(is_shown=is_shown):
                self._shows_coverage = is_shown
                self._changed.set()
            case plan.ChooseSensors(names=names):
                for name in names:  # files are not named by browsers
                    pick(self._models, name, mark("sensors"))
                self._chosen = names
                self.send({"type": "sensors", "grid": self._chosen})
            case _:
                state = plan.change_state(self.history.state, message, self._stock())
                gesture = message.gesture if isinstance(message, plan.ChangeUnit) else ""
                self._go_to(self.history.went_on(state, gesture=gesture))

    def lay_background(self, background: Background | None) -> None:
        """Show another image below the plan, or none."""
        self.workspace.background = background
        self.send(plan.background_message(background))
        self._changed.set()  # saved when the plan rests

    def open_plan(self, opened: Plan, source: str) -> None:
        """Add variants from a file; an only one that is empty gives way to them.

        `source`, the file's name, tells those apart whose own name is taken. Raises InputError if a
        unit cannot be mounted in this scene, or there are too many.
        """
        plan.check_plan(opened, self.setting.scene)
        state = self.history.state
        if len(state.variants) == 1 and not state.variant.units:
            state = replace(
                plan.begin_history(opened.variants, self.workspace).state, poles=state.poles
            )
        else:
            for variant in opened.variants:
                state = plan.add_variant(state, variant, source=source)
        state = plan.lay_poles(state, opened.poles, self.setting.scene)
        if opened.background is not None:
            self.lay_background(opened.background)
        self._go_to(self.history.went_on(state))

    def _go_to(self, history: History, exact: Worker | None = None) -> None:
        """Show the state of a history; `exact` has read its scene already, if that is another."""
        is_elsewhere = history.state.workspace is not self.workspace
        if is_elsewhere:
            self._notice(self.save_plan())
            for worker in filter(None, (self._exact, self._advice, self._coming[1])):
                worker.stop()
            self.workspace = history.state.workspace
            self._exact = self._make_worker(self.work) if exact is None else exact
            self._advice = self._make_worker(self.work)
            self._proposals = []
            self._views.clear()
            self.send(self._scene_message())
            self.send(self._question_message())
        self.history = history
        self.revision += 1
        self.send(self._state_message())
        if is_elsewhere:
            self.send(self._proposals_message())
            self.send(plan.background_message(self.workspace.background))
        self._changed.set()
        self._moved.set()

    # ---------- numbers

    async def _count(self) -> None:
        """Numbers of the newest state, at once: by the table unless the evaluator's are known."""
        while True:
            await self._changed.wait()
            self._changed.clear()
            workspace = self.workspace
            if workspace.live.n_casts == 0:
                self._do("rays", mark("prepare the rays"))
                await asyncio.to_thread(workspace.numbers_by_table, self._first_units())
                self._do("rays", "")
            if workspace is not self.workspace:  # another scene was opened meanwhile
                self._changed.set()
                continue
            revision, units = self.revision, self.history.state.variant.units
            try:
                numbers = workspace.known.get(key_of(units))
                if numbers is None:
                    numbers = await asyncio.to_thread(workspace.numbers_by_table, units)
                private = await asyncio.to_thread(workspace.private_areas, units)
                numbers = workspace.known.get(key_of(units), numbers)  # the evaluator was no slower
                self.send({"type": "numbers", "revision": revision, **numbers, **private})
                self._send_variants()
                if self._shows_coverage and not self._changed.is_set():
                    scene = workspace.setting.scene
                    found = await asyncio.to_thread(coverage_record, scene, units)
                    self.send({"type": "coverage", "revision": revision, **found})
            except Cancelled:
                return
            except Exception as error:  # the next change may be one that can be counted
                self._notice(tr("no numbers: {reason}", reason=tr_error(error)))
            self._rests.set()

    async def _look(self) -> None:
        """Views of all units that are shown; first of those whose rays have been cast."""
        while True:
            await self._moved.wait()
            self._moved.clear()
            while todo := self._without_view():
                workspace = self.workspace
                unit = next((each for each in todo if workspace.views.has_rays(each)), todo[0])
                found = await asyncio.to_thread(workspace.view_record, unit)
                if workspace is self.workspace:
                    self._views[unit.id] = key_of([unit]), {"type": "view", **found}
                    self.send(self._views[unit.id][1])

    def _without_view(self) -> list[CandidatePose]:
        units = self.history.state.variant.units
        ids = {unit.id for unit in units}
        self._views = {name: view for name, view in self._views.items() if name in ids}
        drawn = {key for key, _ in self._views.values()}
        return [unit for unit in units if key_of([unit]) not in drawn]

    def _first_units(self) -> tuple[CandidatePose, ...]:
        """A unit that is mounted nowhere: counting it prepares all that the first drag needs."""
        model = self._chosen[0] if self._chosen else load_candidate_grid().sensors[0].name
        return plan.first_units(self._stock(), model)

    async def camera_picture(self, unit_id: str, **shown: Any) -> dict[str, Any]:
        """What a camera sees as the newest state has it; see `live_picture`.

        Of those that wait for their turn only the newest is drawn. InputError: there is no such
        unit, run or frame. Cancelled: another one was asked for meanwhile.
        """
        self._newest_picture = asked = object()
        async with self._picture_turn:
            if asked is not self._newest_picture:
                raise Cancelled
            unit, given = self._unit(unit_id), {"compute": self.work.compute, **shown}
            return await asyncio.to_thread(live_picture, unit, self.setting, **given)

    def _unit(self, unit_id: str) -> CandidatePose:
        unit = next((u for u in self.history.state.variant.units if u.id == unit_id), None)
        if unit is None:
            raise InputError(mark("unit"), unit_id, mark("one that is mounted there"))
        return unit

    async def private_view(self, unit_id: str) -> list[list[int]]:
        """Places of private ground in a unit's picture, centimetres; InputError: no such unit."""
        return await asyncio.to_thread(self.workspace.private_places, self._unit(unit_id))

    async def _judge(self) -> None:
        """Numbers by the evaluator, of whatever is shown and rests: the newest first."""
        while True:
            await self._rests.wait()
            self._rests.clear()
            await asyncio.sleep(_REST_S)
            if self._rests.is_set() or self._changed.is_set():
                continue
            self._notice(self.save_plan())
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
        done = self.workspace.known.keys() | self.workspace.failed.keys()
        return [units for key, units in found.items() if key not in done]

    async def _evaluate(self, units: tuple[CandidatePose, ...]) -> None:
        key, workspace = key_of(units), self.workspace
        layout = Variant(name="plan", units=units).layout(self.setting.scene)
        self._do("evaluator", "evaluate")
        try:
            stages = partial(self._do, "evaluator")
            numbers = await self._exact.call("evaluate", layout, on_progress=stages)
        except Cancelled:
            return
        except TaskError as error:
            if isinstance(error, DiedError) and key not in workspace.died:
                workspace.died.add(key)  # once more, by a new process
                self._notice(tr("{reason}; it is tried again", reason=error))
                self._rests.set()
                return
            workspace.failed[key] = str(error)
            self._notice(tr("not evaluated: {reason}", reason=error))
            return
        finally:
            self._do("evaluator", "")
        workspace.learn(units, numbers)
        if workspace is not self.workspace:  # another scene was opened meanwhile
            return
        if key == key_of(self.history.state.variant.units):
            revision = self.revision
            private = await asyncio.to_thread(workspace.private_areas, units)
            self.send({"type": "numbers", "revision": revision, **numbers, **private})
        self._send_variants()
        self.send(self._proposals_message())

    def _send_variants(self) -> None:
        """Send the numbers of all variants, as far as they are known."""
        variants = [
            {"name": variant.name, **self._summary(variant.units)}
            for variant in self.history.state.variants
        ]
        self.send({"type": "variants", "variants": variants})

    def _summary(self, units: Sequence[CandidatePose]) -> dict[str, Any]:
        key, workspace = key_of(units), self.workspace
        cost = cost_record(units, self.scene)
        source = "table" if key in workspace.by_table else "none"
        found = {"apr": workspace.by_table.get(key, ""), "byCase": {}, "oneFails": ""}
        if numbers := workspace.known.get(key):
            source, found = "evaluator", {name: numbers[name] for name in found}
        return {
            "units": len(units),
            "cost": cost["all"] if cost else "",
            "source": source,
            **found,
            "problem": workspace.failed.get(key, ""),
        }

    def save_plan(self) -> str:
        """Write the plan to its file, if there is one and it is not empty; an error in words."""
        save = self.workspace.save
        is_empty = self.workspace.background is None and self.history.state.is_empty
        if save is None or (is_empty and not save.exists()):
            return ""
        text = self.plan_text()
        try:
            write_atomically(save, text)
        except OSError as error:
            return tr("not saved: {file}: {reason}", file=save, reason=error.strerror or error)
        return ""

    def saved_files(self) -> list[str]:
        """Files of the plans of this session, in the order of their scenes."""
        return [str(path) for path in self._saves if path.exists()]

    # ---------- the optimiser

    async def _advise(self, ask: plan.Ask, units: tuple[CandidatePose, ...]) -> None:
        tell = partial(self._do, "optimiser")
        words = [self._words[name] for name in self._chosen]
        tell(mark("start"), 0, 0)
        try:
            may = ",".join(words), self.history.state.poles
            await self._advice.call("choose", *may, on_progress=tell)
            answers = await self._advice.call(
                "advise", units, ask.request, n_units=ask.units, site=ask.site, on_progress=tell
            )
        except Cancelled:
            self._notice(tr("The optimiser was stopped."))
            return
        except TaskError as error:
            self._notice(str(error))
            return
        finally:
            self._do("optimiser", "")
        workspace = self.workspace
        for answer in answers:
            views = await asyncio.to_thread(workspace.view_paths, answer["units"])
            if workspace is not self.workspace:
                return
            proposal = Proposal(
                number=next(self._numbers_of_proposals),
                views=tuple(views),
                fields={name: answer.pop(name) for name in ("apr", "bound", "isProven")},
                **answer,
            )
            self._proposals = [*self._proposals, proposal][-_MAX_PROPOSALS:]
        self.send(self._proposals_message())
        self._rests.set()

    def _proposals_message(self) -> dict[str, Any]:
        scene = self.scene
        records = [each.record(self._summary(each.units), scene) for each in self._proposals]
        return {"type": "proposals", "proposals": records}

    def _take(self, message: plan.TakeProposal) -> None:
        proposal = next((each for each in self._proposals if each.number == message.number), None)
        if proposal is None:
            raise InputError(mark("proposal"), message.number, mark("one that is shown"))
        state = self.history.state
        if message.as_variant:
            state = plan.add_variant(state, Variant(name=proposal.title, units=proposal.units))
        else:
            state = state.with_units(proposal.units)
        self._proposals = [each for each in self._proposals if each is not proposal]
        self._go_to(self.history.went_on(state))
        self.send(self._proposals_message())

    # ---------- what is asked

    def _ask(self, question: Question) -> None:
        """Go on with another question when its runs are there; of several the newest counts."""
        if self._coming[1] is not None:
            self._coming[1].stop()
        self._coming = question, None
        self._do("setting", "")
        if question == self.work.question:
            self.send(self._question_message())
            return
        work = replace(self.work, question=question)
        exact = self._make_worker(work)
        self._coming = question, exact
        self._spawn(self._ask_otherwise(work, exact))

    async def _ask_otherwise(self, work: Work, exact: Worker) -> None:
        """Judge by another question; the layout stays, and Undo leads back."""
        before, workspace, problem = self.workspace, None, ""
        self._do("setting", mark("start"))
        try:
            setting = await exact.call("open_setting", on_progress=partial(self._do, "setting"))
            workspace, problem = await asyncio.to_thread(
                build_workspace, work, setting, title=before.title, save=before.save
            )
        except Cancelled:
            pass
        except Exception as error:  # whatever it is, what was asked before goes on
            problem = str(error)
        if self._coming[1] is not exact:  # something else is asked by now
            exact.stop()
            return
        self._coming = work.question, None
        self._do("setting", "")
        self._notice(problem)
        if workspace is None or self.workspace is not before:  # another scene was opened
            exact.stop()
            self.send(self._question_message())
            return
        workspace.background = self.workspace.background
        state = replace(self.history.state, workspace=workspace)
        self._go_to(self.history.went_on(state).of_newest(_MAX_WORKSPACES), exact)

    # ---------- answers to addresses

    def plan_text(self) -> bytes:
        """Contents of the plan's file."""
        return plan_text(self.history.state, self.setting.scene, self.workspace.background).encode()

    def layout(self) -> Layout:
        """The layout that is worked on. Raises InputError if nothing is mounted."""
        return self.history.state.variant.layout(self.setting.scene)

    async def call(self, method: str, *args: Any, is_long: bool = False) -> Any:
        """Result of a task by the evaluator's process, or the optimiser's; TaskError, Cancelled."""
        worker, who = (self._advice, "optimiser") if is_long else (self._exact, "evaluator")
        try:
            return await worker.call(method, *args, on_progress=partial(self._do, who))
        finally:
            self._do(who, "")

    async def open_file(self, file: MapFile) -> MapFile:
        """Survey a map or a scene; another junction is chosen from it. TaskError, Cancelled."""
        self._opening = reader = self._reader
        try:
            given = {key: file.options[key] for key in file.options.keys() & {"keeps_left"}}
            stages = partial(self._do, "scene")
            found = await reader.call("survey", str(file.path), on_progress=stages, **given)
        finally:
            self._opening = None
            self._do("scene", "")
        self.map_file = replace(file, found=found)
        return self.map_file

    async def open_scene(
        self, path: str, title: str = "", *, of: MapFile | None = None, junction: str = ""
    ) -> None:
        """Go on in another scene, from nothing; Undo leads back.

        It is read, or cut out of a map around a junction. Where the plan has a file, that of the
        new scene gets another one. TaskError: it cannot be made, or has no runs. Cancelled.
        """
        stages = partial(self._do, "scene")
        work = replace(self.work, question=replace(self.work.question, scene=path))
        exact = self._make_worker(work)
        try:
            if of is not None:
                self._opening = reader = self._reader
                given = str(of.path), junction, path
                await reader.call("import_junction", *given, on_progress=stages, **of.options)
                if self._opening is not reader:  # it was stopped, or another one is asked for
                    raise Cancelled
            self._opening = exact
            setting: Setting = await exact.call("open_setting", on_progress=stages)
            save = None if self.workspace.save is None else free_path(self.workspace.save)
            workspace, notice = await asyncio.to_thread(
                build_workspace, work, setting, title=title, save=save
            )
            if self._opening is not exact:
                raise Cancelled
        except BaseException:
            exact.stop()
            raise
        finally:
            self._opening = None
            self._do("scene", "")
        if notice:
            exact.stop()
            exact = self._make_worker(workspace.work)
        self._notice(notice)
        before, state = self.workspace, plan.begin_history((), workspace).state
        self._go_to(self.history.went_on(state).of_newest(_MAX_WORKSPACES), exact)
        if save is not None:
            self._saves.append(save)
            self._notice(
                tr(
                    "The plan at {scene} is in {file}; this one: {new}.",
                    scene=before.title,
                    file=before.save,
                    new=save,
                )
            )
