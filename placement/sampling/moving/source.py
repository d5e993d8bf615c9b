"""Vehicles that drive by in sampled worlds, from SUMO."""

import importlib.util
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from geometry.actors import MovingActor
from geometry.arrays import BoolArray, FloatArray
from geometry.errors import InputError
from geometry.scene import Scene
from scenarios.runs import Run

from .demand import Demand, load_demand
from .sumo import RoadNetwork, build_network, missing_sumo, simulate_windows
from .trajectories import (
    REACH_M,
    TrafficCount,
    cut_window,
    frames_in_parked,
    last_frames,
    meets_road_users,
)

SUMO = "sumo"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovingTraffic:
    """Where vehicles that drive by come from."""

    name: str  # in reports
    middle_m: FloatArray  # (2,): middle of the junction. World frame. [m]
    demand: Demand  # what SUMO drives
    network: RoadNetwork  # on which SUMO drives it, anew in each world

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

        `groups` are indices of runs that see the same window of time, which all end at the same
        moment. Who comes nearer than `clearance_m` to the VUT or the VRU of a run is left out of
        it. Raises InputError if SUMO cannot drive the demand, MissingExtraError without SUMO.
        """
        members = {key: tuple(runs[index] for index in rows) for key, rows in groups.items()}
        found = simulate_windows(
            self.network, self.demand, members, reach_m=REACH_M, step_s=frame_s, rng=rng
        )
        count = TrafficCount(n_departed=found.n_departed, n_waiting=found.n_waiting)
        driven = list(runs)
        # A group's runs end together, but for runs whose impact is not on a frame.
        together = {
            (key, last_s): [row for row in rows if float(runs[row].time_s[-1]) == last_s]
            for key, rows in groups.items()
            for last_s in {float(runs[row].time_s[-1]) for row in rows}
        }
        for (key, _), rows in together.items():
            longest = max((runs[row] for row in rows), key=lambda run: len(run.time_s))
            time_s = longest.time_s + found.impact_s[key]
            window = cut_window(found.trajectories, time_s, middle_m=self.middle_m)
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


def load_traffic(source: str, scene: Scene) -> MovingTraffic:
    """Vehicles that drive by, as a question names them: "sumo", or a .toml file of demand for it.

    Raises InputError if it is not what it should be; MissingExtraError without SUMO.
    """
    path = Path(source)
    if source != SUMO and path.suffix.lower() != ".toml":
        raise InputError("traffic", source, f"{SUMO}, or a .toml file of demand for it")
    demand = load_demand(None if source == SUMO else path)
    if importlib.util.find_spec("libsumo") is None:
        raise missing_sumo()
    network = build_network(
        scene, speed_limit_mps=demand.speed_limit_mps, approach_m=demand.approach_m
    )
    middle: FloatArray = scene.outline_m.mean(axis=0)
    return MovingTraffic(
        name=f"SUMO, demand {demand.name}", middle_m=middle, demand=demand, network=network
    )
