"""Demand of traffic through a junction, from TOML to SUMO's routes.

It says how much drives, where to and with what.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any
from xml.sax.saxutils import quoteattr

from msgspec import Meta, Struct

from geometry.actors import Actor, read_body
from geometry.errors import InputError, check_one_of, refuse
from geometry.tables import Table, Text, read_table, take_list
from geometry.text_formats import load_data, load_toml

from ...compute import check_distinct

TURNS = ("left", "straight", "right")
SUMO_CLASSES = (
    "passenger",
    "delivery",
    "truck",
    "trailer",
    "bus",
    "coach",
    "motorcycle",
    "moped",
)
_FILE = "demand.toml"
# No lane carries more: Highway Capacity Manual, capacity of a motorway's lane (1,900 at
# signals).
_MOST_PER_LANE = 2_400.0
_MOST_PER_ARM = 10 * _MOST_PER_LANE
_SUM_TOLERANCE = 1.0e-6
_KIND_KEYS = ("sumo_class", "share")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DrivingKind:
    """A kind of vehicle that drives.

    Attributes
    ----------
    actor : Actor
        Its body.
    sumo_class : str
        One of `SUMO_CLASSES`.
    share : float
        Of all vehicles, 0 .. 1.
    """

    actor: Actor
    sumo_class: str
    share: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Demand:
    """Traffic through a junction.

    Attributes
    ----------
    vehicles_per_hour_per_lane : float
        Into the junction, on each lane of an arm.
    arms : mapping of str to float
        In place of that, on all lanes of an arm together, by its name. [1/h]
    turns : mapping of str to float
        Share of each of ``TURNS``; sums to 1.
    vehicles : tuple of DrivingKind
        What drives; shares sum to 1.
    speed_limit_mps : float
        On all lanes. [m/s]
    approach_m : float
        Length of each arm, at least. [m]
    warm_up_s : float
        Until the streets are full. [s]
    pause_s : tuple of float
        Shortest and longest time between two windows. [s]
    name : str
        What it is called in reports.
    """

    vehicles_per_hour_per_lane: float
    arms: Mapping[str, float]
    turns: Mapping[str, float]
    vehicles: tuple[DrivingKind, ...]
    speed_limit_mps: float
    approach_m: float
    warm_up_s: float
    pause_s: tuple[float, float]
    name: str = "default"

    def per_hour(self, arm: str, n_lanes: int) -> float:
        """Vehicles an hour on all entry lanes of an arm."""
        return self.arms.get(arm, self.vehicles_per_hour_per_lane * n_lanes)


# ---------- reading
_Share = Annotated[float, Meta(ge=0.0, le=1.0)]
_PerLane = Annotated[float, Meta(ge=0.0, le=_MOST_PER_LANE)]
_PerArm = Annotated[float, Meta(ge=0.0, le=_MOST_PER_ARM)]


class _Turns(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    left: _Share
    straight: _Share
    right: _Share


class _DemandFile(Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A file laid out as ``data/demand.toml``, but for the vehicles' bodies."""

    vehicles_per_hour_per_lane: _PerLane
    speed_limit_kmh: Annotated[float, Meta(gt=0.0, le=200.0)]
    approach_m: Annotated[float, Meta(ge=0.0, le=2000.0)]
    warm_up_s: Annotated[float, Meta(ge=0.0, le=3600.0)]
    pause_s: tuple[Annotated[float, Meta(ge=0.0)], Annotated[float, Meta(le=600.0)]]
    turns: _Turns
    vehicles: Annotated[list[dict[str, Any]], Meta(min_length=1)]
    arms: dict[str, _PerArm] = {}


class _Kind(Struct, frozen=True, kw_only=True):
    sumo_class: Text
    share: _Share


def load_demand(path: Path | None = None) -> Demand:
    """Read a file of demand, by default ``data/demand.toml``.

    Raises InputError if it cannot be read, a value cannot be, or nobody drives.
    """
    if path is None:
        return _read(load_data("placement", _FILE), _FILE, "default")
    return _read(load_toml(path), str(path), path.name)


def _read(document: Table, where: str, name: str) -> Demand:
    """Demand of a document; errors name the place `where`."""
    table = read_table(document, _DemandFile, where)
    if table.pause_s[0] > table.pause_s[1]:
        expected = "[shortest, longest], in seconds"
        raise InputError(f"{where}: pause_s", list(table.pause_s), expected)
    entries = take_list(document, "vehicles", where)
    kinds = tuple(
        _read_kind(entry, f"{where}: vehicles[{i}]") for i, entry in enumerate(entries)
    )
    # Shares must sum to 1.
    turns = {turn: getattr(table.turns, turn) for turn in TURNS}
    for what, shares in (
        ("vehicles: share", [k.share for k in kinds]),
        ("turns", turns.values()),
    ):
        if abs(sum(shares) - 1.0) > _SUM_TOLERANCE:
            refuse(
                f"{where}: {what}", f"a sum of {sum(shares):g}", "shares that sum to 1"
            )
    bodies = [kind.actor.name for kind in kinds]
    check_distinct(f"{where}: vehicles", bodies, "every body once")
    if table.vehicles_per_hour_per_lane == 0.0 and not any(table.arms.values()):
        expected = "more than 0, or an arm in [arms] with more"
        raise InputError(f"{where}: vehicles_per_hour_per_lane", 0.0, expected)
    return Demand(
        vehicles_per_hour_per_lane=table.vehicles_per_hour_per_lane,
        arms=dict(table.arms),
        turns=turns,
        vehicles=kinds,
        speed_limit_mps=table.speed_limit_kmh / 3.6,
        approach_m=table.approach_m,
        warm_up_s=table.warm_up_s,
        pause_s=table.pause_s,
        name=name,
    )


def _read_kind(entry: Table, where: str) -> DrivingKind:
    kind = read_table({k: v for k, v in entry.items() if k in _KIND_KEYS}, _Kind, where)
    check_one_of(f"{where}.sumo_class", kind.sumo_class, SUMO_CLASSES)
    actor = read_body({k: v for k, v in entry.items() if k not in _KIND_KEYS}, where)
    return DrivingKind(actor=actor, sumo_class=kind.sumo_class, share=kind.share)


# ---------- SUMO's routes
def write_routes(
    demand: Demand,
    ways: Mapping[str, Mapping[str, Mapping[str, str]]],
    n_lanes: Mapping[str, int],
) -> str:
    """Vehicle types and flows as a SUMO route file.

    Gaps between vehicles are exponential. `ways` has by arm, turn and exit the
    edges of the route; `n_lanes` the entry lanes of each arm. Raises InputError if
    the demand names an arm that the junction does not have, or nobody drives.
    """
    for arm in demand.arms:
        if arm not in n_lanes:
            expected = "an arm with lanes in: " + ", ".join(n_lanes)
            raise InputError(f"{demand.name}: arms", arm, expected)
    lines = ["<routes>", '<vTypeDistribution id="all">']
    for kind in demand.vehicles:
        body = kind.actor
        name = quoteattr(body.name)
        sumo_class = quoteattr(kind.sumo_class)
        lines.append(
            f'<vType id={name} vClass={sumo_class} probability="{kind.share}"'
            f' length="{body.length_m}" width="{body.width_m}"'
            f' height="{body.height_m}"/>'
        )
    lines.append("</vTypeDistribution>")
    # One flow for each way; exits of a turn share its vehicles evenly.
    n_flows = 0
    for arm, turns in ways.items():
        total = sum(demand.turns[turn] for turn in turns)
        for turn, exits in turns.items():
            if total > 0.0:
                share = demand.turns[turn] / total
            else:
                share = 1.0 / len(turns)
            rate = demand.per_hour(arm, n_lanes[arm]) * share / len(exits) / 3600.0
            for leaving, edges in exits.items():
                if rate > 0.0:
                    n_flows += 1
                    lines.append(
                        f'<flow id="{arm}-{leaving}" type="all" begin="0"'
                        f' period="exp({rate!r})" departLane="best"'
                        ' departSpeed="desired"><route'
                        f" edges={quoteattr(edges)}/></flow>"
                    )
    if n_flows == 0:
        refuse(f"{demand.name}", "nobody who drives", "more than 0 vehicles")
    return "\n".join([*lines, "</routes>"])
