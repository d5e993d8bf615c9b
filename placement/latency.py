"""Latency budgets: what passes between a frame and the onset of braking.

Part by part.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from msgspec import Meta, Struct

from geometry.arrays import FloatArray
from geometry.errors import InputError, check_name, located, refuse
from geometry.tables import Table, Text, read_table, take_text
from geometry.text_formats import load_data, load_toml

from .compute import check_distinct

# ---------- budgets: what passes between a frame and the onset of braking, part by part
DEFAULT_LATENCY_BUDGET = "study"
# Longer than any run: a larger number is probably in milliseconds.
MAX_LATENCY_S = 10.0

_FILE = "latency.toml"
_RANGE = ("low_s", "high_s")


@dataclass(frozen=True, slots=True, kw_only=True)
class LatencyPart:
    """One of the steps that take time.

    Attributes
    ----------
    name : str
        Name of the step.
    low_s, high_s : float
        Anything between is equally likely; a fixed value where they are equal.
        [s]
    source : str
        Where the numbers come from, or why they are likely.
    is_assumption : bool
        Whether they are an assumption of this project.
    """

    name: str
    low_s: float
    high_s: float
    source: str
    is_assumption: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class LatencyBudget:
    """Parts that add up, each independent of the others.

    Attributes
    ----------
    name : str
        Name of the budget.
    parts : tuple of LatencyPart
        In the order in which they happen; names are unique.
    """

    name: str
    parts: tuple[LatencyPart, ...]

    def __post_init__(self) -> None:
        where = f"{self.name}.parts"
        if not self.parts:
            refuse(where, "none", "at least one")
        check_distinct(where, [part.name for part in self.parts], "every name once")

    @property
    def best_s(self) -> float:
        """The shortest total, in seconds."""
        return math.fsum(part.low_s for part in self.parts)

    @property
    def mean_s(self) -> float:
        """The total to expect, in seconds."""
        return 0.5 * math.fsum(
            end for part in self.parts for end in (part.low_s, part.high_s)
        )

    @property
    def worst_s(self) -> float:
        """The longest total, in seconds."""
        return math.fsum(part.high_s for part in self.parts)

    def sample_s(
        self, rng: np.random.Generator, size: int | tuple[int, ...]
    ) -> FloatArray:
        """Draw totals, (*size), in seconds.

        They lie between :attr:`best_s` and :attr:`worst_s`.
        """
        shape = (size,) if isinstance(size, int) else size
        low, high = np.array([(part.low_s, part.high_s) for part in self.parts]).T
        total = rng.uniform(low, high, size=(*shape, len(self.parts))).sum(axis=-1)
        return np.asarray(np.clip(total, self.best_s, self.worst_s))


def fixed_latency(latency_s: float) -> LatencyBudget:
    """A budget of a single number."""
    part = LatencyPart(
        name="latency", low_s=latency_s, high_s=latency_s, source="as given"
    )
    return LatencyBudget(name=f"{1000.0 * latency_s:g} ms", parts=(part,))


def load_latency_budget(
    name_or_path: str = DEFAULT_LATENCY_BUDGET, *, where: str = "latency budget"
) -> LatencyBudget:
    """Latency budget by its name, or from a TOML file.

    Names, and the layout of such a file, are those of ``data/latency.toml``.
    `where` says what named it. Raises InputError if it is unknown, or a field is
    not what it should be.
    """
    known = load_latency_budgets()
    if name_or_path in known:
        return known[name_or_path]
    path = Path(name_or_path)
    if path.suffix != ".toml":
        names = ", ".join(known)
        raise InputError(
            where, name_or_path, f"{names}, or a .toml file with a latency budget"
        )
    budgets = _read_budgets(load_toml(path), str(path))
    if len(budgets) != 1:
        got = ", ".join(budgets) or "no budget"
        refuse(str(path), got, "one budget: a table such as [mine] with parts")
    return next(iter(budgets.values()))


@cache
def load_latency_budgets() -> Mapping[str, LatencyBudget]:
    """Budgets by name, from ``data/latency.toml``."""
    return _read_budgets(load_data(__package__, _FILE), _FILE)


def _read_budgets(document: Table, file: str) -> dict[str, LatencyBudget]:
    """Budgets of a TOML document by their names."""
    budgets = {}
    for name, table in document.items():
        where = f"{file}: {name}"
        read = read_table(table, _BudgetTable, where)
        parts = tuple(
            _read_part(entry, where, f"{where}.parts[{i}]")
            for i, entry in enumerate(read.parts)
        )
        with located(f"{file}: "):
            budgets[name] = LatencyBudget(name=name, parts=parts)
    return budgets


_Seconds = Annotated[
    float, Meta(ge=0.0, le=MAX_LATENCY_S, description="0 to 10 seconds")
]


class _BudgetTable(Struct, frozen=True, forbid_unknown_fields=True):
    parts: list[dict[str, Any]]


class _PartTable(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A part of a latency budget in TOML."""

    name: str
    fixed_s: _Seconds | None = None
    low_s: _Seconds | None = None
    high_s: _Seconds | None = None
    source: Text | None = None
    assumption: Text | None = None


def _read_part(entry: Table, where: str, here: str) -> LatencyPart:
    """Read a part of the budget `where`.

    Errors name it by its name, or by its place `here` if it has none.
    """
    name = take_text(entry, "name", here)
    check_name(name, f"{where}.name")
    where = f"{where}.{name}"
    part = read_table(entry, _PartTable, where)
    # A part has a fixed time, or a range.
    given = [key for key in _RANGE if key in entry]
    if part.fixed_s is not None and given:
        refuse(f"{where}.{given[0]}", "it beside fixed_s", "one of them")
    if part.fixed_s is None and not given:
        refuse(where, "no time", "fixed_s, or low_s and high_s")
    low_s = part.low_s
    high_s = part.high_s
    if part.fixed_s is not None:
        low_s = high_s = part.fixed_s
    if low_s is None or high_s is None:
        if low_s is None:
            missing = "low_s"
        else:
            missing = "high_s"
        refuse(f"{where}.{missing}", "nothing", "a value")
    if low_s > high_s:
        raise InputError(f"{where}.high_s", high_s, f"at least low_s, {low_s}")
    # Each part says where its numbers come from.
    reasons = [key for key in ("source", "assumption") if key in entry]
    if len(reasons) != 1:
        refuse(where, " and ".join(reasons) or "neither", "either source or assumption")
    reason: str = getattr(part, reasons[0])
    if not reason.strip():
        raise InputError(f"{where}.{reasons[0]}", reason, "text")
    is_ours = reasons == ["assumption"]
    return LatencyPart(
        name=name, low_s=low_s, high_s=high_s, source=reason, is_assumption=is_ours
    )
