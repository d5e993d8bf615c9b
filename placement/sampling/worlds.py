"""Sampled worlds: mounting errors, vehicles, latencies, road users."""

import hashlib
import zlib
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from typing import Any, NamedTuple

import numpy as np

from geometry.actors import PlacedActor
from geometry.arrays import FloatArray, IntArray, freeze
from geometry.poses import Pose
from geometry.scene import Scene
from scenarios.aeb import AebRule, last_brake_times_s
from scenarios.encounters import Encounter, first_contact_s
from scenarios.obstructions import is_way_free
from scenarios.paths import MPS_PER_KMH, Motion, MovedPath, rotated, travel_time_s
from scenarios.runs import Run, build_frame_axis, frames_at

from ..candidates import CandidatePose
from ..compute import check_whole
from ..detectors.response import LastingNoise, ResponseDetector
from ..evaluator.surroundings import draw_index
from ..setting import Setting
from .driving import TrafficCount
from .traffic import (
    GroupKey,
    StandingRoom,
    Ways,
    build_street,
    build_ways,
    clear_of_ways,
    group_key,
)
from .uncertainty import MountingErrors, RoadUsers, Uncertainty

# ---------- random numbers


class FrameLinks(NamedTuple):
    """Links between frames, for their random numbers, (n_frames,) each.

    The place of each in its run, and what makes the sum of both another for each frame;
    the same for the same run in several weathers.
    """

    run_of_frame: IntArray
    place_of_frame: IntArray


def link_frames(frames: IntArray) -> FrameLinks:
    """Find which frames belong together.

    `frames` are numbers as `draw_index` gives, (n_frames,). Equal ones share their
    random numbers, those that follow one another are linked.
    """
    # A gap in the numbers begins another run.
    draws, index = np.unique(frames, return_inverse=True)
    starts = np.flatnonzero(np.diff(draws, prepend=draws[0] - 2) != 1)
    run = np.repeat(starts, np.diff(np.append(starts, len(draws))))
    return FrameLinks(
        run_of_frame=run[index].astype(np.int32),
        place_of_frame=(np.arange(len(draws)) - run)[index].astype(np.int32),
    )


PURPOSES = ("choose", "judge")
"""Worlds to choose a layout in, and worlds to judge it in, share no random number."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RandomStreams:
    """Where the random numbers of one sampled world come from.

    Attributes
    ----------
    seed : int
        The user's.
    purpose : str
        {"choose", "judge"}: what the world is for.
    index : int
        Number of the world.
    draw : int
        Of detections and lost messages: a world may be looked at more than
        once.
    """

    seed: int
    purpose: str
    index: int
    draw: int = 0

    def rng(self, *key: object) -> np.random.Generator:
        """Generator of one thing of this world.

        Its draws do not depend on any other thing.
        """
        thing = zlib.crc32(repr(key).encode())
        return np.random.default_rng(
            [self.seed, PURPOSES.index(self.purpose) + 1, self.index, thing]
        )

    def key(self, *thing: object) -> np.uint64:
        """Key of one thing's random numbers where each is made from a counter."""
        again = (self.draw,) if self.draw else ()
        where = repr((self.seed, self.purpose, self.index, *again, thing)).encode()
        return np.uint64(int.from_bytes(hashlib.blake2b(where, digest_size=8).digest()))


def mount_key(candidate: CandidatePose) -> tuple[object, ...]:
    """Key of a physical mount: a site, or a point where there is none.

    It is equal for all poses of that mount.
    """
    if candidate.site_id:
        return ("site", candidate.site_id)
    return ("point", *candidate.pose.position_m[:2].tolist())


def unit_key(candidate: CandidatePose) -> tuple[object, ...]:
    """Key of a unit: its mount, sensor model and quarter of the compass.

    They share what becomes of the unit: none is chosen because it alone was in order.
    """
    quarter = round(candidate.pose.yaw_deg / 90.0) % 4
    return (*mount_key(candidate), candidate.sensor.name, quarter)


def pose_key(candidate: CandidatePose) -> tuple[object, ...]:
    """Equal for units that are meant to see the same, whatever they are called."""
    pose = candidate.pose
    zoom_deg = getattr(candidate.sensor, "horizontal_fov_deg", None)
    angles_deg = (pose.yaw_deg, pose.pitch_deg, zoom_deg)
    return (*pose.position_m.tolist(), *angles_deg, candidate.sensor.name)


# Standard deviations: who is off by more, notices.
_CUT_OFF = 3.0
# Two thirds of all heights are as planned, a sixth is this much lower, and a sixth
# higher: in mean, variance and the moments up to the fifth as if they were normal
# (Gauss and Hermite's rule of three points). Few heights come up again: what hides what
# from there need not be found out anew.
# Standard deviations.
_HEIGHT_STEP = np.sqrt(3.0)
# Two thirds of all normal numbers are nearer to 0.
_LEVEL = 0.9674215661017014
# Above the road.
_LOWEST_M = 0.1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sample:
    """One sampled world: a setting, and the poses as they are mounted in it.

    Attributes
    ----------
    streams : RandomStreams
        Where its random numbers come from.
    uncertainty : Uncertainty
        What they are drawn of.
    setting : Setting
        The runs with all that stands in the street in them; deadlines less what
        messages take longer than the rule says; the share of messages that is
        lost.
    planned : tuple of CandidatePose
        Poses as planned.
    candidates : tuple of CandidatePose
        The same as they are really mounted; ids, sites and sensors are as
        planned.
    vehicles : tuple of PlacedActor
        All that stands in the street, in whichever runs.
    driving : TrafficCount
        How many drive by, in all runs together.
    n_as_planned : int
        Runs whose road users' drawn motions lead to no impact, and are not
        used.
    extra_latency_s : (n_runs,) float
        What messages take longer than the rule says. [s]
    """

    streams: RandomStreams
    uncertainty: Uncertainty
    setting: Setting
    planned: tuple[CandidatePose, ...]
    candidates: tuple[CandidatePose, ...]
    vehicles: tuple[PlacedActor, ...]
    driving: TrafficCount
    n_as_planned: int
    extra_latency_s: FloatArray

    @property
    def drawn_detector(self) -> ResponseDetector | None:
        """The detector whose detections are drawn frame by frame, if any are."""
        detector = self.setting.table_detector
        if self.uncertainty.draws_detections and isinstance(detector, ResponseDetector):
            return detector
        return None

    @property
    def looks_as_planned(self) -> bool:
        """True if every pose detects what it would in the plan."""
        return self.candidates is self.planned and self.is_seen_as_planned

    @property
    def is_seen_as_planned(self) -> bool:
        """True if the VUT, as planned, detects what it would in the plan.

        So does anybody else who is in its place.
        """
        is_empty = not self.vehicles and not self.driving.n_vehicles
        is_run_as_planned = is_empty and self.uncertainty.road_users.are_as_planned
        return is_run_as_planned and self.drawn_detector is None


def repeat_heavy_runs(setting: Setting, *, most: int) -> Setting:
    """Setting in which heavy runs are repeated.

    A run of k times the mean weight is there k times (rounded), at most `most`
    times. Copies share its weight and are drawn each by itself: the variance of a
    weighted sum is least so (Neyman), if runs are equally uncertain. Their ids end
    in "+1", "+2" and so on.
    """
    axis = setting.axis
    # How often each run is drawn.
    times = np.clip(np.rint(axis.weight / axis.weight.mean()), 1, most).astype(np.int64)
    if times.max() == 1:
        return setting
    rows = np.repeat(np.arange(axis.n_runs), times)
    copies = np.concatenate([np.arange(count) for count in times])
    encounters: dict[tuple[int, int], Any] = {}
    runs = []
    for row, copy in zip(rows.tolist(), copies.tolist(), strict=True):
        run = setting.runs[row]
        if copy:
            # One and the same in all weathers.
            key = (id(run.encounter), copy)
            encounter = encounters.setdefault(key, replace(run.encounter))
            run = replace(run, id=f"{run.id}+{copy}", encounter=encounter)
        runs.append(run)
    seen = setting.seen_by_vut
    if seen is not None:
        seen = np.concatenate([seen[axis.frames_of(row)] for row in rows.tolist()])
    return replace(
        setting,
        runs=tuple(runs),
        axis=build_frame_axis(runs, (axis.weight / times)[rows]),
        seen_by_vut=seen,
    )


def draw_samples(
    setting: Setting,
    candidates: Sequence[CandidatePose],
    uncertainty: Uncertainty,
    *,
    n_samples: int,
    seed: int,
    purpose: str = "choose",
    first: int = 0,
) -> Iterator[Sample]:
    """Draw worlds, one after the other: each is built when it is asked for.

    A world is the same whatever their number, and from which one on they are drawn.
    Worlds of one `purpose`, "choose" or "judge", share no random number with those of
    the other.

    All poses of one site share the mount's errors of yaw, pitch and height. What stands
    in the street is the same in all runs of a world, but for what would stand in a
    run's way. Road users move as :func:`draw_road_users` says, each run's by itself;
    what drives by is drawn for each group of runs (see :func:`.traffic.group_key`).
    Raises InputError for a number that cannot be, or vehicles in a scene without a
    junction; MissingExtraError where SUMO shall drive and is not installed.
    """
    check_whole("samples", n_samples, least=1)
    # Places for vehicles, and ways to keep clear, are found once.
    traffic = uncertainty.traffic
    if traffic.is_empty:
        street = None
    else:
        street = build_street(setting.scene, traffic)
    if street is None:
        ways = {}
    else:
        ways = build_ways(setting.runs, setting.rule)
    streams = RandomStreams(seed=seed, purpose=purpose, index=0)
    planned = tuple(candidates)
    draws = (
        partial(
            _draw,
            setting,
            planned,
            uncertainty,
            replace(streams, index=index),
            street,
            ways,
        )
        for index in range(first, first + n_samples)
    )
    return _one_ahead(draws)


def _one_ahead(draws: Iterator[Callable[[], Sample]]) -> Iterator[Sample]:
    """The next world is drawn, and SUMO drives in it, while this one is looked at."""
    with ThreadPoolExecutor(1) as pool:
        # At most one further world is drawn at a time.
        pending = [pool.submit(draw) for draw in islice(draws, 1)]
        while pending:
            sample = pending.pop().result()
            pending += [pool.submit(draw) for draw in islice(draws, 1)]
            yield sample


def _draw(
    setting: Setting,
    candidates: tuple[CandidatePose, ...],
    uncertainty: Uncertainty,
    streams: RandomStreams,
    street: StandingRoom | None,
    ways: dict[GroupKey, Ways],
) -> Sample:
    """Draw one world."""
    axis = setting.axis
    rule = setting.rule
    # Each kind of uncertainty has random numbers of its own.
    extra_s = uncertainty.latency.draw_s(
        streams.rng("latency"), axis.n_runs, rule_latency_s=rule.latency_s
    )
    vehicles = () if street is None else street.draw(streams.rng)
    runs = setting.runs
    n_as_planned = 0
    last_s = axis.last_brake_time_s
    if not uncertainty.road_users.are_as_planned:
        runs, n_as_planned = draw_road_users(
            runs, uncertainty.road_users, rule, streams.rng, setting.scene
        )
        last_s = np.array([run.last_brake_time_s for run in runs])
    # Parked and waiting vehicles leave the ways of each run free.
    if vehicles:
        clearance_m = uncertainty.traffic.clearance_m
        standing = clear_of_ways(vehicles, ways, clearance_m=clearance_m)
        runs = tuple(
            replace(run, obstruction=(*run.obstruction, *standing[group_key(run)]))
            for run in runs
        )
    driving = TrafficCount()
    if uncertainty.moving is not None:
        groups: dict[GroupKey, list[int]] = {}
        for row, run in enumerate(runs):
            groups.setdefault(group_key(run), []).append(row)
        runs, driving = uncertainty.moving.draw(
            runs,
            groups,
            frame_s=1.0 / rule.frame_rate_hz,
            clearance_m=uncertainty.traffic.clearance_m,
            rng=streams.rng("moving traffic"),
        )
    # Deadlines move by the extra latency; messages are lost as the uncertainty says.
    sample = Sample(
        streams=streams,
        uncertainty=uncertainty,
        setting=replace(
            _with_lasting_noise(setting, runs, uncertainty, streams),
            runs=runs,
            axis=replace(axis, last_brake_time_s=last_s - extra_s),
            radio=replace(setting.radio, packet_loss=uncertainty.packet_loss),
        ),
        planned=candidates,
        candidates=_as_mounted(candidates, uncertainty.mounting, streams),
        vehicles=vehicles,
        driving=driving,
        n_as_planned=n_as_planned,
        extra_latency_s=freeze(extra_s),
    )
    if sample.is_seen_as_planned:
        return sample
    return replace(sample, setting=replace(sample.setting, seen_by_vut=None))


def _with_lasting_noise(
    setting: Setting,
    runs: tuple[Run, ...],
    uncertainty: Uncertainty,
    streams: RandomStreams,
) -> Setting:
    """Setting whose detectors draw noise that lasts for a run.

    The shares of its variance are those of the uncertainty.
    """
    shares = (uncertainty.person_share, uncertainty.unit_person_share)
    if not uncertainty.draws_detections or shares == (0.0, 0.0):
        return setting
    # One number for each person and run, in all its frames.
    numbers = draw_index(runs)
    drawn = streams.rng("person").standard_normal(len(numbers))
    person = np.zeros(numbers.max() + 1)
    person[numbers] = np.sqrt(shares[0]) * drawn[link_frames(numbers).run_of_frame]
    lasting = LastingNoise(
        person=freeze(person), person_share=shares[0], unit_person_share=shares[1]
    )
    changed: dict[str, Any] = {
        name: replace(detector, lasting=lasting)
        for name in ("detector", "table_detector")
        if isinstance(detector := getattr(setting, name), ResponseDetector)
    }
    return replace(setting, **changed)


def _as_mounted(
    candidates: tuple[CandidatePose, ...],
    errors: MountingErrors,
    streams: RandomStreams,
) -> tuple[CandidatePose, ...]:
    """Candidates as they are really mounted."""
    # All poses of one mount share its error.
    spread = np.array([errors.yaw_sd_deg, errors.pitch_sd_deg, errors.height_sd_m])
    if not spread.any():
        return candidates
    off: dict[tuple[object, ...], tuple[float, float, float]] = {}
    for key in dict.fromkeys(mount_key(candidate) for candidate in candidates):
        normal = streams.rng("mount", *key).standard_normal(3)
        normal[2] = _HEIGHT_STEP * np.sign(normal[2]) * (abs(normal[2]) > _LEVEL)
        yaw, pitch, height = (spread * np.clip(normal, -_CUT_OFF, _CUT_OFF)).tolist()
        off[key] = (yaw, pitch, height)
    return tuple(
        replace(candidate, pose=_off(candidate.pose, *off[mount_key(candidate)]))
        for candidate in candidates
    )


def _off(pose: Pose, yaw_deg: float, pitch_deg: float, height_m: float) -> Pose:
    """A pose that is off by angles and a height; never below the road."""
    east, north, up = pose.position_m.tolist()
    position_m = np.array([east, north, max(up + height_m, min(up, _LOWEST_M))])
    pitch_deg = float(np.clip(pose.pitch_deg + pitch_deg, -90.0, 90.0))
    return Pose(
        position_m=position_m, yaw_deg=pose.yaw_deg + yaw_deg, pitch_deg=pitch_deg
    )


# ---------- road users who move otherwise than a case says


# Of a contact before the impact: more is another impact, somewhere else.
_MAX_EARLY_S = 0.3


def draw_road_users(
    runs: Sequence[Run],
    users: RoadUsers,
    rule: AebRule,
    rng: Callable[..., np.random.Generator],
    scene: Scene,
) -> tuple[tuple[Run, ...], int]:
    """Runs of one sampled world, with road users who move otherwise.

    The second value says how many move as planned because they must. `rng` gives
    each encounter its generator: a run is the same in all weathers, and does not
    depend on others. Speed, start, heading and way are drawn evenly within their
    limits, measured speeds and starts as often as measured. The planned way stays
    where something stands in the other one, the planned motion where the drawn one
    leads to no impact at the planned place.
    """
    # One and the same encounter in all weathers.
    alike = {id(run.encounter): run for run in runs}
    drawn: dict[int, Encounter] = {}
    for key, run in alike.items():
        place = (run.case.name, run.approach, run.position, run.vut_speed_kmh)
        both = (run.case.vru_speed_kmh,) if run.case.pairs_kmh else ()
        other = _draw_one(run, users, rng("road user", *place, *both), scene)
        if other is not None:
            drawn[key] = other
    last_s = last_brake_times_s([*drawn.values()], rule)
    changes: dict[int, dict[str, Any]] = {}
    for (key, encounter), brake_s in zip(drawn.items(), last_s.tolist(), strict=True):
        changes[key] = frames_at(encounter, alike[key].time_s)
        changes[key] |= {"encounter": encounter, "last_brake_time_s": brake_s}
    changed = []
    n_kept = 0
    for run in runs:
        change = changes.get(id(run.encounter))
        if change is None:
            n_kept += 1
            changed.append(run)
        else:
            changed.append(replace(run, **change))
    return tuple(changed), n_kept


def _draw_one(
    run: Run, users: RoadUsers, random: np.random.Generator, scene: Scene
) -> Encounter | None:
    """Draw an encounter; None where it has no impact at the planned place."""
    encounter = run.encounter
    planned_mps = encounter.vru_motion.speed_mps
    faster_mps = (
        random.uniform(*users.speed_kmh(encounter.vru.class_name)) * MPS_PER_KMH
    )
    # All numbers are drawn in any case: each is independent of the others.
    nearer_share = random.uniform(0.0, users.start_nearer_share)
    turn_deg = random.uniform(*users.heading_deg.get(run.case.family, (0.0, 0.0)))
    aside_m = random.uniform(*users.path_m.get(run.case.family, (0.0, 0.0)))
    is_steady = planned_mps > 0.0 and np.isinf(encounter.vru_motion.brake_time_s)
    start_mps2 = None
    if is_steady:
        speed_mps = planned_mps + faster_mps
        measured = users.measured.get(encounter.vru.class_name)
        if measured is not None and run.case.recorded is None:
            speed_kmh, start_mps2 = measured.draw(random, planned_mps / MPS_PER_KMH)
            speed_mps = speed_kmh * MPS_PER_KMH + faster_mps
    else:
        # Who stands or brakes does what the case is about.
        speed_mps = planned_mps
        nearer_share = 0.0
    # Another way is taken if nothing stands in it.
    if turn_deg or aside_m:
        other = change_motion(
            run,
            speed_mps=speed_mps,
            nearer_share=nearer_share,
            turn_deg=_sense(run) * turn_deg,
            aside_m=aside_m,
            start_mps2=start_mps2,
        )
        if other is not None:
            motion = other.vru_motion
            if is_way_free(encounter.vru, motion, scene, run.obstruction):
                return other
    return change_motion(
        run, speed_mps=speed_mps, nearer_share=nearer_share, start_mps2=start_mps2
    )


def _sense(run: Run) -> float:
    """Sense of a turn: 1 is counter-clockwise, -1 clockwise.

    It is -1 where traffic keeps left, since all is mirrored.
    """
    if run.case.kind != "crossing":
        return 1.0
    _, north = rotated([1.0, 0.0], float(run.vru_yaw_deg[-1] - run.vut_yaw_deg[-1]))
    if (north > 0.0) == (run.case.vru_side == "near"):
        return 1.0
    return -1.0


def change_motion(
    run: Run,
    *,
    speed_mps: float,
    nearer_share: float = 0.0,
    turn_deg: float = 0.0,
    aside_m: float = 0.0,
    start_mps2: float | None = None,
) -> Encounter | None:
    """A run's encounter with a road user who moves otherwise than planned.

    It is faster or slower, starts nearer to the impact, or takes another way. Its
    way from rest to the impact is shorter by `nearer_share`, turned about the
    impact by `turn_deg`, counter-clockwise, then `aside_m` farther to its left.
    With `start_mps2` it sets off so, else over the planned distance. The VUT keeps
    its way; both are at the impact as planned. None: the bodies do not touch, or long
    before, somewhere else.
    """
    encounter = run.encounter
    vru = encounter.vru_motion
    if speed_mps < 0.0 or (speed_mps == 0.0 and vru.speed_mps > 0.0):
        return None
    # Another speed, start or acceleration.
    motion = vru
    gains_m = vru.acceleration_distance_m
    if start_mps2 is not None and gains_m > 0.0:
        gains_m = 0.5 * speed_mps**2 / start_mps2
    if (
        speed_mps != vru.speed_mps
        or nearer_share
        or gains_m != vru.acceleration_distance_m
    ):
        whole_m = float(vru.distance_m(0.0))
        ahead_m = nearer_share * whole_m
        travel_s = travel_time_s(
            whole_m - ahead_m,
            speed_mps=speed_mps,
            acceleration_distance_m=gains_m,
        )
        path = vru.path
        if ahead_m:
            path = MovedPath(path=path, ahead_m=ahead_m)
        motion = Motion(
            path=path,
            speed_mps=speed_mps,
            start_time_s=-travel_s,
            acceleration_distance_m=gains_m,
        )
    # Another way: turned about the impact, then moved aside.
    if turn_deg or aside_m:
        there_m, yaw_deg = vru.path.at(vru.distance_m(0.0))
        shift_m = there_m - rotated(there_m, turn_deg)
        shift_m = shift_m + rotated([0.0, aside_m], float(yaw_deg) + turn_deg)
        east_m, north_m = shift_m.tolist()
        path = MovedPath(path=motion.path, turn_deg=turn_deg, shift_m=(east_m, north_m))
        motion = replace(motion, path=path)
    # Shift both so that the first contact is at the planned time.
    changed = replace(encounter, vru_motion=motion)
    early_s = first_contact_s(changed)
    if not abs(early_s) <= _MAX_EARLY_S:
        return None
    return replace(
        changed,
        vut_motion=_later(changed.vut_motion, -early_s),
        vru_motion=_later(changed.vru_motion, -early_s),
    )


def _later(motion: Motion, seconds: float) -> Motion:
    """A motion that begins and brakes later."""
    return replace(
        motion,
        start_time_s=motion.start_time_s + seconds,
        brake_time_s=motion.brake_time_s + seconds,
    )
