"""Proposals of the optimiser: how they are asked for, shown, taken over and dropped."""

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from typing import Any

from geometry.errors import InputError
from placement.candidates import CandidatePose
from placement.layout import Layout

from ..language import mark, tr
from ..parts.player import unit_records
from .browsers import Browsers
from .requests import Ask
from .worker import Cancelled, TaskError
from .workers import Workers
from .workspace import Shown

_MAX_PROPOSALS = 12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Proposal:
    """An answer of the optimiser.

    Attributes
    ----------
    number : int
        By which browsers name it.
    title, words : str
        What it is, and what it gains, with its proof.
    units : tuple of CandidatePose
        The layout.
    views : tuple of str
        Ground that each unit sees, as an SVG path in centimetres.
    fields : dict
        "apr" and "bound" by the detection table, in words, and "isProven".
    """

    number: int
    title: str
    words: str
    units: tuple[CandidatePose, ...]
    # Of each unit, as an SVG path
    views: tuple[str, ...]
    fields: dict[str, Any]

    def record(self, shown: Shown) -> dict[str, Any]:
        """Its message to browsers, with the numbers that are known of its units."""
        scene = shown.scene
        layout = Layout(name=self.title, units=self.units, scene_name=scene.name)
        existing = shown.state.existing_ids(self.units)
        drawn = []
        for record, view in zip(unit_records(layout, scene), self.views, strict=True):
            drawn.append({"place": record["place"], "view": view})
        return {
            "number": self.number,
            "title": self.title,
            "words": self.words,
            **self.fields,
            **shown.workspace.summary(self.units, scene, existing),
            "onTable": self.fields["apr"],
            "drawn": drawn,
        }


class Proposals:
    """The proposals that are shown, the oldest first; the oldest of too many go."""

    def __init__(self) -> None:
        self._shown: tuple[Proposal, ...] = ()
        self._numbers = count(1)

    def layouts(self) -> list[tuple[CandidatePose, ...]]:
        """Units of each proposal."""
        return [proposal.units for proposal in self._shown]

    def message(self, shown: Shown) -> dict[str, Any]:
        """All of them, as a message to browsers."""
        records = [proposal.record(shown) for proposal in self._shown]
        return {"type": "proposals", "proposals": records}

    def add(self, answer: dict[str, Any], views: list[str]) -> None:
        """Add an answer of :meth:`.tasks.Tasks.advise`, with the views of its units."""
        proposal = Proposal(
            number=next(self._numbers),
            title=answer["title"],
            words=answer["words"],
            units=answer["units"],
            views=tuple(views),
            fields={name: answer[name] for name in ("apr", "bound", "isProven")},
        )
        self._shown = (*self._shown, proposal)[-_MAX_PROPOSALS:]

    def find(self, number: int) -> Proposal:
        """A proposal that is shown; InputError: there is none of that number."""
        for proposal in self._shown:
            if proposal.number == number:
                return proposal
        raise InputError(mark("proposal"), number, mark("one that is shown"))

    def drop(self, number: int) -> None:
        """Drop a proposal, if it is there."""
        self._shown = tuple(each for each in self._shown if each.number != number)

    def clear(self) -> None:
        """Drop all of them: they are of another scene."""
        self._shown = ()


async def ask_optimiser(
    ask: Ask,
    begun: Shown,
    *,
    workers: Workers,
    proposals: Proposals,
    browsers: Browsers,
    current: Callable[[], Shown],
) -> bool:
    """Ask the optimiser, and add its answers to the proposals.

    Parameters
    ----------
    ask : Ask
        The request.
    begun : Shown
        What was shown when it was asked: its units are those that are advised upon.
    workers : Workers
        Have the optimiser, which may be another one by the second call.
    proposals : Proposals
        Gets the answers.
    browsers : Browsers
        Are told the stages, and why there is no answer.
    current : callable
        What is shown by now.

    Returns
    -------
    bool
        True if all answers were added; False if there is none, or another scene was
        opened meanwhile.
    """
    tell = browsers.stages("optimiser")
    tell(mark("start"), 0, 0)
    try:
        shown = current()
        models = shown.sensors.option
        await workers.optimiser.call(
            "choose", models, shown.state.poles, on_progress=tell
        )
        answers = await workers.optimiser.call(
            "advise",
            begun.units,
            ask.request,
            n_units=ask.units,
            site=ask.site,
            existing=begun.state.existing_ids(begun.units),
            on_progress=tell,
        )
    except Cancelled:
        browsers.notice(tr("The optimiser was stopped."))
        return False
    except TaskError as error:
        browsers.notice(str(error))
        return False
    finally:
        tell("", 0, 0)
    workspace = current().workspace
    for answer in answers:
        views = await asyncio.to_thread(workspace.view_paths, answer["units"])
        if workspace is not current().workspace:
            return False
        proposals.add(answer, views)
    return True
