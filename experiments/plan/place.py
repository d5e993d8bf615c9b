"""A scene in which somebody plans, and what is known of layouts there."""

import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from geometry.errors import InputError
from placement.candidates import CandidatePose
from placement.compute import Compute
from placement.live import LiveTable, table_verdict
from placement.private_ground import PrivateGround, PrivateSight, load_private_ground
from placement.setting import Setting

from ..figures.views import GroundViews
from ..parts.player import view_paths
from .background import Background
from .numbers import key_of, private_record, table_numbers
from .session import History
from .tasks import Work
from .worker import Cancelled

MAX_ALONE = 60
"""Units of which each one's own APR is shown while something is dragged."""

_AT_ONCE = 16  # units between two looks whether anybody waits
_MAX_KNOWN = 300  # layouts by the evaluator

Key = tuple[object, ...]


class Place:
    """A scene in which somebody plans: rays, views, private ground, and numbers known so far.

    Parameters
    ----------
    work : Work
        What is asked there.
    setting : Setting
        As :func:`placement.setting.build_setting` builds it for the same question.
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
        self.work, self.setting, self.save = work, setting, save
        self.title = title or setting.scene.name
        self.ground: PrivateGround | None = None
        self._sight: PrivateSight | None = None
        if work.question.no_look:
            self.ground = load_private_ground(Path(work.question.no_look), setting.scene)
            self._sight = PrivateSight(setting.scene, self.ground)
        self._sight_turn = threading.Lock()
        compute = Compute(seed=work.seed, workers=work.workers, rays=work.rays)
        self.live = LiveTable(setting, compute=compute)
        self.views = GroundViews(setting)
        self.is_over = threading.Event()  # nobody waits for numbers any more
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
        """Numbers by the detection table; not for several threads at once.

        Raises Cancelled soon after `is_over` was set.
        """
        if not units:
            return {"source": "none"}
        rows = []
        for first in range(0, len(units), _AT_ONCE):
            if self.is_over.is_set():
                raise Cancelled
            rows.append(self.live.detected(units[first : first + _AT_ONCE]))
        detected = np.concatenate(rows)
        together = table_verdict(units, detected, self.setting)
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
        places: list[list[int]] = (
            np.rint(100.0 * self.ground.points_m[seen, :2]).astype(int).tolist()
        )
        return places

    def view_record(self, unit: CandidatePose) -> dict[str, Any]:
        """A unit's view on the ground, where it looks from, and how far its detector reaches."""
        (path,) = view_paths([unit], self.views)
        return {
            "unit": unit.id,
            "place": np.rint(100.0 * unit.pose.position_m[:2]).astype(int).tolist(),
            "view": path,
            "reachM": self.views.reach_m(unit.sensor),
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Visit:
    """A place with what was planned there."""

    place: Place
    history: History
    background: Background | None


def build_place(
    work: Work, setting: Setting, *, title: str, save: Path | None
) -> tuple[Place, str]:
    """A place, without private areas where they are of another one; and what to say about that."""
    try:
        return Place(work, setting, title=title, save=save), ""
    except InputError as error:
        question = replace(work.question, no_look="", no_look_share=None)
        place = Place(replace(work, question=question), setting, title=title, save=save)
        return place, f"without private areas: {error}"


def free_path(path: Path) -> Path:
    """A path beside another that does not exist: with -2, -3 .. before the suffix."""
    number = 2
    while (found := path.with_name(f"{path.stem}-{number}{path.suffix}")).exists():
        number += 1
    return found
