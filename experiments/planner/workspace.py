"""A scene in which somebody plans, with the numbers known of it; and what is shown of it."""

import threading
from collections import OrderedDict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from geometry.catalogue import Sensor, load_cameras
from geometry.errors import InputError
from geometry.lidar import load_lidars
from geometry.scene import Scene
from geometry.tables import pick
from placement.candidates import (
    CandidatePose,
    build_grid,
    load_candidate_grid,
    own_models,
)
from placement.live import LiveTable, table_verdict
from placement.private_ground import PrivateGround, PrivateSight, load_private_ground
from placement.question import Question
from placement.setting import Setting

from ..figures.views import GroundViews
from ..language import mark, tr, tr_error
from ..parts.player import centimetres, svg_path
from .background import Background
from .changes import Stock, first_units
from .numbers import cost_record, key_of, private_record, table_numbers
from .plan import History, PlanState
from .poles import with_poles
from .tasks import Work
from .worker import Cancelled

Key = tuple[object, ...]
"""Of a layout, see :func:`.numbers.key_of`."""

MAX_ALONE = 60
"""Units of which each one's own APR is shown while something is dragged."""

# Units between two looks whether anybody waits
_AT_ONCE = 16
# Layouts by the evaluator
_MAX_KNOWN = 300


class Workspace:
    """A scene in which somebody plans: rays, views, private ground, and numbers known so far.

    Undo leads back to earlier ones. It is shared with threads: what they change is
    guarded.

    Parameters
    ----------
    work : Work
        Question and files of the session.
    setting : Setting
        Scene and runs of that question.
    title : str
        For people, such as the streets that meet; by default the scene's name.
    save : Path, optional
        File that gets the plan whenever it rests.

    Raises
    ------
    InputError
        Areas of ``--no-look`` cannot lie in this scene.
    """

    def __init__(
        self, work: Work, setting: Setting, *, title: str = "", save: Path | None = None
    ) -> None:
        self.work = work
        setting = _with_capacity(setting, work.question.site_capacity)
        self.setting = setting
        self.save = save
        self.title = title or setting.scene.name
        self.background: Background | None = None
        self.ground: PrivateGround | None = None
        self._sight: PrivateSight | None = None
        if work.question.no_look:
            self.ground = load_private_ground(
                Path(work.question.no_look), setting.scene
            )
            self._sight = PrivateSight(setting.scene, self.ground)
        self._sight_turn = threading.Lock()
        self.live = LiveTable(setting, compute=work.compute)
        self.views = GroundViews(setting)
        # Nobody waits for numbers any longer
        self.is_over = threading.Event()
        # By the evaluator
        self.known: OrderedDict[Key, dict[str, Any]] = OrderedDict()
        self.failed: dict[Key, str] = {}
        # Layouts at which the evaluator's process died
        self.died: set[Key] = set()
        self.by_table: dict[Key, str] = {}

    def learn(self, units: Sequence[CandidatePose], numbers: dict[str, Any]) -> None:
        """Remember numbers by the evaluator."""
        self.known[key_of(units)] = numbers
        while len(self.known) > _MAX_KNOWN:
            self.known.popitem(last=False)

    def numbers_by_table(self, units: Sequence[CandidatePose]) -> dict[str, Any]:
        """Numbers by the detection table, for one thread at a time.

        Raises Cancelled soon after `is_over` was set.
        """
        if not units:
            return {"source": "none"}
        # A row for each unit: the frames in which it detects the road user
        rows = []
        for first in range(0, len(units), _AT_ONCE):
            if self.is_over.is_set():
                raise Cancelled
            rows.append(self.live.detected(units[first : first + _AT_ONCE]))
        detected = np.concatenate(rows)
        do_cars_see = self.setting.cars == 1.0
        together = table_verdict(units, detected, self.setting, with_vut=do_cars_see)
        alone = {}
        for index, unit in enumerate(units[:MAX_ALONE]):
            row = detected[index : index + 1]
            alone[unit.id] = table_verdict([unit], row, self.setting)
        numbers = table_numbers(units[:MAX_ALONE], together, alone, self.setting)
        self.by_table[key_of(units)] = numbers["apr"]
        return numbers

    def summary(
        self,
        units: Sequence[CandidatePose],
        scene: Scene,
        existing: Collection[str] = (),
    ) -> dict[str, Any]:
        """Numbers known of a layout, in brief: of a variant, or of a proposal.

        `scene` is this workspace's with the poles of one's own: they cost money, too.
        `existing` are ids of units that are mounted already, and cost nothing.
        """
        key = key_of(units)
        source = "none"
        if key in self.by_table:
            source = "table"
        found = {"apr": self.by_table.get(key, ""), "byCase": {}, "oneFails": ""}
        # The evaluator's numbers win over those of the table.
        evaluated = self.known.get(key)
        if evaluated:
            source = "evaluator"
            found = {name: evaluated[name] for name in found}
        site_cost_eur = self.work.question.site_cost_eur
        cost = cost_record(units, scene, site_cost_eur, existing=existing)
        return {
            "units": len(units),
            "cost": cost["all"] if cost else "",
            "source": source,
            **found,
            "problem": self.failed.get(key, ""),
        }

    def private_areas(self, units: Sequence[CandidatePose]) -> dict[str, Any]:
        """Private areas in view, as a part of the numbers; nothing without any area."""
        if self.ground is None or self._sight is None:
            return {}
        allowed = self.work.question.no_look_share or 0.0
        with self._sight_turn:
            found = private_record(units, self.ground, self._sight, max_share=allowed)
        return {"private": found}

    def private_places(self, unit: CandidatePose) -> list[list[int]]:
        """Places of private ground in a unit's picture, a metre apart, in centimetres."""
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


def _with_capacity(setting: Setting, capacity_units: int | None) -> Setting:
    """A setting whose sites carry as many units as the question says, if it does."""
    if capacity_units is None:
        return setting
    scene = setting.scene
    sites = tuple(replace(site, capacity_units=capacity_units) for site in scene.sites)
    return replace(setting, scene=replace(scene, sites=sites))


def build_workspace(
    work: Work, setting: Setting, *, title: str, save: Path | None
) -> tuple[Workspace, str]:
    """A workspace, without private areas where they are of another scene.

    Parameters
    ----------
    work, setting, title, save
        As of :class:`Workspace`.

    Returns
    -------
    workspace : Workspace
        The workspace.
    notice : str
        That the private areas are left out, as a sentence; empty: they are not.
    """
    try:
        return Workspace(work, setting, title=title, save=save), ""
    except InputError as error:
        question = replace(work.question, no_look="", no_look_share=None)
        notice = tr("without private areas: {reason}", reason=tr_error(error))
    work = replace(work, question=question)
    return Workspace(work, setting, title=title, save=save), notice


# ---------- sensors


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SensorChoice:
    """Sensor models that can be mounted by hand, and those that the optimiser may mount.

    Attributes
    ----------
    words : mapping of str to str
        What ``--sensors`` calls each model, by the model's name.
    models : mapping of str to Sensor
        By name.
    chosen : tuple of str
        Names of the models that the optimiser may mount; none: the default grid's.
    """

    words: Mapping[str, str]
    models: Mapping[str, Sensor]
    chosen: tuple[str, ...]

    @property
    def option(self) -> str:
        """The chosen models as ``--sensors`` takes them."""
        return ",".join(self.words[name] for name in self.chosen)

    def choosing(self, names: Sequence[str]) -> "SensorChoice":
        """Other models for the optimiser. Raises InputError if one is not known.

        Browsers name no files.
        """
        for name in names:
            pick(self.models, name, mark("sensors"))
        return replace(self, chosen=tuple(names))


def build_sensor_choice(question: Question) -> SensorChoice:
    """Models of the catalogue and of the question's own files, and the question's choice.

    Parameters
    ----------
    question : Question
        Its ``sensors`` may name files.

    Raises
    ------
    InputError
        A file cannot be read.
    """
    # Models of the catalogue go by their names, those of files by FILE.toml:NAME.
    words = {name: name for name in (*load_cameras(), *load_lidars())}
    for word in question.sensors.split(","):
        if not word:
            continue
        for model in own_models(word).values():
            if word.endswith(".toml"):
                words[model.name] = f"{word}:{model.name}"
            else:
                words[model.name] = word
    models = {}
    for word in words.values():
        for model in own_models(word).values():
            models[model.name] = model
    chosen = tuple(sensor.name for sensor in build_grid(question).sensors)
    return SensorChoice(words=words, models=models, chosen=chosen)


# ---------- what is shown


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shown:
    """What the browsers show at one moment; a change makes another one.

    Whoever works in the background keeps the one that he has begun with, and compares
    its workspace or its revision with the newest before he tells what he has found.

    Attributes
    ----------
    history : History
        The plan, with what can be undone.
    sensors : SensorChoice
        What can be mounted.
    revision : int
        How often the history has changed; numbers are told with the one they are of.
    """

    history: History
    sensors: SensorChoice
    revision: int = 0

    @property
    def state(self) -> PlanState:
        """Variants and poles of one's own."""
        return self.history.state

    @property
    def workspace(self) -> Workspace:
        """The scene in which is planned, and its numbers."""
        workspace: Workspace = self.state.workspace
        return workspace

    @property
    def setting(self) -> Setting:
        """Scene and runs."""
        return self.workspace.setting

    @property
    def scene(self) -> Scene:
        """The scene with the poles of one's own."""
        return with_poles(self.setting.scene, self.state.poles)

    @property
    def units(self) -> tuple[CandidatePose, ...]:
        """Units of the variant that is worked on."""
        return self.state.variant.units

    @property
    def stock(self) -> Stock:
        """Sites and sensor models that changes may use."""
        return Stock(scene=self.scene, models=self.sensors.models)

    def with_history(self, history: History) -> "Shown":
        """The next revision, which shows the state of a history."""
        return replace(self, history=history, revision=self.revision + 1)

    def unit(self, unit_id: str) -> CandidatePose:
        """A unit of the variant that is worked on; InputError: there is none of that name."""
        for unit in self.units:
            if unit.id == unit_id:
                return unit
        raise InputError(mark("unit"), unit_id, mark("one that is mounted there"))

    def first_units(self) -> tuple[CandidatePose, ...]:
        """A unit that is mounted nowhere: counting it prepares all that the first drag needs."""
        chosen = self.sensors.chosen
        if chosen:
            model = chosen[0]
        else:
            model = load_candidate_grid().sensors[0].name
        return first_units(self.stock, model)
