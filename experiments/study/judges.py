"""Exports, runs and proofs, judged by others' programs: ``python -m experiments.study.judges``.

Needs the group ``judges`` and uv, which makes the environments of judges that cannot live in ours.
"""

import importlib.metadata
import json
import shutil
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click
import numpy as np
from numba import njit

from geometry.actors import load_actors
from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.errors import MissingExtraError
from geometry.files import write_atomically
from geometry.poses import camera_rotation
from geometry.study_scene import load_study_scene
from placement.layout import load_carlancap_layout
from scenarios.aeb import load_aeb_rule
from scenarios.cases import load_cases
from scenarios.runs import Run, build_runs

from ..results.tables import page_of

APART = {
    "xosc": ("asam-qc-openscenarioxml==1.0.0", "lxml<6"),
    "xodr": ("asam-qc-opendrive==1.0.0", "lxml<6"),
    "carla": ("carla==0.9.16",),
    "touch": ("commonroad-drivability-checker==2025.4.0",),
}
"""Packages of each judge that has an environment of its own."""
STEP_S = 0.01  # within which a judge has to find the impact
_AFTER_S = 0.1  # how long bodies drive on behind the impact
_EPSILON = 1.0e-6  # s, of times of frames
_VAM_RUNS = ("CPNC-50/east/40", "CBTAfs-100/north/20", "CMCscp-near/north/30x50")


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """What a judge says of a format: a row of ``results/judges.md``."""

    what: str
    judge: str
    checked: str
    result: str
    is_passed: bool


def judge_apart(kind: str, folder: Path) -> Any:
    """Answer of a judge of :mod:`.judging_apart` in an environment that uv makes for it.

    Raises MissingExtraError if there is no uv, or the environment cannot be made.
    """
    uv = shutil.which("uv")
    if uv is None:
        raise MissingExtraError(f"{APART[kind][0]} needs uv, which makes its environment")
    given = [part for package in APART[kind] for part in ("--with", package)]
    python = f"{sys.version_info.major}.{sys.version_info.minor}"
    words = f"run --quiet --isolated --no-project --python {python}".split()
    base = [uv, *words, *given, "python"]
    if subprocess.run([*base, "-c", ""], capture_output=True, check=False).returncode:
        raise MissingExtraError(f"uv cannot make an environment with {', '.join(APART[kind])}")
    script = Path(__file__).with_name("judging_apart.py")
    done = subprocess.run(
        [*base, str(script), kind, str(folder)], capture_output=True, check=True, text=True
    )
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


def judge_openscenario(runs: Sequence[Run]) -> Judgement:
    """ASAM's checker on one run of every case."""
    from ..export.opendrive import to_opendrive
    from ..export.openscenario import to_openscenario

    firsts = {run.case.name: run for run in reversed(runs)}
    with TemporaryDirectory() as name:
        folder = Path(name)
        roads = to_opendrive(None, load_study_scene())
        (folder / "roads.xodr").write_text(roads, encoding="utf-8")
        for case, run in firsts.items():
            text = to_openscenario(run, road_network="roads.xodr")
            (folder / f"{case}.xosc").write_text(text, encoding="utf-8")
        said = judge_apart("xosc", folder)
    return Judgement(
        what="OpenSCENARIO 1.3",
        judge=f"asam-qc-openscenarioxml {said['version']} (ASAM)",
        checked=f"one run of each of {said['n']} cases, with the exported roads; "
        + _statuses(said["checks"]),
        result=_issues(said["issues"]),
        is_passed=not said["issues"] and set(said["checks"]) == {"completed"},
    )


def judge_opendrive() -> Judgement:
    """ASAM's checker on roads: the study's, and the same in traffic that keeps left."""
    from ..export.opendrive import to_opendrive

    scene = load_study_scene()
    flip = np.array([1.0, -1.0])
    lanes = tuple(replace(lane, centreline_m=lane.centreline_m * flip) for lane in scene.lanes)
    left = replace(scene, lanes=lanes, outline_m=scene.outline_m * flip, keeps_left=True)
    with TemporaryDirectory() as name:
        for side, one in (("right", scene), ("left", left)):
            text = to_opendrive(load_carlancap_layout(), one)
            (Path(name) / f"{side}.xodr").write_text(text, encoding="utf-8")
        said = judge_apart("xodr", Path(name))
    return Judgement(
        what="OpenDRIVE 1.7",
        judge=f"asam-qc-opendrive {said['version']} (ASAM)",
        checked="the study's junction with 12 units, and its mirror image; "
        + _statuses(said["checks"]),
        result=_issues(said["issues"]),
        is_passed=not said["issues"] and said["checks"].get("completed", 0) > 0,
    )


def judge_impacts(runs: Sequence[Run], n_runs: int = 100) -> Judgement:
    """First touch of both rectangles by CommonRoad's collision checker, in steps of 0.01 s."""
    chosen = [runs[i] for i in np.linspace(0, len(runs) - 1, n_runs).round().astype(int)]
    with TemporaryDirectory() as name:
        for index, run in enumerate(chosen):
            met = run.encounter
            n_steps = round((_AFTER_S - run.time_s[0]) / STEP_S)
            time_s = STEP_S * (np.arange(n_steps + 1) - n_steps) + _AFTER_S
            pose = []
            for motion in (met.vut_motion, met.vru_motion):
                position_m, yaw_deg = motion.path.at(motion.distance_m(time_s))
                pose.append(np.column_stack([position_m, np.radians(yaw_deg)]))
            sizes = [[0.5 * body.length_m, 0.5 * body.width_m] for body in (met.vut, met.vru)]
            path = Path(name) / f"{index}.npz"
            np.savez(path, id=run.id, time_s=time_s, pose=np.array(pose), half_sizes=sizes)
        said = judge_apart("touch", Path(name))
    found = [np.inf if touch_s is None else touch_s for touch_s in said["touch_s"].values()]
    off_s = np.abs(found)
    return Judgement(
        what="impact times",
        judge=f"commonroad-drivability-checker {said['version']}",
        checked=f"{len(found)} runs of all cases: first touch in steps of {STEP_S:g} s",
        result=f"largest difference {off_s.max():.3f} s",
        is_passed=len(found) == n_runs and bool(off_s.max() <= STEP_S + _EPSILON),
    )


def judge_carla() -> Judgement:
    """CARLA's classes of places and turns on the study's layout."""
    from ..export.carla import to_carla

    layout = load_carlancap_layout()
    with TemporaryDirectory() as name:
        (Path(name) / "layout.json").write_text(to_carla(layout), encoding="utf-8")
        said = judge_apart("carla", Path(name))
    off = 0.0
    for unit in layout.units:
        right, down, ahead = camera_rotation(unit.pose.yaw_deg, unit.pose.pitch_deg).T
        ours = np.array([unit.pose.position_m, ahead, right, -down]) * [1.0, -1.0, 1.0]
        off = max(off, float(np.abs(ours - said["axes"][unit.id]).max()))
    return Judgement(
        what="carla",
        judge=f"CARLA's Python classes {said['version']}",
        checked="the study's 12 cameras: places and axes of their transforms, south for north; "
        "blueprints and attributes are known to its server alone and not checked",
        result=f"largest difference {off:.1e}",
        is_passed=len(said["axes"]) == len(layout.units) and off < 1.0e-4,  # of single precision
    )


def judge_openlabel() -> Judgement:
    """openlabel-checker on the study's layout."""
    from openlabel_checker.core import check_text

    from ..export.openlabel import to_openlabel

    report = check_text(to_openlabel(load_carlancap_layout()), "layout.json")
    issues = [
        f"{issue.severity.value}: {issue.message}" for o in report.outcomes for issue in o.issues
    ]
    return Judgement(
        what="OpenLABEL 1.0",
        judge=f"openlabel-checker {importlib.metadata.version('openlabel-checker')}",
        checked=f"the study's 12 cameras; {len(report.outcomes)} checks, the schema among them",
        result=_issues(issues),
        is_passed=not issues,
    )


def _statuses(checks: Mapping[str, int]) -> str:
    return ", ".join(f"{n} {status}" for status, n in sorted(checks.items()))


def _issues(issues: Sequence[str]) -> str:
    return "no issue" if not issues else f"{len(issues)} issues; first: {issues[0]}"


def judge_messages(folder: Path) -> list[Judgement]:
    """ETSI's own modules on messages of runs: ``CPM-*.asn``, ``VAM-*.asn``, a dictionary."""
    import asn1tools

    from ..export.cpm import RELEASES, build_stations
    from ..export.uper import CONTAINERS, encode, to_bytes
    from ..export.vam import build_messages
    from ..export.watched import find_run, watch_run

    paths = sorted(folder.glob("*.asn"))
    is_old = any("stationaryHorizontal" in path.read_text(encoding="latin-1") for path in paths)
    release = RELEASES[0] if is_old else RELEASES[1]
    uper = asn1tools.compile_files([str(path) for path in paths], "uper", encoding="latin-1")
    layout, scene = load_carlancap_layout(), load_study_scene()

    def judgement(what: str, standard: str, checked: str, is_equal: Sequence[bool]) -> Judgement:
        n_wrong = len(is_equal) - sum(is_equal)
        return Judgement(
            what=what,
            judge=f"ETSI's ASN.1 ({standard}, TS 102 894-2 V{release}) in asn1tools "
            + importlib.metadata.version("asn1tools"),
            checked=f"{len(is_equal)} messages of {checked}, decoded",
            result="all equal" if not n_wrong else f"{n_wrong} differ",
            is_passed=len(is_equal) > 0 and not n_wrong,
        )

    watched = watch_run(layout, scene, "CPNC-50/east/40")
    equal = []
    for station in build_stations(layout, scene, watched, release=release):
        for message in station.messages:
            found = uper.decode("CollectivePerceptionMessage", encode(message, release))
            for container in found["payload"]["cpmContainers"]:
                name = CONTAINERS[container["containerId"]]
                container["containerData"] = uper.decode(name, container["containerData"])
            equal.append(_as_json(found) == message)
    checked = "the study's 12 cameras in CPNC-50/east/40"
    rows = [judgement("cpm-uper", "TS 103 324 V2.1.1", checked, equal)]
    if list(folder.glob("VAM-*.asn")):
        equal = [
            _as_json(uper.decode("VAM", to_bytes("VAM", message, release))) == message
            for run_id in _VAM_RUNS
            for _, message in build_messages(
                find_run(run_id, scene), scene, vam_rate=10.0, release=release
            )
        ]
        checked = f"the road users of {', '.join(_VAM_RUNS)}, 10 a second"
        rows.append(judgement("vam-uper", "TS 103 300-3 V2.2.1", checked, equal))
    return rows


def _as_json(value: Any) -> Any:
    """Values of asn1tools as JSON has them: a choice is an object with one key."""
    if isinstance(value, tuple):
        return {value[0]: _as_json(value[1])}
    if isinstance(value, dict):
        return {key: _as_json(one) for key, one in value.items()}
    return [_as_json(one) for one in value] if isinstance(value, list) else value


def judge_proof(path: Path = Path("results/budget-3")) -> Judgement:
    """SCIP on ``instance.npz``, read as docs/formats.md describes it.

    Nothing of :mod:`placement` is called: no presolve, no bound, no rule of when a run is avoided.
    The model has a variable per pose and per run, and rows "this run is avoided only if one of
    these poses is chosen": all but a largest set of poses that together do not avoid it. These rows
    hold for every layout, so SCIP's bound does, too. Rows are added until the layout found is worth
    as much as the bound. That holds since more frames never make a run unavoided.
    """
    from pyscipopt import Model, quicksum

    answer = json.loads((path / "summary.json").read_text(encoding="utf-8"))
    stage = (answer["highest"] or answer)["stages"][0]  # another layout may have been chosen
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
    model.setObjective(quicksum(w * a for w, a in zip(counted, avoided, strict=True)), "maximize")
    layout: list[int] = []
    apr, bound, n_rounds = -1.0, 1.0, 0
    while bound > apr + _EPSILON:
        rng = np.random.default_rng(n_rounds)
        for one, weight, variable in zip(runs, counted, avoided, strict=True):
            for order in one.orders(rng) if weight and not one.avoids(one.seen_by(layout)) else ():
                poses = np.flatnonzero(~one.largest_without(one.seen_by(layout), order))
                model.addCons(variable <= quicksum(chosen[pose] for pose in poses))
        model.optimize()
        layout = [pose for pose, one in enumerate(chosen) if model.getVal(one) > 0.5]
        apr = float(sum(counted[[one.avoids(one.seen_by(layout)) for one in runs]]))
        bound, status, n_rows = model.getDualbound(), model.getStatus(), model.getNConss(False)
        n_rounds += 1
        model.freeTransform()
    same = max(abs(apr - stage["objective"]), abs(bound - stage["bound"])) < _EPSILON
    return Judgement(
        what="summary.json, instance.npz",
        judge=f"SCIP {model.version()} (pyscipopt {importlib.metadata.version('pyscipopt')})",
        checked=f"highest APR of the main job, {stage['objective']:.9f}, by a model of its own: "
        f"{model.getNVars(False):,} variables, {n_rows:,} rows, {n_rounds} rounds",
        result=f"{status}: {apr:.9f}, bound {bound:.9f}",
        is_passed=status == "optimal" and same,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _InstanceRun:
    """A run of ``instance.npz``: its frames before the last moment, and who detects in them."""

    sees: BoolArray  # (n_poses, n_frames)
    time_s: FloatArray
    moment_s: float
    memory_s: float
    n_confirmations: int

    def seen_by(self, layout: Sequence[int] | slice) -> BoolArray:
        return np.asarray(self.sees[layout].any(axis=0), dtype=bool)

    def avoids(self, seen: BoolArray) -> bool:
        return bool(_avoids(seen, self.time_s, self.moment_s, self.memory_s, self.n_confirmations))

    def orders(self, rng: np.random.Generator) -> list[IntArray]:
        """Orders in which poses join a set: few frames first, many first, and some at random."""
        n_frames = self.sees.sum(axis=1)
        some = [rng.permutation(len(self.sees)) for _ in range(4)]
        return [np.argsort(n_frames), np.argsort(-n_frames), *some]

    def largest_without(self, seen: BoolArray, order: IntArray) -> BoolArray:
        """Poses of a largest set that does not avoid the run, frames in `seen` given."""
        rule = (self.time_s, self.moment_s, self.memory_s, self.n_confirmations)
        known = _join(self.sees, seen, order, *rule)
        return np.asarray(~(self.sees & ~known).any(axis=1), dtype=bool)


def _read_runs(instance: dict[str, Any]) -> list[_InstanceRun]:
    time_s = instance["time_s"]
    sees = np.unpackbits(instance["packed"], axis=1, bitorder="little", count=len(time_s)) > 0
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


@njit  # type: ignore[untyped-decorator]
def _avoids(seen: BoolArray, time_s: FloatArray, moment_s: float, memory_s: float, n: int) -> bool:
    """True if a track is confirmed and alive at the last moment."""
    in_a_row, last_s, is_confirmed = 0, -np.inf, False
    for frame in range(len(time_s)):
        if not seen[frame]:
            in_a_row = 0
            continue
        is_confirmed = is_confirmed and time_s[frame] - last_s <= memory_s
        in_a_row, last_s = in_a_row + 1, time_s[frame]
        is_confirmed = is_confirmed or in_a_row >= n
    return is_confirmed and moment_s - last_s <= memory_s


@njit  # type: ignore[untyped-decorator]
def _join(
    sees: BoolArray, seen: BoolArray, order: IntArray,
    time_s: FloatArray, moment_s: float, memory_s: float, n: int,
) -> BoolArray:  # fmt: skip
    """Frames that are seen when poses join one after the other, unless the run is avoided then."""
    known = seen.copy()
    for pose in order:
        more = known | sees[pose]
        if not _avoids(more, time_s, moment_s, memory_s, n):
            known = more
    return known


@click.command()
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("results/judges.md"), show_default=True
)
@click.option(
    "--asn1",
    "folders",
    multiple=True,
    type=click.Path(path_type=Path, exists=True),
    help="Folder with ETSI's modules, CPM-*.asn, VAM-*.asn, the dictionary's; may be repeated.",
)
def main(out: Path, folders: tuple[Path, ...]) -> None:
    """Ask every judge, and write what they say."""
    runs = lay_all_cases()
    asked: list[Callable[[], Judgement]] = [
        lambda: judge_openscenario(runs),
        judge_opendrive,
        lambda: judge_impacts(runs),
        judge_openlabel,
        judge_carla,
        judge_proof,
    ]
    rows = [ask() for ask in asked]
    rows += [row for folder in folders for row in judge_messages(folder)]
    write_atomically(out, page_of(files(__package__) / "judges.md.j2", rows=rows))
    if not all(row.is_passed for row in rows):
        raise click.ClickException(f"a judge found a fault: {out}")


if __name__ == "__main__":
    main()
