"""The plan as pure values: variants, which of them is worked on, undo and redo."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from geometry.errors import InputError, refuse
from geometry.phrases import Phrase
from geometry.scene import Scene, Site
from placement.candidates import CandidatePose
from placement.layout import Layout, find_existing

from ..language import mark, tr

MAX_UNITS = 1000
"""Of a variant."""
MAX_VARIANTS = 12
"""Of a plan."""
MAX_STEPS = 500
"""Steps that can be undone."""

# Letters that a name may have
_MAX_NAME = 80


def check_count(n: int, where: str, most: int) -> None:
    """Raise InputError for more than there may be."""
    if n > most:
        refuse(where, Phrase("{n:,}", n=n), Phrase("at most {n:,}", n=most))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Variant:
    """A layout that is being planned, and may be empty.

    Parameters
    ----------
    name : str
        For people; no other variant has it.
    units : tuple of CandidatePose
        What is mounted.

    Raises
    ------
    InputError
        It has too many units.
    """

    name: str
    units: tuple[CandidatePose, ...] = ()

    def __post_init__(self) -> None:
        check_count(len(self.units), "units", MAX_UNITS)

    def layout(self, scene: Scene) -> Layout:
        """Layout of the scene; a unit at a site that it does not have is mounted by itself.

        Raises InputError if there is no unit.
        """
        known = {site.id for site in scene.sites}
        units = []
        for unit in self.units:
            if unit.site_id not in known:
                unit = replace(unit, site_id="")
            units.append(unit)
        return Layout(name=self.name, units=tuple(units), scene_name=scene.name)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanState:
    """One state of the plan, between two changes.

    Attributes
    ----------
    variants : tuple of Variant
        At least one.
    current : int
        Index of the variant that is worked on.
    workspace : Workspace
        Of the scene that the plan is for. Undo may lead to another scene with it;
        nothing here looks into it.
    poles : tuple of Site
        Of one's own, beside the scene's sites.
    existing : tuple of CandidatePose
        Units that are mounted already, as opened results say; variants may have them.
    """

    variants: tuple[Variant, ...]
    current: int = 0
    workspace: Any = None
    poles: tuple[Site, ...] = ()
    existing: tuple[CandidatePose, ...] = ()

    @property
    def variant(self) -> Variant:
        """The one that is worked on."""
        return self.variants[self.current]

    def existing_ids(self, units: Sequence[CandidatePose]) -> frozenset[str]:
        """Ids of those of some units that are mounted already."""
        return find_existing(units, self.existing)

    @property
    def is_empty(self) -> bool:
        """True if nothing is mounted in any variant."""
        return not any(variant.units for variant in self.variants)

    def with_units(self, units: Sequence[CandidatePose]) -> "PlanState":
        """The state with other units in the current variant; InputError: too many."""
        return self.with_variant(replace(self.variant, units=tuple(units)))

    def with_variant(self, variant: Variant) -> "PlanState":
        """The state with another variant in place of the one that is worked on."""
        before = self.variants[: self.current]
        after = self.variants[self.current + 1 :]
        return replace(self, variants=(*before, variant, *after))


def add_variant(state: PlanState, variant: Variant, *, source: str = "") -> PlanState:
    """The state with a further variant, which is worked on from here.

    Parameters
    ----------
    state : PlanState
        Before it.
    variant : Variant
        The further one.
    source : str
        Such as the file's name: it is added where the variant's name is taken, and then
        a number.

    Raises
    ------
    InputError
        There are too many, or the name cannot be printed.
    """
    check_count(len(state.variants) + 1, mark("variants"), MAX_VARIANTS)
    names = {each.name for each in state.variants}
    base = printable_name(variant.name)
    if base in names and source:
        base = printable_name(f"{source}: {base}"[:_MAX_NAME])
    name = base
    number = 2
    while name in names:
        name = f"{base} ({number})"
        number += 1
    variants = (*state.variants, replace(variant, name=name))
    return replace(state, variants=variants, current=len(variants) - 1)


def printable_name(name: str) -> str:
    """A name with single spaces. Raises InputError if it is empty, long or not printable."""
    name = " ".join(name.split())
    if not name or len(name) > _MAX_NAME or not name.isprintable():
        raise InputError(mark("name"), name, Phrase("1 to {n} letters", n=_MAX_NAME))
    return name


def check_finite(where: str, value: float) -> float:
    """The number itself. Raises InputError if it is not finite."""
    if not math.isfinite(value):
        raise InputError(where, value, mark("a finite number"))
    return value


# ---------- undo and redo


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class History:
    """States in the order in which they came about, and which of them is now.

    What was undone comes after `now`, until a change takes its place.
    """

    states: tuple[PlanState, ...]
    now: int = 0
    # Name of the drag that the newest step belongs to; empty: none
    gesture: str = ""

    @property
    def state(self) -> PlanState:
        """The state that is shown."""
        return self.states[self.now]

    @property
    def can_undo(self) -> bool:
        """True if there is an earlier state."""
        return self.now > 0

    @property
    def can_redo(self) -> bool:
        """True if there is a later state."""
        return self.now + 1 < len(self.states)

    def went_on(self, state: PlanState, *, gesture: str = "") -> "History":
        """The history one state further.

        Parameters
        ----------
        state : PlanState
            What is shown from here.
        gesture : str
            Name of the drag that it is a step of, if it is one: a step of the same
            gesture as the last one takes that one's place, so that all is undone at
            once.
        """
        is_same = bool(gesture) and gesture == self.gesture and not self.can_redo
        before = self.states[: self.now + 1]
        if is_same:
            before = self.states[: self.now]
        states = (*before, state)[-MAX_STEPS:]
        return History(states=states, now=len(states) - 1, gesture=gesture)

    def reverted(self, gesture: str) -> "History":
        """The history without its newest step, if that belongs to a gesture.

        A drag that is given up leaves nothing to redo.
        """
        if not gesture or gesture != self.gesture or not self.can_undo:
            return self
        return History(states=self.states[:-1], now=self.now - 1)

    def of_newest(self, most: int) -> "History":
        """Without the steps in other than the newest workspaces, `most` of them."""
        newest_first = dict.fromkeys(
            id(state.workspace) for state in reversed(self.states)
        )
        kept = list(newest_first)[:most]
        states = tuple(state for state in self.states if id(state.workspace) in kept)
        return History(states=states, now=len(states) - 1)

    def undone(self) -> "History":
        """One state back, where there is one."""
        earlier = max(self.now - 1, 0)
        return replace(self, now=earlier, gesture="")

    def redone(self) -> "History":
        """One state on, where there is one."""
        later = min(self.now + 1, len(self.states) - 1)
        return replace(self, now=later, gesture="")


def begin_history(variants: Sequence[Variant], workspace: Any = None) -> History:
    """A history of one state with these variants, the first one current.

    Without any it is an empty one. Raises InputError if there are too many.
    """
    if not variants:
        variants = [Variant(name=tr("Variant") + " 1")]
    state = PlanState(variants=(variants[0],), workspace=workspace)
    for variant in variants[1:]:
        state = add_variant(state, variant)
    state = replace(state, current=0)
    return History(states=(state,))
