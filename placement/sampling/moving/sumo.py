"""A scene's lanes as a SUMO network, and the traffic on it.

The traffic is that of one sampled world. netconvert puts plain nodes and edges
together; the simulation runs in a child process (:mod:`.child`). Windows of
time, one per group of runs, follow one another with random pauses, so that each
meets another moment of the signal programme. In each, the VUT of one run is
moved along its path without braking; SUMO's vehicles react to it as to any
other. It obeys neither lights nor right of way, as Euro NCAP's does not: who
comes into its way is left out of the run by :mod:`.trajectories`.
"""

import importlib.util
import json
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from geometry.actors import Actor, MovingActor
from geometry.arrays import BoolArray, FloatArray
from geometry.errors import MissingExtraError, refuse
from geometry.junction import Arm, Junction, build_junction, lane_length_m
from geometry.lines import along_m, points_at
from geometry.opening import open_file, read_text
from geometry.scene import Lane, Scene
from geometry.writing import write_new
from scenarios.runs import Run

from ..driving import TrafficCount
from .demand import Demand, load_demand, write_routes
from .trajectories import (
    REACH_M,
    Trajectories,
    build_trajectories,
    cut_window,
    frames_in_parked,
    last_frames,
    meets_road_users,
)

JUNCTION = "junction"
# Lanes of an arm whose lengths differ by less go as far as one another.
_SAME_LENGTH_M = 5.0
# Pieces of an arm shorter than this are no edges of their own.
_SHORTEST_M = 8.0
_TURN_OF_DIRECTION = {
    "s": "straight",
    "l": "left",
    "L": "left",
    "r": "right",
    "R": "right",
}
_NETCONVERT_TIMEOUT_S = 60.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RoadNetwork:
    """A junction as SUMO knows it.

    Attributes
    ----------
    xml : str
        Content of the .net.xml file.
    origin_m : (2,) float
        Its origin in the world frame, whose axes it has. [m]
    n_entry_lanes : dict of str to int
        By arm.
    ways : dict of str to dict of str to dict of str to str
        By arm, turn, exit arm: the edges of the way.
    """

    xml: str
    origin_m: FloatArray
    n_entry_lanes: dict[str, int]
    ways: dict[str, dict[str, dict[str, str]]]


def sumo_program(name: str) -> str:
    """Path of one of SUMO's programs.

    Raises MissingExtraError where SUMO is not installed.
    """
    try:
        import sumo
    except ImportError:
        raise missing_sumo() from None
    found = shutil.which(name, path=str(Path(sumo.SUMO_HOME) / "bin"))
    if found is None:
        raise missing_sumo()
    return found


def missing_sumo() -> MissingExtraError:
    """The error that says how SUMO is installed."""
    return MissingExtraError(
        "`traffic` sumo needs SUMO: pip install place-rsus[traffic] (in a checkout: uv"
        " run --extra traffic place-rsus ..); without it, parked and waiting vehicles"
        " are drawn as always"
    )


def build_network(
    scene: Scene, *, speed_limit_mps: float, approach_m: float
) -> RoadNetwork:
    """Network of a scene's junction, connected by netconvert.

    The lanes are written as plain XML. Lanes keep their lines; arms that end sooner
    than `approach_m` go straight on. The map's own lanes through the junction are
    used where it has some. Lights stand where the scene has some; else priority is
    netconvert's. Raises InputError: no junction, no lane leads in or out, or
    netconvert cannot read the lanes; MissingExtraError: SUMO is not installed.
    """
    program = sumo_program("netconvert")
    junction = build_junction(scene)
    origin: FloatArray = scene.outline_m.mean(axis=0)
    plain = _Plain(origin_m=origin, speed_mps=speed_limit_mps, approach_m=approach_m)
    # Edges of each arm, into the junction and out of it.
    entry = {n: plain.add_arm(arm, is_in=True) for n, arm in junction.arms.items()}
    leaving = {n: plain.add_arm(arm, is_in=False) for n, arm in junction.arms.items()}
    entry, leaving = (
        {k: v for k, v in edges.items() if v} for edges in (entry, leaving)
    )
    if not entry or not leaving:
        if not entry:
            got = "no lane into the junction"
        else:
            got = "no lane out of it"
        refuse(f"{scene.name}: lanes", got, "lanes that are driven in both directions")
    plain.connect(junction)
    # Sites and things of the scene tell if there are lights.
    kinds = {site.kind for site in scene.sites} | {
        thing.class_name for thing in scene.instances
    }
    xml = _run_netconvert(program, plain, scene, has_lights="traffic light" in kinds)
    return RoadNetwork(
        xml=xml,
        origin_m=origin,
        n_entry_lanes={name: len(junction.arms[name].entry_lanes) for name in entry},
        ways=_find_ways(xml, entry, leaving, scene),
    )


class _Plain:
    """Nodes, edges and connections, as they are written."""

    def __init__(
        self, *, origin_m: FloatArray, speed_mps: float, approach_m: float
    ) -> None:
        self.origin_m = origin_m
        self.speed_mps = speed_mps
        self.approach_m = approach_m
        self.nodes: list[str] = []
        self.edges: list[str] = []
        self.connections: list[str] = []
        # Lane -> edge and index
        self.at_junction: dict[tuple[bool, str], tuple[str, int]] = {}

    def shape(self, points_m: FloatArray) -> str:
        """Points of the world frame, as SUMO writes them."""
        return " ".join(
            f"{x:.3f},{y:.3f}" for x, y in (points_m - self.origin_m).tolist()
        )

    def add_arm(self, arm: Arm, *, is_in: bool) -> list[str]:
        """Add the edges of an arm, and return them in driving order.

        Where a lane begins or ends, a new edge does.
        """
        if is_in:
            lanes = arm.entry_lanes
        else:
            lanes = arm.exit_lanes
        if not lanes:
            return []
        # Outwards from the junction: each lane as far as it goes, the longest ones
        # farther.
        outwards = [
            lane.centreline_m[::-1] if is_in else lane.centreline_m for lane in lanes
        ]
        length_m = np.array([lane_length_m(lane) for lane in lanes])
        # Distances at which lanes end, farthest last.
        cuts = [float(length_m.max())]
        for one in sorted(length_m.tolist(), reverse=True):
            if cuts[-1] - one > _SAME_LENGTH_M and one >= _SHORTEST_M:
                cuts.append(one)
        cuts = [0.0, *reversed(cuts)]
        stem = f"{arm.name}-out"
        if is_in:
            stem = f"{arm.name}-in"
        inner = JUNCTION
        names = []
        # One edge for each piece, outwards from the junction.
        for number, (near_m, far_m) in enumerate(pairwise(cuts)):
            is_last = number == len(cuts) - 2
            members = [
                (lane, _piece(points, near_m, min(far_m, own_m), far_m - near_m))
                for lane, points, own_m in zip(lanes, outwards, length_m, strict=True)
                if own_m > far_m - _SAME_LENGTH_M
            ]
            if is_last:
                more_m = max(0.0, self.approach_m - far_m)
                members = [
                    (lane, _straight_on(points, more_m)) for lane, points in members
                ]
            outer = f"{stem}-{number}"
            self._add_node(
                outer, np.mean([points[-1] for _, points in members], axis=0), is_last
            )
            name = f"{stem}-edge-{number}"
            ends = (inner, outer)
            if is_in:
                ends = (outer, inner)
            self._add_edge(name, members, ends, is_in)
            if number == 0:
                for index, (lane, _) in enumerate(members):
                    self.at_junction[is_in, lane.id] = (name, index)
            names.append(name)
            inner = outer
        if is_in:
            return names[::-1]
        return names

    def _add_node(self, name: str, position_m: FloatArray, is_end: bool) -> None:
        """Write a node in the coordinates of the network."""
        east, north = (position_m - self.origin_m).tolist()
        if is_end:
            kind = "dead_end"
        else:
            kind = "priority"
        self.nodes.append(
            f'<node id={quoteattr(name)} x="{east:.3f}" y="{north:.3f}" type="{kind}"/>'
        )

    def _add_edge(
        self,
        name: str,
        members: Sequence[tuple[Lane, FloatArray]],
        ends: tuple[str, str],
        is_in: bool,
    ) -> None:
        """Write an edge with its lanes, in driving direction."""
        lines = [points[::-1] if is_in else points for _, points in members]
        lanes = "".join(
            f'<lane index="{i}" width="{lane.width_m:.2f}" shape="{self.shape(line)}"/>'
            for i, ((lane, _), line) in enumerate(zip(members, lines, strict=True))
        )
        # The edge itself lies midway between its outermost lanes.
        middle = 0.5 * (lines[0][[0, -1]] + lines[-1][[0, -1]])
        begin, end = map(quoteattr, ends)
        self.edges.append(
            f"<edge id={quoteattr(name)} from={begin} to={end}"
            f' numLanes="{len(members)}" speed="{self.speed_mps:.3f}"'
            f' shape="{self.shape(middle)}">{lanes}</edge>'
        )

    def connect(self, junction: Junction) -> None:
        """Write the map's own lanes through the junction, where it has some."""
        # Each pair of an entry lane and an exit lane of another arm.
        for arm in junction.arms.values():
            for entry in arm.entry_lanes:
                for other in junction.arms.values():
                    if other is arm:
                        continue
                    for leaving in other.exit_lanes:
                        lane = junction.connection(entry, leaving)
                        begin = self.at_junction.get((True, entry.id))
                        end = self.at_junction.get((False, leaving.id))
                        if lane is None or begin is None or end is None:
                            continue
                        from_edge, from_lane = begin
                        to_edge, to_lane = end
                        line = self.shape(lane.centreline_m)
                        self.connections.append(
                            f"<connection from={quoteattr(from_edge)}"
                            f' to={quoteattr(to_edge)} fromLane="{from_lane}"'
                            f' toLane="{to_lane}" shape="{line}"/>'
                        )


def _piece(
    points: FloatArray, near_m: float, far_m: float, wanted_m: float
) -> FloatArray:
    """Part of a line between two distances from its begin.

    It goes straight on where the line ends sooner.
    """
    along = along_m(points)
    inside = points[(along > near_m + 0.01) & (along < far_m - 0.01)]
    ends = points_at(points, np.array([near_m, far_m]))
    part = np.concatenate([ends[:1], inside, ends[1:]])
    return _straight_on(part, max(0.0, wanted_m - (far_m - near_m)))


def _straight_on(points: FloatArray, more_m: float) -> FloatArray:
    if more_m < 0.01:
        return points
    ahead = points[-1] - points[-2]
    return np.concatenate([points, [points[-1] + more_m * ahead / np.hypot(*ahead)]])


def _run_netconvert(
    program: str, plain: _Plain, scene: Scene, *, has_lights: bool
) -> str:
    """Connect the plain files by netconvert; text of the network."""
    if has_lights:
        kind = "traffic_light"
    else:
        kind = "priority"
    outline = plain.shape(scene.outline_m)
    node = f'<node id="{JUNCTION}" x="0" y="0" type="{kind}" shape="{outline}"/>'
    # Three plain files go in, one network comes out.
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for ending, root, lines in (
            ("nod", "nodes", [node, *plain.nodes]),
            ("edg", "edges", plain.edges),
            ("con", "connections", plain.connections),
        ):
            text = "\n".join([f"<{root}>", *lines, f"</{root}>"])
            write_new(folder / f"plain.{ending}.xml", text)
        target = folder / "junction.net.xml"
        command = [
            program,
            *("-n", str(folder / "plain.nod.xml"), "-e", str(folder / "plain.edg.xml")),
            *("-x", str(folder / "plain.con.xml"), "-o", str(target)),
            *("--offset.disable-normalization", "true", "--no-turnarounds", "true"),
            *("--xml-validation", "never", "--no-warnings", "true"),
            *(("--lefthand", "true") if scene.keeps_left else ()),
        ]
        done = _run_program(command, timeout_s=_NETCONVERT_TIMEOUT_S)
        if done is None:
            refuse(scene.name, "no network", "lanes for netconvert")
        if done.returncode != 0 or not target.exists():
            reason = " ".join(done.stderr.split())
            refuse(f"{scene.name}: lanes", reason, "lanes that netconvert connects")
        return read_text(target, "XML")


def _find_ways(
    xml: str, entry: dict[str, list[str]], leaving: dict[str, list[str]], scene: Scene
) -> dict[str, dict[str, dict[str, str]]]:
    """Ways through the junction by arm, turn and exit arm.

    They are read from the connections of a network.
    """
    arm_in = {edges[-1]: arm for arm, edges in entry.items()}
    arm_out = {edges[0]: arm for arm, edges in leaving.items()}
    ways: dict[str, dict[str, dict[str, str]]] = {}
    # Each connection leads from an entry arm to an exit arm by a turn.
    for connection in re.findall(r"<connection ([^>]*)/>", xml):
        found = dict(re.findall(r'(\w+)="([^"]*)"', connection))
        arm = arm_in.get(found["from"])
        other = arm_out.get(found["to"])
        turn = _TURN_OF_DIRECTION.get(found.get("dir", ""))
        if arm is None or other is None or turn is None or arm == other:
            continue
        edges = " ".join([*entry[arm], *leaving[other]])
        ways.setdefault(arm, {}).setdefault(turn, {})[other] = edges
    if not ways:
        refuse(
            f"{scene.name}: lanes", "no way through the junction", "lanes in and out"
        )
    return ways


# ---------- simulation
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
        Vehicles that entered the network until the end, and those that found no room
        to.
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
    """Drive traffic long enough to cut a window for each group of runs.

    Parameters
    ----------
    network : RoadNetwork
        Of the scene's lanes.
    demand : Demand
        How much drives, where to and with what.
    groups : mapping of tuple of Run
        Runs that share a window, at least one in each group. It is as long as the
        longest; the VUT is that of the run in the middle of their speeds.
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
    # Windows follow one another in random order, with random pauses.
    order = [keys[index] for index in rng.permutation(len(keys)).tolist()]
    pauses_s = rng.uniform(*demand.pause_s, size=len(order))
    now = round(demand.warm_up_s / step_s)
    windows = []
    impact_s = {}
    # Each window is as long as the longest run of its group.
    for key, pause_s in zip(order, pauses_s.tolist(), strict=True):
        runs = groups[key]
        n_frames = max(len(run.time_s) for run in runs)
        first = now + max(1, round(pause_s / step_s))
        now = first + n_frames
        impact_s[key] = now * step_s
        middle = sorted(runs, key=lambda run: run.vut_speed_kmh)[len(runs) // 2]
        vut_drive = _vut_drive(middle, network, last_step=now)
        windows.append({"first_step": first, "last_step": now, "vut": vut_drive})
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
    found = _run(
        job, network, write_routes(demand, network.ways, network.n_entry_lanes)
    )
    # Samples become trajectories in the world frame.
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


def _vut_drive(
    run: Run, network: RoadNetwork, *, last_step: int
) -> dict[str, Any] | None:
    """Drive of a run's VUT, step by step, as the child wants it.

    None where it has no lane. It takes the way through the junction that leads most
    nearly where its path points.
    """
    turns = network.ways.get(run.approach, {})
    first, last = run.vut_yaw_deg[[0, -1]].tolist()
    # The way is the one that turns as the VUT's path does.
    turned_deg = (last - first + 180.0) % 360.0 - 180.0
    if abs(turned_deg) < 30.0:
        wanted = "straight"
    elif turned_deg > 0.0:
        wanted = "left"
    else:
        wanted = "right"
    exits = turns.get(wanted) or next(iter(turns.values()), {})
    leaving = next(iter(exits.values()), "")
    if not leaving:
        return None
    # SUMO places vehicles by the middle of the front bumper.
    yaw = np.radians(run.vut_yaw_deg)
    ahead = np.column_stack([np.cos(yaw), np.sin(yaw)])
    front = (
        run.vut_position_m + 0.5 * run.encounter.vut.length_m * ahead - network.origin_m
    )
    return {
        "first_step": last_step - len(run.time_s) + 1,
        "edges": leaving.split(),
        "front_m": np.round(front, 3).tolist(),
        "angle_deg": np.round(90.0 - run.vut_yaw_deg, 3).tolist(),
        "speed_mps": run.vut_speed_kmh / 3.6,
    }


def _run(job: dict[str, Any], network: RoadNetwork, routes: str) -> dict[str, Any]:
    """Run the child process on a job, and read its arrays."""
    child = Path(__file__).with_name("child.py")
    # Job and results are files: the process shares nothing else.
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        paths = {key: folder / f"junction.{key}.xml" for key in ("network", "routes")}
        write_new(paths["network"], network.xml)
        write_new(paths["routes"], routes)
        given = folder / "job.json"
        found = folder / "found.npz"
        write_new(
            given, json.dumps(job | {key: str(path) for key, path in paths.items()})
        )
        command = [sys.executable, "-I", str(child), str(given), str(found)]
        done = _run_program(command, timeout_s=_TIMEOUT_S)
        if done is None:
            got = f"a simulation that takes more than {_TIMEOUT_S:g} s"
            refuse("traffic", got, "less demand, or fewer runs")
        if done.returncode != 0:
            lines = done.stderr.split("\n")
            reason = next(
                (line for line in reversed(lines) if line.strip()), "no reason given"
            )
            refuse("traffic", reason.strip(), "traffic that SUMO drives")
        with open_file(found) as file, np.load(file, allow_pickle=False) as stored:
            return {key: stored[key] for key in stored.files}


def _run_program(
    command: Sequence[str], *, timeout_s: float
) -> subprocess.CompletedProcess[str] | None:
    """Run a program to its end; None where that takes too long."""
    how: dict[str, Any] = {"capture_output": True, "text": True, "check": False}
    try:
        return subprocess.run(command, timeout=timeout_s, **how)
    except subprocess.TimeoutExpired:
        return None


# ---------- vehicles that drive by in sampled worlds


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SumoTraffic:
    """Where vehicles that drive by come from.

    Attributes
    ----------
    name : str
        In reports.
    middle_m : (2,) float
        Middle of the junction. World frame. [m]
    demand : Demand
        What SUMO drives.
    network : RoadNetwork
        On which SUMO drives it, anew in each world.
    """

    name: str
    middle_m: FloatArray
    demand: Demand
    network: RoadNetwork

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

        Parameters
        ----------
        runs : sequence of Run
            With all that is parked.
        groups : mapping of sequence of int
            Indices of runs that see the same traffic: one window of time for each
            group. All end at the same moment, so that runs of different speeds have
            their impact in the same.
        frame_s : float
            From frame to frame. [s]
        clearance_m : float
            Who comes nearer to the VUT or the VRU of a run is left out of that run. [m]
        rng : numpy.random.Generator
            Of the world.

        Raises
        ------
        InputError
            The file's traffic is shorter than a run, or SUMO cannot drive the demand.
        MissingExtraError
            SUMO is not installed.
        """
        # All groups drive in one simulation.
        members = {
            key: tuple(runs[index] for index in rows) for key, rows in groups.items()
        }
        found = simulate_windows(
            self.network, self.demand, members, reach_m=REACH_M, step_s=frame_s, rng=rng
        )
        count = TrafficCount(n_departed=found.n_departed, n_waiting=found.n_waiting)
        driven = list(runs)
        # A group's runs end together, but for runs whose impact is not on a frame.
        together = {
            (key, last_s): [
                row for row in rows if float(runs[row].time_s[-1]) == last_s
            ]
            for key, rows in groups.items()
            for last_s in {float(runs[row].time_s[-1]) for row in rows}
        }
        # Runs that end at the same moment share a window.
        for (key, _), rows in together.items():
            longest = max((runs[row] for row in rows), key=lambda run: len(run.time_s))
            time_s = longest.time_s + found.impact_s[key]
            window = cut_window(found.trajectories, time_s, middle_m=self.middle_m)
            if not window:
                count += TrafficCount(n_runs=len(rows))
                continue
            # In all weathers the encounter is the same; what is parked is so in most
            # runs.
            in_parked: dict[tuple[int, ...], tuple[BoolArray, ...]] = {}
            left: dict[tuple[int, ...], tuple[tuple[MovingActor, ...], int]] = {}
            for index in rows:
                run = runs[index]
                parked = tuple(id(placed) for placed in run.obstruction)
                if parked not in in_parked:
                    in_parked[parked] = frames_in_parked(window, run.obstruction)
                key_of_run = (id(run.encounter), len(run.time_s), *parked)
                if key_of_run not in left:
                    left[key_of_run] = _driving_by(
                        run, window, in_parked[parked], clearance_m
                    )
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
    """Vehicles of a window that drive by in a run.

    The second value says how many are left out.
    """
    n_frames = len(run.time_s)
    # Vehicles that are in the frames of the run at all.
    near = [
        (body, bool(stands_in[-n_frames:].any()))
        for whole, stands_in in zip(window, in_parked, strict=True)
        if (body := last_frames(whole, n_frames)) is not None
    ]
    meets = meets_road_users(run, [body for body, _ in near], clearance_m=clearance_m)
    # Who stands in something parked, or is in the way, is left out.
    bodies = tuple(
        body
        for (body, is_in_parked), is_met in zip(near, meets, strict=True)
        if not (is_in_parked or is_met)
    )
    return bodies, len(near) - len(bodies)


def load_default_traffic(_source: str, scene: Scene) -> SumoTraffic:
    """Vehicles of the default demand. MissingExtraError without SUMO."""
    return _traffic_of(load_demand(), scene)


def load_traffic_of_file(source: str, scene: Scene) -> SumoTraffic:
    """Vehicles of a .toml file of demand.

    Raises InputError if the file is not what it should be; MissingExtraError without
    SUMO.
    """
    return _traffic_of(load_demand(Path(source)), scene)


def _traffic_of(demand: Demand, scene: Scene) -> SumoTraffic:
    if importlib.util.find_spec("libsumo") is None:
        raise missing_sumo()
    network = build_network(
        scene, speed_limit_mps=demand.speed_limit_mps, approach_m=demand.approach_m
    )
    middle: FloatArray = scene.outline_m.mean(axis=0)
    return SumoTraffic(
        name=f"SUMO, demand {demand.name}",
        middle_m=middle,
        demand=demand,
        network=network,
    )
