"""Traffic of one sampled world by SUMO: windows of time, one per group of runs, each with its VUT.

The simulation runs in a child process (:mod:`.child`). Windows follow one another with pauses of
random length between them, so that each meets another moment of the signal programme. In each, the
VUT of one run of the group is moved along its path without braking, and the vehicles of SUMO react
to it as to any other: they follow it, keep their gaps and do not change lanes into it. It obeys
neither lights nor right of way, as Euro NCAP's does not: who has a green light may come into its
way, and is left out of the run by :mod:`.windows`.
"""

import json
import subprocess
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from geometry.actors import Actor
from geometry.arrays import FloatArray
from geometry.errors import InputError, Unquoted
from geometry.files import open_file, write_new
from scenarios.runs import Run

from .demand import Demand, write_routes
from .network import JUNCTION, RoadNetwork
from .trajectories import Trajectories, build_trajectories

_TIMEOUT_S = 900.0
_LONGEST_BODY_M = 20.0
_MAX_SEED = 2**31 - 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SimulatedWindows:
    """What SUMO drove.

    Attributes
    ----------
    trajectories : Trajectories
        Vehicles near the junction, on the simulation's clock.
    impact_s : dict
        By group: when its runs end. [s]
    n_departed, n_waiting : int
        Vehicles that entered the network until the end, and those that found no room to.
    """

    trajectories: Trajectories
    impact_s: dict[Any, float]
    n_departed: int
    n_waiting: int


def simulate_windows(
    network: RoadNetwork,
    demand: Demand,
    groups: Mapping[Any, tuple[Run, ...]],
    *,
    reach_m: float,
    step_s: float,
    rng: np.random.Generator,
) -> SimulatedWindows:
    """Drive traffic through a junction long enough to cut one window for each group of runs.

    Parameters
    ----------
    network : RoadNetwork
        Of the scene's lanes.
    demand : Demand
        How much drives, where to and with what.
    groups : mapping of tuple of Run
        Runs that share a window, at least one in each group. It is as long as the longest; the VUT
        is that of the run in the middle of their speeds.
    reach_m : float
        Vehicles farther from the middle of the junction are not told. [m]
    step_s : float
        Of the simulation, and from frame to frame of the runs. [s]
    rng : numpy.random.Generator
        Of order and pauses of the windows, and SUMO's seed.

    Raises
    ------
    InputError
        The demand does not fit the junction, or SUMO cannot drive it.
    MissingExtraError
        SUMO is not installed.
    """
    seed = int(rng.integers(_MAX_SEED))
    keys = list(groups)
    order = [keys[index] for index in rng.permutation(len(keys)).tolist()]
    pauses_s = rng.uniform(*demand.pause_s, size=len(order))
    now = round(demand.warm_up_s / step_s)
    windows, impact_s = [], {}
    for key, pause_s in zip(order, pauses_s.tolist(), strict=True):
        runs = groups[key]
        n_frames = max(len(run.time_s) for run in runs)
        first = now + max(1, round(pause_s / step_s))
        now = first + n_frames
        impact_s[key] = now * step_s
        middle = sorted(runs, key=lambda run: run.vut_speed_kmh)[len(runs) // 2]
        windows.append(
            {
                "first_step": first,
                "last_step": now,
                "vut": _vut_drive(middle, network, last_step=now),
            }
        )
    vut = next(iter(groups.values()))[0].encounter.vut
    job = {
        "seed": seed,
        "step_s": step_s,
        "junction": JUNCTION,
        "reach_m": reach_m + _LONGEST_BODY_M,
        "first_type": demand.vehicles[0].actor.name,
        "vut": {"length": vut.length_m, "width": vut.width_m, "height": vut.height_m},
        "windows": windows,
    }
    found = _run(job, network, write_routes(demand, network.ways, network.n_entry_lanes))
    samples: FloatArray = found["samples"]
    known = {kind.actor.name: kind.actor for kind in demand.vehicles}
    bodies: tuple[Actor, ...] = tuple(known[name] for name in found["types"].tolist())
    return SimulatedWindows(
        trajectories=build_trajectories(
            bodies,
            vehicle=samples[:, 0].astype(np.int64),
            time_s=samples[:, 1] * step_s,
            front_m=samples[:, 2:4] + network.origin_m,
            angle_deg=samples[:, 4],
            step_s=step_s,
            span_s=(0.0, now * step_s),
        ),
        impact_s=impact_s,
        n_departed=int(found["n_departed"]),
        n_waiting=int(found["n_waiting"]),
    )


def _vut_drive(run: Run, network: RoadNetwork, *, last_step: int) -> dict[str, Any] | None:
    """Where the VUT of a run is, step by step, as the child wants it; None where it has no lane."""
    leaving = _exits(run, network)
    if run.approach not in network.entry_edges or not leaving:
        return None
    yaw = np.radians(run.vut_yaw_deg)
    ahead = np.column_stack([np.cos(yaw), np.sin(yaw)])
    front = run.vut_position_m + 0.5 * run.encounter.vut.length_m * ahead - network.origin_m
    return {
        "first_step": last_step - len(run.time_s) + 1,
        "edges": leaving.split(),
        "front_m": np.round(front, 3).tolist(),
        "angle_deg": np.round(90.0 - run.vut_yaw_deg, 3).tolist(),
        "speed_mps": run.vut_speed_kmh / 3.6,
    }


def _exits(run: Run, network: RoadNetwork) -> str:
    """Edges of the way through the junction that leads most nearly where the VUT's path points."""
    turns = network.ways.get(run.approach, {})
    first, last = run.vut_yaw_deg[[0, -1]].tolist()
    turned_deg = (last - first + 180.0) % 360.0 - 180.0
    wanted = "straight" if abs(turned_deg) < 30.0 else "left" if turned_deg > 0.0 else "right"
    exits = turns.get(wanted) or next(iter(turns.values()), {})
    return next(iter(exits.values()), "")


def _run(job: dict[str, Any], network: RoadNetwork, routes: str) -> dict[str, Any]:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths = {key: folder / f"junction.{key}.xml" for key in ("network", "routes")}
        write_new(paths["network"], network.xml)
        write_new(paths["routes"], routes)
        given, found = folder / "job.json", folder / "found.npz"
        write_new(given, json.dumps(job | {key: str(path) for key, path in paths.items()}))
        try:
            done = subprocess.run(
                [sys.executable, "-I", str(_CHILD), str(given), str(found)],
                capture_output=True,
                text=True,
                timeout=_TIMEOUT_S,
                check=False,
            )
        except subprocess.TimeoutExpired:
            got = Unquoted(f"a simulation that takes more than {_TIMEOUT_S:g} s")
            raise InputError("--traffic sumo", got, "less demand, or fewer runs") from None
        if done.returncode != 0:
            lines = done.stderr.split("\n")
            reason = next((line for line in reversed(lines) if line.strip()), "no reason told")
            raise InputError("--traffic sumo", Unquoted(reason.strip()), "traffic that SUMO drives")
        with open_file(found) as file, np.load(file, allow_pickle=False) as stored:
            return {key: stored[key] for key in stored.files}


_CHILD = Path(__file__).with_name("child.py")
