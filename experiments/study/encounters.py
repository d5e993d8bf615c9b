"""Real encounters at a crosswalk: ``python -m experiments.study.encounters FOLDER``.

FOLDER holds the filtered trajectories of the DUT dataset (D. Yang et al., "Top-view Trajectories: A
Pedestrian Dataset of Vehicle-Crowd Interaction from Controlled Experiments and Crowded Campus",
2019): ``intersection_NN_traj_ped_filtered.csv`` and ``.._veh_..``, of one crosswalk without
signals. Nothing of them is written but what was measured.
"""

import tempfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import click
import numpy as np
import shapely

from geometry.actors import MovingActor, pick_actor
from geometry.arrays import BoolArray, FloatArray
from geometry.errors import InputError, refuse
from geometry.files import write_atomically
from geometry.poses import Pose, to_world
from geometry.scene import Body, Instance, Lane, Scene, Site, join_bodies
from placement.compute import Compute
from placement.evaluation import Verdict
from placement.evaluator import evaluate_layout
from placement.pipeline import assemble, place
from placement.question import Question
from placement.sampling.moving.trajectories import meets_road_users
from placement.setting import Setting, build_setting
from scenarios.conflicts import FoundEncounter, cases_text, find_encounters
from scenarios.paths import rotated
from scenarios.runs import Run
from scenarios.trajectories import VEHICLE, Track, load_trajectory_rules, read_tracks

from ..results.tables import page_of

RATE_HZ = 23.98  # the dataset's README
N_CAMERAS = 3
_STANDS_M = 0.5  # a vehicle that moves less all the time is parked
_LANE_M = 3.0
_KERB_M = 2.5  # from the middle of a car's way
_POLE_STEP_M = 6.0
_ARM_M = 40.0  # lanes go straight on beyond the recorded area
_NEAR_M = 30.0  # others than these hide nobody
_FACTS = (1.0, 2.0, 3.0)


def lay_clips(folder: Path) -> dict[str, tuple[Track, ...]]:
    """Tracks of each clip, in the frame of the first one that shows the two parked cars.

    Pictures count downwards: north is minus y. Clips were taken from slightly different points; the
    two cars that are parked side by side in most of them are laid upon one another. Raises
    InputError: there is no clip, or a file cannot be read.
    """
    paths = sorted(folder.glob("intersection_*_traj_ped_filtered.csv"))
    if not paths:
        refuse(str(folder), "no clip", "the dataset's intersection_NN_traj_ped_filtered.csv")
    clips = {}
    for path in paths:
        cars = path.with_name(path.name.replace("_ped_", "_veh_"))
        read = [read_tracks(one, frame_rate_hz=RATE_HZ)[0] for one in (path, cars)]
        clips[path.name.split("_")[1]] = tuple(
            replace(track, position_m=track.position_m * [1.0, -1.0], yaw_deg=-track.yaw_deg)
            for both in read
            for track in both
        )
    marks = {name: _marks_m(tracks) for name, tracks in clips.items()}
    first = next((mark for mark in marks.values() if mark is not None), None)
    return {name: _aligned(tracks, marks[name], first) for name, tracks in clips.items()}


def _is_parked(track: Track) -> bool:
    return track.class_name == VEHICLE and bool(
        (np.ptp(track.position_m, axis=0) < _STANDS_M).all()
    )


def _marks_m(tracks: Sequence[Track]) -> FloatArray | None:
    """Where the two parked cars stand, (2, 2), the one that looks east first; None: not there."""
    parked = [track for track in tracks if _is_parked(track)]
    parked.sort(key=lambda track: -np.cos(np.radians(track.yaw_deg[0])))
    middles = [np.median(track.position_m, axis=0) for track in parked]
    return np.array(middles) if len(middles) == 2 else None


def _aligned(
    tracks: tuple[Track, ...], marks_m: FloatArray | None, onto_m: FloatArray | None
) -> tuple[Track, ...]:
    if marks_m is None or onto_m is None:
        return tracks
    sides = [np.arctan2(*(ends[1] - ends[0])[::-1]) for ends in (marks_m, onto_m)]
    turn_deg = float(np.degrees(sides[1] - sides[0]))
    shift_m = onto_m.mean(axis=0) - rotated(marks_m.mean(axis=0), turn_deg)
    return tuple(
        replace(
            track,
            position_m=rotated(track.position_m, turn_deg) + shift_m,
            yaw_deg=track.yaw_deg + turn_deg,
        )
        for track in tracks
    )


def build_street(clips: Mapping[str, Sequence[Track]]) -> Scene:
    """A scene of what the tracks tell: lanes, kerbs with poles, parked cars, the crosswalk.

    Cars' ways are lanes, straight on beyond the recorded area; kerbs run beside them, with a pole
    every few metres inside it. The crosswalk is the main axis of where people cross cars' ways.
    There are no buildings and no trees: nobody knows them.
    """
    tracks = [track for clip in clips.values() for track in clip]
    cars = [track for track in tracks if track.class_name == VEHICLE and not _is_parked(track)]
    lanes, outline_m = _lanes(cars)
    road = shapely.union_all([shapely.LineString(car.position_m).buffer(_KERB_M) for car in cars])
    ring = max(shapely.get_parts(road), key=lambda part: part.area).exterior
    at = np.arange(0.0, ring.length, _POLE_STEP_M)
    poles = shapely.get_coordinates(ring.interpolate(at))
    seen = shapely.MultiPoint(np.concatenate([track.position_m for track in tracks])).convex_hull
    poles = poles[shapely.contains_xy(seen.buffer(_KERB_M), *poles.T)]
    half_m = 100.0 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    ground = np.column_stack([outline_m.mean(axis=0) + half_m, np.zeros(4)])
    bodies: list[Body] = [
        (Instance(id="ground", class_name="ground"), ground, np.array([[0, 1, 2], [0, 2, 3]]))
    ]
    bodies += _parked(next(clip for clip in clips.values() if _marks_m(clip) is not None))
    return Scene(
        name="crosswalk",
        **join_bodies(bodies),
        sites=tuple(
            Site(
                id=f"pole-{number}",
                position_m=np.append(pole, 0.0),
                kind="lamp post",
                height_range_m=np.array([4.0, 8.0]),
                capacity_units=1,
            )
            for number, pole in enumerate(poles, start=1)
        ),
        outline_m=outline_m,
        lanes=lanes,
        crs="",
        crosswalks_m=_crosswalk_m(tracks, cars),
    )


def _lanes(cars: Sequence[Track]) -> tuple[tuple[Lane, ...], FloatArray]:
    """A lane in and out for each side from and to which cars drive, and the outline between."""
    ends: dict[tuple[str, int], list[tuple[FloatArray, FloatArray]]] = {}
    for car in cars:
        for kind, time_s, sign in (("in", car.time_s[0], 1.0), ("out", car.time_s[-1], -1.0)):
            moves = car.velocity_mps(np.array(time_s))
            inwards = sign * moves / np.hypot(*moves)
            side = int(np.rint(np.degrees(np.arctan2(-inwards[1], -inwards[0])) / 90.0)) % 4
            ends.setdefault((kind, side), []).append((car.at(np.array(time_s)), inwards))
    lanes, corners = [], []
    for (kind, side), several in ends.items():
        end, inwards = several[len(several) // 2]
        way = np.array([end - _ARM_M * inwards, end])
        centreline_m = way if kind == "in" else way[::-1]
        name = f"{('east', 'north', 'west', 'south')[side]}-{kind}"
        lanes.append(Lane(id=name, kind="driving", width_m=_LANE_M, centreline_m=centreline_m))
        left = 0.5 * _LANE_M * np.array([-inwards[1], inwards[0]])
        corners += [end - left, end + left]
    hull = shapely.MultiPoint(np.array(corners)).convex_hull
    return tuple(lanes), shapely.get_coordinates(hull)[:-1]


def _parked(tracks: Sequence[Track]) -> Iterator[Body]:
    shape = pick_actor("parked-car-small", "parked").shapes[0]
    for track in tracks:
        if _is_parked(track):
            middle = np.median(track.position_m, axis=0)
            pose = Pose(position_m=np.append(middle, 0.0), yaw_deg=float(track.yaw_deg[0]))
            instance = Instance(id=f"parked-{track.id}", class_name="parked vehicle")
            yield instance, to_world(shape.vertices_m, pose), shape.triangles


def _crosswalk_m(tracks: Sequence[Track], cars: Sequence[Track]) -> FloatArray:
    """The line on which people cross cars' ways, from end to end, (1, 2, 2); (0, 2, 2): none."""
    ways = shapely.union_all([shapely.LineString(car.position_m) for car in cars])
    walks = [shapely.LineString(one.position_m) for one in tracks if one.class_name != VEHICLE]
    points = shapely.get_coordinates(shapely.intersection(walks, ways))
    if len(points) < 2:
        return np.empty((0, 2, 2))
    middle = np.median(points, axis=0)
    _, _, axes = np.linalg.svd(points - middle, full_matrices=False)
    ends = np.percentile((points - middle) @ axes[0], [5.0, 95.0])
    line: FloatArray = middle + ends[:, None] * axes[0]
    return line[None]


def with_crowd(
    setting: Setting, found: Mapping[str, FoundEncounter], clips: Mapping[str, Sequence[Track]]
) -> Setting:
    """The setting with everybody else of the clip in each run, but who would touch the two."""
    runs = []
    for run in setting.runs:
        clip = run.case.name.split("-")[0].removeprefix("dut")
        runs.append(_with_others(run, found[run.case.name], clips[clip]))
    return replace(setting, runs=tuple(runs))


def _with_others(run: Run, one: FoundEncounter, tracks: Sequence[Track]) -> Run:
    bodies = load_trajectory_rules().bodies
    # Both clocks meet at the moment from which the replay goes straight on.
    time_s = run.time_s + one.moment_s - one.recorded.vut.end_s
    others = []
    for track in tracks:
        if track.id == one.vru.id and track.class_name == one.vru.class_name:
            continue
        if track.class_name == VEHICLE and (_is_parked(track) or track.id == one.vehicle.id):
            continue
        position, moves = track.at(time_s), track.velocity_mps(time_s)
        yaw_deg = np.degrees(np.arctan2(moves[:, 1], moves[:, 0]))
        is_away = (time_s < track.time_s[0]) | (time_s > track.time_s[-1])
        is_away |= np.hypot(*(position - run.vru_position_m).T) > _NEAR_M
        if is_away.all():
            continue
        position[is_away], yaw_deg[is_away] = np.nan, np.nan
        name = bodies.get(track.class_name, "parked-car-small")
        actor = pick_actor(name, "bodies")
        others.append(MovingActor(actor=actor, position_m=position, yaw_deg=yaw_deg))
    meets = meets_road_users(run, others, clearance_m=0.0)
    kept = [body for body, is_near in zip(others, meets, strict=True) if not is_near]
    return replace(run, traffic=tuple(kept))


def study(folder: Path, *, ttc_s: float, compute: Compute) -> tuple[str, Scene]:
    """The table of encounters as Markdown, and the scene."""
    clips = lay_clips(folder)
    found: dict[str, FoundEncounter] = {}
    left_out, texts = Counter[str](), []
    for clip, tracks in clips.items():
        pairs, why = find_encounters(tracks, ttc_s=ttc_s)
        left_out += why
        found |= {f"dut{clip}-{one.vehicle.id}-{one.vru.id}": one for one in pairs}
        texts.append(cases_text(pairs, name=f"dut{clip}", source=f"DUT, clip {clip}"))
    scene = build_street(clips)
    with tempfile.TemporaryDirectory() as temporary:
        cases = Path(temporary, "encounters.toml")
        write_atomically(cases, "\n".join(texts))
        question = Question(cases=str(cases), budget=N_CAMERAS, cars="blind")
        alone = build_setting(question, scene)
        settings = {"alone": alone, "crowd": with_crowd(alone, found, clips)}
        placed = place(assemble(question, setting=settings["crowd"], compute=compute))
    verdicts = {}
    for name, setting in settings.items():
        evaluation = evaluate_layout(placed.layout, setting, compute=compute)
        verdicts[f"VUT {name}"] = evaluation.vut
        verdicts[f"cameras {name}"] = evaluation.rsu_all
    text = page_of(
        files(__package__) / "encounters.md.j2",
        found=found,
        ttc_s=ttc_s,
        clips=clips,
        below=[(limit, sum(one.ttc_s <= limit for one in found.values())) for limit in _FACTS],
        left_out=left_out,
        n_front=sum(map(_meets_front, alone.runs)),
        n_poles=len(scene.sites),
        n_cameras=N_CAMERAS,
        at=[unit.site_id for unit in placed.layout.units],
        per_run=sum(len(run.traffic) for run in settings["crowd"].runs) / len(alone.runs),
        in_time=list(_in_time_rows(alone, found, verdicts)),
        pairs=list(_pair_rows(alone, found, verdicts)),
    )
    return text, scene


_PARTIES = ("VUT crowd", "cameras crowd", "VUT alone", "cameras alone")


def _in_time_rows(
    setting: Setting, found: Mapping[str, FoundEncounter], verdicts: Mapping[str, Verdict]
) -> Iterator[list[str]]:
    """Pairs by what they meet and time to collision, and how many each party confirms in time."""
    ttc_s = np.array([found[run.case.name].ttc_s for run in setting.runs])
    is_front = np.array([_meets_front(run) for run in setting.runs])
    for met, is_met in (("front", is_front), ("side", ~is_front)):
        for limit in _FACTS:
            is_short: BoolArray = is_met & (ttc_s <= limit)
            counts = [int(verdicts[name].is_avoided[is_short].sum()) for name in _PARTIES]
            words = f"the car's {met}, time to collision below {limit:g} s"
            yield [words, *map(str, (int(is_short.sum()), *counts))]


def _pair_rows(
    setting: Setting, found: Mapping[str, FoundEncounter], verdicts: Mapping[str, Verdict]
) -> Iterator[list[str]]:
    """Each pair, the shortest time to collision first."""
    ttc_s = np.array([found[run.case.name].ttc_s for run in setting.runs])
    for index in np.argsort(ttc_s).tolist():
        run = setting.runs[index]
        yield [
            *(run.case.name.removeprefix("dut"), "front" if _meets_front(run) else "side"),
            *(f"{ttc_s[index]:.2f}", f"{run.vut_speed_kmh:g}", f"{run.case.vru_speed_kmh:g}"),
            *(f"{-run.time_s[0]:.1f}", f"{-run.last_brake_time_s:.2f}"),
            *(_confirmed(verdicts[name], index) for name in _PARTIES[:2]),
        ]


def _meets_front(run: Run) -> bool:
    """True if the middle of the VRU is ahead of the VUT's front at the impact."""
    at = [
        motion.path.at(motion.distance_m(0.0))
        for motion in (run.encounter.vut_motion, run.encounter.vru_motion)
    ]
    ahead_m, _ = rotated(at[1][0] - at[0][0], -float(at[0][1]))
    return bool(ahead_m > 0.5 * run.encounter.vut.length_m)


def _confirmed(verdict: Verdict, index: int) -> str:
    time_s = float(verdict.confirmation_time_s[index])
    if not np.isfinite(time_s):
        return "-"
    if verdict.is_avoided[index]:
        return f"{-time_s:.1f}"
    is_lost = not np.isfinite(verdict.onset_time_s[index])
    return f"{-time_s:.1f}, {'lost' if is_lost else 'late'}"


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option("--ttc", "ttc_s", type=float, default=3.0, show_default=True, help="Longest. [s]")
@click.option("--workers", type=int, default=2, show_default=True, help="Threads.")
@click.option("--scene", "scene_to", type=click.Path(path_type=Path), help="Write the scene here.")
@click.option("--out", type=click.Path(path_type=Path), help="File; default: the terminal.")
def main(
    *, folder: Path, ttc_s: float, workers: int, scene_to: Path | None, out: Path | None
) -> None:
    """Say who would have been seen in time, by the car itself and by three placed cameras."""
    from geometry.scene_files import save_scene

    try:
        text, scene = study(folder, ttc_s=ttc_s, compute=Compute(workers=workers))
        if scene_to is not None:
            scene_to.mkdir(parents=True, exist_ok=True)
            save_scene(scene_to, scene)
        if out is None:
            click.echo(text)
        else:
            write_atomically(out, text)
    except InputError as error:
        click.echo(str(error), err=True)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
