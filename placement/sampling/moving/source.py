"""Vehicles that drive by in sampled worlds: from SUMO, or from a file of one's own model."""

import importlib.util
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from geometry.actors import MovingActor
from geometry.arrays import BoolArray, FloatArray
from geometry.errors import InputError, Unquoted
from geometry.scene import Scene
from scenarios.runs import Run

from .demand import Demand, load_demand
from .fcd import ENDINGS, load_fcd
from .sumo import RoadNetwork, build_network, missing_sumo, simulate_windows
from .trajectories import (
    REACH_M,
    TrafficCount,
    Trajectories,
    cut_window,
    frames_in_parked,
    last_frames,
    meets_road_users,
)

SUMO = "sumo"
_SAME_TIME_S = 1.0e-6


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovingTraffic:
    """Where vehicles that drive by come from; either a network or trajectories."""

    name: str  # in reports
    middle_m: FloatArray  # (2,): middle of the junction. World frame. [m]
    demand: Demand  # what SUMO drives
    network: RoadNetwork | None = None  # on which SUMO drives it, anew in each world
    trajectories: Trajectories | None = None  # a file's, of which each world cuts other windows

    def __repr__(self) -> str:
        return f"MovingTraffic({self.name!r})"

    def draw(
        self,
        runs: Sequence[Run],
        groups: Mapping[Any, Sequence[int]],
        *,
        frame_s: float,
        clearance_m: float,
        rng: np.random.Generator,
    ) -> tuple[tuple[Run, ...], TrafficCount]:
        """Runs with the vehicles that drive by in one world.

        `groups` are indices of runs that see the same traffic: one window of time for each group.
        All end at the same moment, so that runs of different speeds have their impact in the same.
        Who comes nearer than `clearance_m` to the VUT or the VRU of a run is left out of that run.
        Raises InputError if the file's traffic is shorter than a run or SUMO cannot drive the
        demand, MissingExtraError without SUMO.
        """
        members = {key: tuple(runs[index] for index in rows) for key, rows in groups.items()}
        trajectories, impact_s, count = self._windows(members, frame_s, rng)
        driven = list(runs)
        # A group's runs end together, but for runs whose impact is not on a frame.
        together = {
            (key, last_s): [row for row in rows if float(runs[row].time_s[-1]) == last_s]
            for key, rows in groups.items()
            for last_s in {float(runs[row].time_s[-1]) for row in rows}
        }
        for (key, _), rows in together.items():
            longest = max((runs[row] for row in rows), key=lambda run: len(run.time_s))
            window = cut_window(
                trajectories, longest.time_s + impact_s[key], middle_m=self.middle_m
            )
            if not window:
                count += TrafficCount(n_runs=len(rows))
                continue
            # In all weathers the encounter is the same; what is parked is so in most runs.
            in_parked: dict[tuple[int, ...], tuple[BoolArray, ...]] = {}
            left: dict[tuple[int, ...], tuple[tuple[MovingActor, ...], int]] = {}
            for index in rows:
                run = runs[index]
                parked = tuple(id(placed) for placed in run.obstruction)
                if parked not in in_parked:
                    in_parked[parked] = frames_in_parked(window, run.obstruction)
                key_of_run = (id(run.encounter), len(run.time_s), *parked)
                if key_of_run not in left:
                    left[key_of_run] = _driving_by(run, window, in_parked[parked], clearance_m)
                bodies, n_left_out = left[key_of_run]
                driven[index] = replace(run, traffic=bodies)
                count += TrafficCount(1, len(bodies) + n_left_out, n_left_out)
        return tuple(driven), count

    def _windows(
        self,
        members: Mapping[Any, tuple[Run, ...]],
        frame_s: float,
        rng: np.random.Generator,
    ) -> tuple[Trajectories, dict[Any, float], TrafficCount]:
        """Trajectories, when each group's impact is on their clock, and what SUMO could insert."""
        if self.network is not None:
            found = simulate_windows(
                self.network, self.demand, members, reach_m=REACH_M, step_s=frame_s, rng=rng
            )
            return (
                found.trajectories,
                found.impact_s,
                TrafficCount(n_departed=found.n_departed, n_waiting=found.n_waiting),
            )
        assert self.trajectories is not None
        first_s, last_s = self.trajectories.first_s, self.trajectories.last_s
        longest_s = max(-float(run.time_s[0]) for runs in members.values() for run in runs)
        n_choices = int((last_s - first_s - longest_s) / frame_s + _SAME_TIME_S) + 1
        if n_choices < 1:
            raise InputError(
                "traffic",
                Unquoted(f"{last_s - first_s:g} s of traffic"),
                f"at least as much as the longest run takes, {longest_s:g} s",
            )
        drawn = rng.integers(n_choices, size=len(members)).tolist()
        impact_s = {
            key: first_s + longest_s + number * frame_s
            for key, number in zip(members, drawn, strict=True)
        }
        return self.trajectories, impact_s, TrafficCount()


def _driving_by(
    run: Run,
    window: Sequence[MovingActor],
    in_parked: Sequence[BoolArray],
    clearance_m: float,
) -> tuple[tuple[MovingActor, ...], int]:
    """Vehicles of a window that drive by in a run, and how many are left out of it."""
    n_frames = len(run.time_s)
    near = [
        (body, bool(stands_in[-n_frames:].any()))
        for whole, stands_in in zip(window, in_parked, strict=True)
        if (body := last_frames(whole, n_frames)) is not None
    ]
    meets = meets_road_users(run, [body for body, _ in near], clearance_m=clearance_m)
    bodies = tuple(
        body
        for (body, is_in_parked), is_met in zip(near, meets, strict=True)
        if not (is_in_parked or is_met)
    )
    return bodies, len(near) - len(bodies)


def load_traffic(source: str, scene: Scene, *, offset: str = "") -> MovingTraffic:
    """Vehicles that drive by, as a question names them.

    The source is "sumo", a .toml file of demand for it, or a file of floating car data as SUMO
    writes it; `offset`, "EAST,NORTH" in metres, is added to the file's x and y. Raises InputError
    if it is none of these, not what it should be, or the offset is not two numbers;
    MissingExtraError if SUMO is asked for and not installed.
    """
    path = Path(source)
    middle: FloatArray = scene.outline_m.mean(axis=0)
    is_demand = source == SUMO or path.suffix.lower() == ".toml"
    if not is_demand and not path.name.lower().endswith(ENDINGS):
        known = f"{SUMO}, a .toml file of demand, or a file of FCD: " + ", ".join(ENDINGS)
        raise InputError("traffic", source, known)
    if is_demand:
        if offset:
            raise InputError(
                "traffic_offset", offset, "nothing: SUMO drives on the scene's own lanes"
            )
        demand = load_demand(None if source == SUMO else path)
        if importlib.util.find_spec("libsumo") is None:
            raise missing_sumo()
        network = build_network(
            scene, speed_limit_mps=demand.speed_limit_mps, approach_m=demand.approach_m
        )
        return MovingTraffic(
            name=f"SUMO, demand {demand.name}", middle_m=middle, demand=demand, network=network
        )
    demand = load_demand()
    trajectories = load_fcd(path, scene, demand, offset_m=_read_offset(offset), reach_m=REACH_M)
    return MovingTraffic(name=path.name, middle_m=middle, demand=demand, trajectories=trajectories)


def _read_offset(text: str) -> FloatArray | None:
    if not text:
        return None
    try:
        offset = np.array([float(word) for word in text.split(",")])
    except ValueError:
        offset = np.empty(0)
    if offset.shape != (2,) or not np.isfinite(offset).all():
        raise InputError("traffic_offset", text, "EAST,NORTH in metres, such as -120.5,33")
    return offset
