"""Runs that a layout does not avoid, and why.

It says what is in the way, how late braking comes, and what would help.
"""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.raycast import FloatRays, build_caster, ray_lengths_m
from geometry.scene import Scene
from geometry.tables import says
from geometry.terrain import on_ground
from scenarios.confirmation import (
    confirmation_mask,
    is_in_time,
    live_confirmation_time_s,
)
from scenarios.runs import Run

from ..cache import cached_value
from ..candidates import CandidatePose, is_in_view
from ..compute import DEFAULT_COMPUTE, Compute
from ..detection_table import DetectionTable
from ..optimiser import PlacementProblem, run_margins_s
from ..optimiser.allowed_sets import fitting
from ..setting import Setting
from ..visibility.build import N_POINTS, table_fingerprint
from ..visibility.casting import (
    Sight,
    World,
    build_world,
    cast_sight,
    find_obstructions,
)
from ..visibility.sensing import build_sensing

Cause = Literal["hidden", "out of view", "cut off", "too dark", "too far", "otherwise"]

THE_VUT = "the VUT"
Names = tuple[NDArray[np.object_], list[list[str]]]
# Rays end this much before the point they are cast to.
_OFF_SURFACE_M = 1.0e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Look:
    """Frames in which a unit should have detected the road user.

    Attributes
    ----------
    unit : CandidatePose
        The unit.
    run_index : int
        Of the setting's runs.
    frame_index : (n,) int
        Frames of that run, from 0.
    """

    unit: CandidatePose
    run_index: int
    frame_index: IntArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Reason:
    """Reason why the road user is not detected in some frames.

    Attributes
    ----------
    cause : str
        "hidden": detected if nothing stood in the way; "out of view", "cut off": not in
        the image, or only a part of it; "too dark": light and air leave too little
        contrast; "too far": too small, or too few points; "otherwise": none of these,
        but the table has no detection.
    thing : str
        What hides it, by name: most of the blocked rays end there. Empty for all other
        causes.
    """

    cause: Cause
    thing: str
    frames: Annotated[int, says("In how many frames.")]


def find_reasons(
    setting: Setting, looks: Sequence[Look], *, compute: Compute = DEFAULT_COMPUTE
) -> list[tuple[Reason, ...]]:
    """Reasons why units do not detect, the most frequent one first."""
    if not looks:
        return []
    # One world has the runs of all looks.
    run_index = list(dict.fromkeys(look.run_index for look in looks))
    runs = [setting.runs[index] for index in run_index]
    ends = np.cumsum([0, *(len(run.time_s) for run in runs)])
    world = build_world(setting.scene, runs, n_points=N_POINTS, seed=compute.seed)
    names = _names(setting.scene, runs)
    reasons: list[tuple[Reason, ...]] = [()] * len(looks)
    # Frames of one unit are evaluated together.
    for unit in {id(look.unit): look.unit for look in looks}.values():
        mine = [number for number, look in enumerate(looks) if look.unit is unit]
        frames = [
            ends[run_index.index(looks[number].run_index)] + looks[number].frame_index
            for number in mine
        ]
        causes = iter(_causes(setting, world, names, unit, np.concatenate(frames)))
        for number, part in zip(mine, frames, strict=True):
            tally = Counter(islice(causes, len(part)))
            reasons[number] = tuple(
                Reason(cause=cause, thing=thing, frames=count)
                for (cause, thing), count in tally.most_common()
            )
    return reasons


def _causes(
    setting: Setting, world: World, names: Names, unit: CandidatePose, frames: IntArray
) -> list[tuple[Cause, str]]:
    """Cause, and the thing in the way, of each frame of a world."""
    # The same world with nothing in the way.
    nothing = build_caster(np.empty((0, 3)), np.empty((0, 3), dtype=np.int32))
    no_triangles = world.shared.triangles_m[:0]
    empty = replace(
        world,
        shared=replace(
            world.shared, caster=nothing, triangles_m=no_triangles, hidden_by_scene=None
        ),
        standing=replace(
            world.standing, casters=(nothing,) * len(world.standing.casters)
        ),
        vehicles=replace(
            world.vehicles, casters=(nothing,) * len(world.vehicles.casters)
        ),
    )
    position_m = unit.pose.position_m
    near_m = unit.sensor.near_m
    views = world.views
    open_sight = cast_sight(empty, position_m, near_m=near_m, max_distance_m=np.inf)
    sensing = build_sensing(empty, open_sight, position_m, setting.table_detector)
    bright = replace(sensing, contrast=np.ones_like(sensing.contrast))
    shown = (0, views.weather_of_frame[frames], open_sight.entry_of_frame[frames])
    # Detected in the open, and in the open with full contrast.
    in_the_open = sensing.detected([unit])[shown]
    in_full_light = bright.detected([unit])[shown]
    points = (
        views.points_m[views.view_of_frame[frames]].astype(np.float64) + world.origin_m
    )
    inside = (
        is_in_view(unit, points.reshape(-1, 3)).reshape(points.shape[:2]).mean(axis=1)
    )
    things = iter(_things_between(world, names, unit, frames[in_the_open], open_sight))
    # The first cause that applies to each frame.
    causes: list[tuple[Cause, str]] = []
    for frame in range(len(frames)):
        if in_the_open[frame]:
            thing = next(things)
            causes.append(("hidden", thing) if thing else ("otherwise", ""))
        elif inside[frame] < 1.0:
            causes.append(("out of view" if inside[frame] == 0.0 else "cut off", ""))
        else:
            causes.append(("too dark" if in_full_light[frame] else "too far", ""))
    return causes


def _things_between(
    world: World, names: Names, unit: CandidatePose, frames: IntArray, open_sight: Sight
) -> list[str]:
    """The thing that blocks most rays to the road user in each frame.

    It is empty where nothing does.
    """
    views = world.views
    vehicles = world.vehicles
    eye = unit.pose.position_m - world.origin_m
    of_triangles, of_standing = names
    things = []
    # Rays to the visible points of the body; the nearest hit blocks each.
    for frame in frames.tolist():
        view = int(views.view_of_frame[frame])
        faces_eye = open_sight.is_visible[open_sight.entry_of_frame[frame]]
        rays = _rays(eye, views.points_m[view][faces_eye], unit.sensor.near_m)
        group = int(views.obstruction_index[view])
        share, triangle = world.shared.caster.first_triangle(*rays)
        thing = of_triangles[np.where(share < 1.0, triangle, -1)]
        standing = (hits for _, hits in world.standing.first_hits(group, *rays))
        driving = (
            (THE_VUT if kind == 0 else f"{vehicles.actors[kind].name}, driving", hits)
            for body, hits in vehicles.first_hits(frame, *rays)
            for kind in [int(vehicles.kind[body])]
        )
        for name, hits in (*zip(of_standing[group], standing, strict=True), *driving):
            thing[hits < np.minimum(share, 1.0)] = name
            share = np.minimum(share, hits)
        blockers = Counter(thing[thing != ""].tolist()).most_common(1)
        things.append(blockers[0][0] if blockers else "")
    return things


def _rays(
    eye_m: FloatArray, points_m: FloatRays, near_m: float
) -> tuple[FloatRays, FloatRays]:
    """Starts (n, 3) and vectors (n, 3) of rays from the eye to points.

    They start beyond what is too near to the lens to hide anything.
    """
    vectors = points_m - eye_m.astype(np.float32)
    unit_vectors = vectors / ray_lengths_m(vectors)[:, None]
    starts = (eye_m + near_m * unit_vectors).astype(np.float32)
    ways = vectors - np.float32(near_m + _OFF_SURFACE_M) * unit_vectors
    return starts, ways.astype(np.float32)


def _names(scene: Scene, runs: Sequence[Run]) -> Names:
    """Names of things: by triangle of the scene, and by parked body."""
    instances = [scene.instances[index].id for index in scene.triangle_instance]
    # Equal names of one obstruction are numbered.
    of_standing = []
    for parked in find_obstructions(runs)[0]:
        bodies = [body.actor.name for body in parked]
        of_standing.append(
            [
                (
                    name
                    if bodies.count(name) == 1
                    else f"{name} ({bodies[:number].count(name) + 1})"
                )
                for number, name in enumerate(bodies)
            ]
        )
    # One more at the end: nothing is hit (index -1).
    return np.array([*instances, ""], dtype=object), of_standing


# ---------- runs
Outcome = Literal["hopeless", "never seen", "never confirmed", "lost again", "too late"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Rescue:
    """Nearest candidate that would save a run as a further unit."""

    unit: Annotated[str, says("Name of the candidate pose.")]
    site: Annotated[str, says("Its site.")]
    distance_m: Annotated[
        float, says("From the nearest unit, in metres; 0: at the same mount.")
    ]
    margin_s: Annotated[float, says("Time to spare that it leaves, in seconds.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class Unavoided:
    """A run with weight that is not avoided on the detection table.

    It is in the world as planned.

    Attributes
    ----------
    outcome : str
        "hopeless": no frame comes early enough, whoever looks; else the units'
        achievement. "lost again": they confirm early enough, but the track is not alive
        at the last moment, and none is confirmed after it.
    late_s : float, optional
        By how much braking sets in too late, in seconds; None: never, also where the
        track was lost again.
    unit : str
        Id of the unit nearest to the road user in the last of these frames, preferably
        among those that have it in view in one of them; empty if hopeless.
    reasons : tuple of Reason
        Why that unit does not detect the road user in some of these frames, the most
        frequent one first.
    rescue : Rescue, optional
        Nearest candidate that would save the run as a further unit; None: none, or
        nobody looked, as where worlds are sampled.
    """

    run: Annotated[str, says("Name of the run, as in runs.parquet.")]
    outcome: Outcome
    late_s: float | None
    frames_in_time: Annotated[
        int, says("Frames from which braking in time could follow.")
    ]
    frames_seen: Annotated[
        int, says("Of these, those in which a unit detects the road user.")
    ]
    unit: str
    reasons: tuple[Reason, ...]
    rescue: Rescue | None


def find_unavoided(
    setting: Setting,
    problem: PlacementProblem,
    candidates: Sequence[CandidatePose],
    pose_index: Sequence[int],
    *,
    compute: Compute = DEFAULT_COMPUTE,
) -> tuple[Unavoided, ...]:
    """Runs that a set of poses does not avoid on the detection table, and why.

    `candidates` are the rows of the problem's table; at least one is mounted
    (`pose_index`); `compute` has the table's seed. Runs of weight 0, which no ratio
    counts, are left out. A candidate that would save a run is not forbidden, finds room
    at its site and is not too near to another unit; what it costs does not matter.
    Raises InputError if the table does not belong to runs and candidates.
    """
    scene = setting.scene
    seed = compute.seed
    chosen = list(pose_index)
    seen = ""
    if compute.cache_folder is not None:
        seen = table_fingerprint(
            scene, candidates, setting.runs, setting.table_detector, seed=seed
        )

    def find() -> tuple[Unavoided, ...]:
        """Find the runs, then the reasons and rescues of all at once."""
        is_missed = run_margins_s(problem, chosen) == -np.inf
        misses = [
            _find_miss(setting, problem, candidates, chosen, run)
            for run in np.flatnonzero(
                is_missed & (problem.table.axis.weight > 0.0)
            ).tolist()
        ]
        looks = [look for _, look in misses if look is not None]
        reasons = iter(find_reasons(setting, looks, compute=compute))
        joining = _find_joining(problem, candidates, chosen)
        found = []
        for miss, look in misses:
            if look is not None:
                rescue = _nearest_rescue(
                    problem, candidates, chosen, joining, look.run_index
                )
                miss = replace(miss, reasons=next(reasons), rescue=rescue)
            found.append(miss)
        return tuple(found)

    return cached_value(
        compute.cache_folder,
        "unavoided",
        find,
        kind=tuple[Unavoided, ...],
        made_from=(
            *(problem, chosen, seen, scene.instances, scene.triangle_instance),
            [candidate.site_id for candidate in candidates],
        ),
    )


def _find_miss(
    setting: Setting,
    problem: PlacementProblem,
    candidates: Sequence[CandidatePose],
    chosen: list[int],
    run: int,
) -> tuple[Unavoided, Look | None]:
    """Outcome of a run, and the look of the unit that should see best."""
    axis = problem.table.axis
    rule = problem.rule
    time_s = axis.time_s[axis.frames_of(run)]
    last_brake_s = axis.last_brake_time_s[run]
    # Frames from which braking in time could follow.
    counts = np.asarray(is_in_time(time_s, last_brake_s, latency_s=rule.latency_s))
    detected = _detected_in(problem.table, run)[chosen]
    parties = np.vstack([detected, *_seen_by_vut(problem, run)])
    seen = np.logical_or.reduce(parties, axis=0)
    if problem.fusion == "any":
        together = seen
    else:
        together = parties
    # The first confirmation after the last moment tells how late it is.
    confirmed = confirmation_mask(together, n_confirmations=rule.n_confirmations)
    braking_s = (
        np.where(confirmed & ~counts, time_s, np.inf).min(initial=np.inf)
        + rule.latency_s
    )
    is_hopeless = int(counts.sum()) < rule.n_confirmations
    # The first outcome that applies.
    outcomes: tuple[tuple[Outcome, bool], ...] = (
        ("hopeless", is_hopeless),
        ("never seen", not seen.any()),
        ("never confirmed", not confirmed.any()),
        ("lost again", not np.isfinite(braking_s)),
        ("too late", True),
    )
    look = None
    if not is_hopeless:
        units = [candidates[pose] for pose in chosen]
        of_run = setting.runs[run]
        middle_m = on_ground(of_run.vru_position_m[counts], of_run.terrain)
        middle_m[:, 2] += 0.5 * of_run.encounter.vru.height_m
        away_m = [
            np.hypot(*(unit.pose.position_m[:2] - middle_m[-1, :2])) for unit in units
        ]
        # If none has it in view, the nearest of all: another one may look elsewhere on
        # purpose.
        looks_elsewhere = [not is_in_view(unit, middle_m).any() for unit in units]
        nearest = int(np.lexsort((away_m, looks_elsewhere))[0])
        missed = np.flatnonzero(counts & ~detected[nearest])
        look = Look(unit=units[nearest], run_index=run, frame_index=missed)
    if np.isfinite(last_brake_s):
        late_s = float(braking_s - last_brake_s)
    else:
        late_s = np.inf
    miss = Unavoided(
        run=axis.run_ids[run],
        outcome=next(outcome for outcome, is_so in outcomes if is_so),
        late_s=late_s if np.isfinite(late_s) else None,
        frames_in_time=int(counts.sum()),
        frames_seen=int((counts & seen).sum()),
        unit="" if look is None else look.unit.id,
        reasons=(),
        rescue=None,
    )
    return miss, look


def _find_joining(
    problem: PlacementProblem, candidates: Sequence[CandidatePose], chosen: list[int]
) -> tuple[IntArray, FloatArray]:
    """Candidates that may join the chosen ones, with their distances.

    They are (n,); a distance is that to the nearest chosen unit, in metres.
    """
    # Neither budgets nor forced units and sites matter here.
    limits = replace(
        problem.limits,
        budget_units=None,
        budget_eur=None,
        is_forced=np.zeros_like(problem.limits.is_forced),
        is_forced_site=np.zeros_like(problem.limits.is_forced_site),
    )
    joining: IntArray = np.flatnonzero(
        fitting(limits, np.array(chosen, dtype=np.int64))
    )
    position_m: FloatArray = np.array(
        [candidate.pose.position_m for candidate in candidates]
    )
    between_m = np.linalg.norm(
        position_m[joining, None] - position_m[chosen][None], axis=2
    )
    distance_m: FloatArray = between_m.min(axis=1).round(6)
    return joining, distance_m


def _nearest_rescue(
    problem: PlacementProblem,
    candidates: Sequence[CandidatePose],
    chosen: list[int],
    joining: tuple[IntArray, FloatArray],
    run: int,
) -> Rescue | None:
    """The nearest candidate that saves a run.

    Of several at the same place it is the quickest.
    """
    axis = problem.table.axis
    rule = problem.rule
    poses, distance_m = joining
    detected = _detected_in(problem.table, run)
    seen = detected[poses]
    if problem.fusion == "any":
        seen = seen | np.vstack([detected[chosen], *_seen_by_vut(problem, run)]).any(
            axis=0
        )
    last_brake_s = float(axis.last_brake_time_s[run])
    # A candidate helps if its track is alive at the last moment.
    confirmed_s = live_confirmation_time_s(
        seen,
        axis.time_s[axis.frames_of(run)],
        until_s=last_brake_s - rule.latency_s,
        rule=rule,
    )
    saves = np.isfinite(confirmed_s)
    if not saves.any():
        return None
    # By distance, then by the time of confirmation.
    helping = np.flatnonzero(saves)
    best = helping[np.lexsort((confirmed_s[helping], distance_m[helping]))[0]]
    pose = int(poses[best])
    return Rescue(
        unit=candidates[pose].id,
        site=candidates[pose].site_id,
        distance_m=float(distance_m[best]),
        margin_s=float(last_brake_s - confirmed_s[best] - rule.latency_s),
    )


def _seen_by_vut(problem: PlacementProblem, run: int) -> list[BoolArray]:
    """Frames of a run in which the VUT detects; none if it is blind.

    They are (n_frames of the run,).
    """
    seen = problem.seen_by_vut
    if seen is None:
        return []
    return [seen[problem.table.axis.frames_of(run)]]


def _detected_in(table: DetectionTable, run: int) -> BoolArray:
    """V[c, f] of the frames of one run, (n_poses, n_frames of the run)."""
    frames = table.axis.frames_of(run)
    # Unpack only the bytes of this run.
    first_byte = frames.start // 8
    bits = np.unpackbits(
        table.packed[:, first_byte : -(-frames.stop // 8)], axis=1, bitorder="little"
    )
    skipped = frames.start - 8 * first_byte
    return bits[:, skipped : skipped + frames.stop - frames.start].astype(bool)
