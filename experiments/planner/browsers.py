"""The conversation with browsers: who listens, and the messages that greet a new one."""

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from placement.question import Question

from ..language import tr
from . import files, plan_files
from .background import MAX_IMAGE_BYTES
from .numbers import question_record, scene_record, state_record
from .tiles import TileServer, tile_frame
from .worker import OnProgress
from .workspace import Shown

Listener = Callable[[dict[str, Any]], None]
"""Passes a message on to one browser."""


class Browsers:
    """The browsers that show the plan; for the thread of the event loop alone.

    Each is a :data:`Listener`, which passes messages on. Work in the background tells
    them its stages; the newest one is told to a browser that comes later.

    Attributes
    ----------
    listeners : set of Listener
        Browsers that are there.
    left_at_s : float or None
        Monotonic time since which nobody looks; None: somebody does, or nobody came
        yet.
    is_lost : bool
        The last one was not closed: the connection to it is lost.
    """

    def __init__(self) -> None:
        self.listeners: set[Listener] = set()
        self.left_at_s: float | None = None
        self.is_lost = False
        # The newest message about work in the background
        self._doing: dict[str, Any] = {}

    def send(self, message: dict[str, Any]) -> None:
        """Send a message to every browser."""
        for listener in [*self.listeners]:
            listener(message)

    def notice(self, text: str) -> None:
        """Show a sentence for some seconds; an empty one is not sent."""
        if text:
            self.send({"type": "notice", "text": text})

    def tell_stage(self, who: str, stage: str, done: int = 0, total: int = 0) -> None:
        """Show the stage of some work.

        Parameters
        ----------
        who : str
            Who works: "rays", "evaluator", "optimiser", "setting" or "scene".
        stage : str
            In English; it is translated here. Empty: the work has ended.
        done, total : int
            How much of how much is done; 0 of 0: nobody knows.
        """
        self._doing = {
            "type": "doing",
            "who": who,
            "stage": tr(stage),
            "done": done,
            "total": total,
        }
        self.send(self._doing)

    def stages(self, who: str) -> OnProgress:
        """What a worker tells its stages, as those of somebody such as the "evaluator"."""
        return partial(self.tell_stage, who)

    def join(self, listener: Listener, greetings: Sequence[dict[str, Any]]) -> None:
        """Add a browser, and send it alone what it does not know yet.

        Parameters
        ----------
        listener : Listener
            The browser.
        greetings : sequence of dict
            Messages about what is shown.
        """
        self.listeners.add(listener)
        self.left_at_s = None
        for message in greetings:
            listener(message)
        if self._doing:
            listener(self._doing)

    def leave(self, listener: Listener, *, is_lost: bool = False) -> None:
        """Remove a browser: its page was closed, or the connection to it is lost."""
        self.listeners.discard(listener)
        if not self.listeners:
            self.left_at_s = time.monotonic()
            self.is_lost = is_lost


# ---------- messages about what is shown


def scene_message(
    shown: Shown, *, map_name: str = "", tiles: TileServer | None = None
) -> dict[str, Any]:
    """The constant part of a scene: plan, sites, runs, sensors, and limits of files.

    Parameters
    ----------
    shown : Shown
        What is shown.
    map_name : str
        Name of the map that the scene is cut out of; empty: of none.
    tiles : TileServer, optional
        Tiles behind the plan.
    """
    workspace = shown.workspace
    scene = shown.setting.scene
    record = scene_record(
        shown.setting,
        models=[*shown.sensors.models.values()],
        chosen=shown.sensors.chosen,
        ground=workspace.ground,
        site_cost_eur=workspace.work.question.site_cost_eur,
    )
    tiles_record = None
    if tiles is not None:
        tiles_record = {
            "template": tiles.template,
            "attribution": tiles.attribution,
            "frame": tile_frame(scene),
        }
    assumed = [tr(note.words) for note in scene.notes if note.kind == "junction"]
    return {
        "type": "scene",
        **record,
        "tiles": tiles_record,
        "title": workspace.title,
        "isKept": workspace.save is not None,
        "map": map_name,
        "assumed": assumed,
        "mostBytes": {
            "plan": plan_files.MAX_PLAN_BYTES,
            "map": files.MAX_MAP_BYTES,
            "image": MAX_IMAGE_BYTES,
        },
    }


def question_message(shown: Shown, begun: Question) -> dict[str, Any]:
    """What is asked, and what the page lets choose.

    Parameters
    ----------
    shown : Shown
        What is shown.
    begun : Question
        The question of the command line.
    """
    return {"type": "question", **question_record(shown.workspace.work.question, begun)}


def state_message(shown: Shown) -> dict[str, Any]:
    """Units of the variant that is worked on, names of all variants, and the revision."""
    site_cost_eur = shown.workspace.work.question.site_cost_eur
    record = state_record(shown.history, shown.scene, site_cost_eur=site_cost_eur)
    return {"type": "state", "revision": shown.revision, **record}


def variants_message(shown: Shown) -> dict[str, Any]:
    """Numbers of all variants, as far as they are known."""
    variants = []
    for variant in shown.state.variants:
        existing = shown.state.existing_ids(variant.units)
        summary = shown.workspace.summary(variant.units, shown.scene, existing)
        variants.append({"name": variant.name, **summary})
    return {"type": "variants", "variants": variants}
