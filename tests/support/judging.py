"""Programs of others on what this project writes: exports, runs and proofs.

``uv run --group judges pytest -m judges tests/experiments/test_judges.py`` asks them.
uv makes the environments of those that cannot live in ours (``judging_apart.py``).
"""

import json
import shutil
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from experiments.export.carla import to_carla
from experiments.export.cpm import RELEASES, build_stations
from experiments.export.opendrive import to_opendrive
from experiments.export.openscenario import to_openscenario
from experiments.export.uper import CONTAINERS, encode
from experiments.export.watched import watch_run
from geometry.actors import load_actors
from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.poses import camera_rotation
from geometry.study_scene import load_study_scene
from placement.layout import load_carlancap_layout
from scenarios.aeb import load_aeb_rule
from scenarios.cases import load_cases
from scenarios.runs import Run, build_runs

APART = {
    "xosc": ("asam-qc-openscenarioxml==1.0.0", "lxml<6"),
    "xodr": ("asam-qc-opendrive==1.0.0", "lxml<6"),
    "carla": ("carla==0.9.16",),
    "touch": ("commonroad-drivability-checker==2025.4.0",),
}
"""Packages of each judge that has an environment of its own."""
STEP_S = 0.01  # within which a judge has to find the impact
_AFTER_S = 0.1  # how long bodies drive on behind the impact
_EPSILON = 1.0e-6  # s, of times of frames; of an APR


class NoJudge(Exception):
    """A judge cannot be had here: there is no uv, or no package."""


def judge_apart(kind: str, folder: Path) -> Any:
    """Answer of a judge of ``judging_apart.py`` in an environment that uv makes for
    it.
    """
    uv = shutil.which("uv")
    if uv is None:
        raise NoJudge(f"{APART[kind][0]} needs uv, which makes its environment")
    python = f"{sys.version_info.major}.{sys.version_info.minor}"
    base = [uv, "run", "--quiet", "--isolated", "--no-project", "--python", python]
    for package in APART[kind]:
        base += ["--with", package]
    base.append("python")
    tried = subprocess.run([*base, "-c", ""], capture_output=True, check=False)
    if tried.returncode:
        raise NoJudge(f"uv cannot make an environment with {', '.join(APART[kind])}")
    script = Path(__file__).with_name("judging_apart.py")
    command = [*base, str(script), kind, str(folder)]
    done = subprocess.run(command, capture_output=True, check=True, text=True)
    return json.loads(done.stdout)


def lay_all_cases() -> list[Run]:
    """All runs of all cases at the study's junction by day."""
    runs, _ = build_runs(
        load_study_scene(),
        list(load_cases().values()),
        vut=load_actors()["vut"],
        rule=load_aeb_rule(),
    )
    return list(runs)


# ---------- exports
def judge_openscenario(runs: Sequence[Run], folder: Path) -> Any:
    """ASAM's checker on one run of every case: how many files, statuses of checks,
    issues.
    """
    firsts = {run.case.name: run for run in reversed(runs)}
    roads = to_opendrive(None, load_study_scene())
    (folder / "roads.xodr").write_text(roads)
    for case, run in firsts.items():
        text = to_openscenario(run, road_network="roads.xodr")
        (folder / f"{case}.xosc").write_text(text)
    return judge_apart("xosc", folder)


def judge_opendrive(folder: Path) -> Any:
    """ASAM's checker on the study's roads, and on the same in traffic that keeps
    left.
    """
    scene = load_study_scene()
    flip = np.array([1.0, -1.0])
    lanes = tuple(
        replace(lane, centreline_m=lane.centreline_m * flip) for lane in scene.lanes
    )
    left = replace(
        scene, lanes=lanes, outline_m=scene.outline_m * flip, keeps_left=True
    )
    for side, one in (
        ("right", scene),
        ("left", left),
    ):
        text = to_opendrive(load_carlancap_layout(), one)
        (folder / f"{side}.xodr").write_text(text)
    return judge_apart("xodr", folder)


def judge_carla(folder: Path) -> float:
    """Largest difference of CARLA's classes of places and turns from ours, south for
    north.

    Of the study's 12 cameras [m; parts of a unit vector]; infinite if one is missing.
    Blueprints and attributes are known to CARLA's server alone and not checked.
    """
    layout = load_carlancap_layout()
    (folder / "layout.json").write_text(to_carla(layout))
    axes = judge_apart("carla", folder)["axes"]
    if len(axes) != len(layout.units):
        return float("inf")
    off = 0.0
    for unit in layout.units:
        right, down, ahead = camera_rotation(unit.pose.yaw_deg, unit.pose.pitch_deg).T
        ours = np.array([unit.pose.position_m, ahead, right, -down]) * [1.0, -1.0, 1.0]
        off = max(off, float(np.abs(ours - axes[unit.id]).max()))

    return off


def judge_messages(folder: Path) -> list[bool]:
    """Whether ETSI's own modules decode each message of a run to what was written.

    `folder` has the modules ``CPM-*.asn`` and a dictionary of ETSI TS 102 894-2, V2.1.1
    or V2.4.1.
    """
    import asn1tools

    paths = sorted(folder.glob("*.asn"))
    is_old = any(
        "stationaryHorizontal" in path.read_text(encoding="latin-1") for path in paths
    )
    if is_old:
        release = RELEASES[0]
    else:
        release = RELEASES[1]
    uper = asn1tools.compile_files(
        [str(path) for path in paths], "uper", encoding="latin-1"
    )
    layout = load_carlancap_layout()
    scene = load_study_scene()
    watched = watch_run(layout, scene, "CPNC-50/east/40")
    is_equal = []
    for station in build_stations(layout, scene, watched, release=release):
        for message in station.messages:
            found = uper.decode("CollectivePerceptionMessage", encode(message, release))
            for container in found["payload"]["cpmContainers"]:
                name = CONTAINERS[container["containerId"]]
                container["containerData"] = uper.decode(
                    name, container["containerData"]
                )
            is_equal.append(_as_json(found) == message)

    return is_equal


def _as_json(value: Any) -> Any:
    """Values of asn1tools as JSON has them: a choice is an object with one key."""
    if isinstance(value, tuple):
        return {value[0]: _as_json(value[1])}
    if isinstance(value, dict):
        return {key: _as_json(one) for key, one in value.items()}
    if isinstance(value, list):
        return [_as_json(one) for one in value]
    return value


# ---------- runs
def judge_impacts(runs: Sequence[Run], folder: Path, n_runs: int = 100) -> FloatArray:
    """How far the first touch is from the impact, by CommonRoad's collision checker,
    (n_runs,).

    Both rectangles in steps of 0.01 s [s]; infinite where they never touch.
    """
    places = np.linspace(0, len(runs) - 1, n_runs).round().astype(int)
    for index, run in enumerate([runs[place] for place in places]):
        met = run.encounter
        n_steps = round((_AFTER_S - run.time_s[0]) / STEP_S)
        time_s = STEP_S * (np.arange(n_steps + 1) - n_steps) + _AFTER_S
        pose = []
        for motion in (met.vut_motion, met.vru_motion):
            position_m, yaw_deg = motion.path.at(motion.distance_m(time_s))
            pose.append(np.column_stack([position_m, np.radians(yaw_deg)]))
        sizes = [
            [0.5 * body.length_m, 0.5 * body.width_m] for body in (met.vut, met.vru)
        ]
        path = folder / f"{index}.npz"
        np.savez(
            path,
            id=run.id,
            time_s=time_s,
            pose=np.array(pose),
            half_sizes=sizes,
        )

    touch_s = judge_apart("touch", folder)["touch_s"].values()
    return np.abs([np.inf if one is None else one for one in touch_s])


# ---------- proofs
@dataclass(frozen=True, slots=True, kw_only=True)
class Proof:
    """What SCIP proves of the highest APR, beside what ``summary.json`` says."""

    status: str
    apr: float
    bound: float
    said_apr: float
    said_bound: float

    @property
    def is_same(self) -> bool:
        """True if SCIP ended, and both say the same within a millionth."""
        is_same_apr = abs(self.apr - self.said_apr) < _EPSILON
        is_same_bound = abs(self.bound - self.said_bound) < _EPSILON
        return self.status == "optimal" and is_same_apr and is_same_bound


def prove_with_scip(path: Path = Path("results/budget-3")) -> Proof:
    """SCIP on ``instance.npz``, read as docs/formats.md describes it.

    Nothing of :mod:`placement` is called: no presolve, no bound, no rule of when a run
    is avoided. The model has a variable per pose and per run, and rows "this run is
    avoided only if one of these poses is chosen": all but a largest set of poses that
    together do not avoid it. These rows hold for every layout, so SCIP's bound does,
    too. Rows are added until the layout found is worth as much as the bound. That holds
    since more frames never make a run unavoided.
    """
    from pyscipopt import Model, quicksum

    answer = json.loads((path / "summary.json").read_text())
    # Another layout may have been chosen.
    stage = (answer["highest"] or answer)["stages"][0]
    with np.load(path / "instance.npz", allow_pickle=False) as file:
        instance = dict(file)
    runs = _read_runs(instance)
    model = Model()
    model.hideOutput()
    chosen = [model.addVar(vtype="B") for _ in instance["site_index"]]
    model.addCons(quicksum(chosen) <= int(instance["budget_units"]))
    for site, capacity in enumerate(instance["site_capacity"].tolist()):
        poses = np.flatnonzero(instance["site_index"] == site)
        model.addCons(quicksum(chosen[pose] for pose in poses) <= capacity)
    counted = np.array(
        [
            weight if one.avoids(one.seen_by(slice(None))) else 0.0
            for one, weight in zip(runs, instance["weight"], strict=True)
        ]
    )
    avoided = [model.addVar(ub=1.0) for _ in runs]
    model.setObjective(
        quicksum(w * a for w, a in zip(counted, avoided, strict=True)), "maximize"
    )
    layout: list[int] = []
    apr = -1.0
    bound = 1.0
    n_rounds = 0
    while bound > apr + _EPSILON:
        rng = np.random.default_rng(n_rounds)
        for one, weight, variable in zip(runs, counted, avoided, strict=True):
            for order in (
                one.orders(rng)
                if weight and not one.avoids(one.seen_by(layout))
                else ()
            ):
                poses = np.flatnonzero(~one.largest_without(one.seen_by(layout), order))
                model.addCons(variable <= quicksum(chosen[pose] for pose in poses))

        model.optimize()
        layout = [pose for pose, one in enumerate(chosen) if model.getVal(one) > 0.5]
        apr = float(sum(counted[[one.avoids(one.seen_by(layout)) for one in runs]]))
        bound = model.getDualbound()
        status = model.getStatus()
        n_rounds += 1
        model.freeTransform()

    return Proof(
        status=status,
        apr=apr,
        bound=bound,
        said_apr=stage["objective"],
        said_bound=stage["bound"],
    )


@dataclass(
    frozen=True,
    slots=True,
    kw_only=True,
    eq=False,
)
class _InstanceRun:
    """A run of ``instance.npz``: its frames before the last moment, and who detects in
    them.
    """

    sees: BoolArray  # (n_poses, n_frames)
    time_s: FloatArray
    moment_s: float
    memory_s: float
    n_confirmations: int

    def seen_by(self, layout: Sequence[int] | slice) -> BoolArray:
        return np.asarray(self.sees[layout].any(axis=0), dtype=bool)

    def avoids(self, seen: BoolArray) -> bool:
        return bool(
            _avoids(
                seen, self.time_s, self.moment_s, self.memory_s, self.n_confirmations
            )
        )

    def orders(self, rng: np.random.Generator) -> list[IntArray]:
        """Orders in which poses join a set: few frames first, many first, and some at
        random.
        """
        n_frames = self.sees.sum(axis=1)
        some = [rng.permutation(len(self.sees)) for _ in range(4)]
        return [np.argsort(n_frames), np.argsort(-n_frames), *some]

    def largest_without(self, seen: BoolArray, order: IntArray) -> BoolArray:
        """Poses of a largest set that does not avoid the run, frames in `seen`
        given.
        """
        rule = (self.time_s, self.moment_s, self.memory_s, self.n_confirmations)
        known = _join(self.sees, seen, order, *rule)
        return np.asarray(~(self.sees & ~known).any(axis=1), dtype=bool)


def _read_runs(instance: dict[str, Any]) -> list[_InstanceRun]:
    """Runs of an instance, as its file has them."""
    time_s = instance["time_s"]
    sees = (
        np.unpackbits(instance["packed"], axis=1, bitorder="little", count=len(time_s))
        > 0
    )
    runs = []
    for run, last_brake_time_s in enumerate(instance["last_brake_time_s"].tolist()):
        moment_s = last_brake_time_s - float(instance["latency_s"])
        frames = np.arange(*instance["run_start"][run : run + 2])
        frames = frames[time_s[frames] <= moment_s + _EPSILON]
        runs.append(
            _InstanceRun(
                sees=np.ascontiguousarray(sees[:, frames]),
                time_s=time_s[frames],
                moment_s=moment_s,
                memory_s=float(instance["track_memory_s"]) + _EPSILON,
                n_confirmations=int(instance["n_confirmations"]),
            )
        )

    return runs


@njit
def _avoids(
    seen: BoolArray, time_s: FloatArray, moment_s: float, memory_s: float, n: int
) -> bool:
    """True if a track is confirmed and alive at the last moment."""
    in_a_row = 0
    last_s = -np.inf
    is_confirmed = False
    for frame in range(len(time_s)):
        if not seen[frame]:
            in_a_row = 0
            continue
        is_confirmed = is_confirmed and time_s[frame] - last_s <= memory_s
        in_a_row = in_a_row + 1
        last_s = time_s[frame]
        is_confirmed = is_confirmed or in_a_row >= n

    return is_confirmed and moment_s - last_s <= memory_s


@njit
def _join(
    sees: BoolArray,
    seen: BoolArray,
    order: IntArray,
    time_s: FloatArray,
    moment_s: float,
    memory_s: float,
    n: int,
) -> BoolArray:
    """Frames that are seen when poses join one after the other, unless the run is
    avoided then.
    """
    known = seen.copy()
    for pose in order:
        more = known | sees[pose]
        if not _avoids(more, time_s, moment_s, memory_s, n):
            known = more

    return known
