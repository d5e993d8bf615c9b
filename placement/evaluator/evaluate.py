"""From sights to verdicts: detections, messages, confirmation, braking, contact."""

import logging
import zlib
from collections.abc import Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, as_completed, wait
from contextlib import closing
from dataclasses import dataclass, fields, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray, freeze
from geometry.errors import refuse
from geometry.image_boxes import box_height_px
from geometry.lidar import LidarModel, load_lidar_detection
from geometry.phrases import Phrase
from geometry.poses import wrap_deg
from geometry.sensors import CameraModel
from geometry.tables import read_data
from geometry.weather import pick_weather
from scenarios.aeb import AebRule, find_contacts
from scenarios.paths import MPS_PER_KMH
from scenarios.runs import FrameAxis, Run, build_frame_axis, find_onsets

from ..cache import CachedArrays, cached_value
from ..candidates import CandidatePose
from ..compute import DEFAULT_COMPUTE, Compute, one_blas_thread, threads
from ..detectors import Evidence, is_matched, load_min_iou
from ..evaluation import Evaluation, Verdict, earliest_arrival_s
from ..fingerprints import Fingerprints
from ..layout import Layout
from ..setting import Radio, Setting
from .picture_sources import PictureSource, build_picture_source
from .surroundings import (
    FrameCamera,
    build_surroundings,
    draw_index,
    load_vut_camera,
    load_vut_lidar,
)

# ---------- frames in which the VRU is detected, by every unit and by the VUT itself
UnitKey = tuple[object, ...]
VUT_KEY: UnitKey = ("vut",)
STAGE = Phrase("evaluate")
_log = logging.getLogger(__name__)

# Parts of the VUT's frames: nothing repeats there, so that they take longer.
_VUT_JOBS = 4
_POLL_S = 0.5


def unit_key(unit: CandidatePose) -> UnitKey:
    """Key of what a unit sees: equal for units that see the same."""
    pose = unit.pose
    return (*pose.position_m.tolist(), pose.yaw_deg, pose.pitch_deg, unit.sensor)


def build_rng(seed: int, *key: object) -> np.random.Generator:
    """Random numbers of its own for each key, whatever else there is."""
    return np.random.default_rng([seed, zlib.crc32(repr(key).encode())])


def watch(
    setting: Setting, units: Mapping[UnitKey, CandidatePose], *, compute: Compute
) -> dict[UnitKey, BoolArray]:
    """Frames in which each unit and the VUT itself detect the VRU.

    Parameters
    ----------
    setting : Setting
        Scene, runs, detector and the VUT's sensors.
    units : mapping of UnitKey to CandidatePose
        Units to look from.
    compute : Compute
        Seed, threads, cache folder. Progress is called from the calling thread: first
        with poses looked from, a quarter of the VUT's frames counting as one; then,
        where the detector looks at pictures, with pictures.

    Returns
    -------
    detected : dict of UnitKey to (n_frames,) bool
        Also under ``VUT_KEY``. No message is lost yet.

    Notes
    -----
    What an earlier call has cached is not looked at again.
    """
    names = _names(setting, units)
    cached = _open_cache(setting, compute)
    if setting.seen_by_vut is not None:
        cached.arrays[names[VUT_KEY]] = setting.seen_by_vut
    new = {key: unit for key, unit in units.items() if names[key] not in cached.arrays}
    nothing = np.zeros(setting.axis.n_frames, dtype=bool)
    if new or names[VUT_KEY] not in cached.arrays:
        watcher = _Watcher(setting, compute)
        with_vut = names[VUT_KEY] not in cached.arrays
        looks, by_lidar = watcher.look(new, with_vut=with_vut)
        by_camera = watcher.find(looks, new)
        watched = tuple(new)
        if with_vut:
            watched = (VUT_KEY, *new)
        found = {
            names[key]: by_camera.get(key, nothing) | by_lidar.get(key, nothing)
            for key in watched
        }
        cached.add(found)
    return {key: cached.arrays[name] for key, name in names.items()}


def with_sight(setting: Setting, *, compute: Compute = DEFAULT_COMPUTE) -> Setting:
    """Setting that knows in which frames the VUT's own sensors detect.

    Unchanged if no VUT sees, or if it knows already.
    """
    if not setting.cars or setting.seen_by_vut is not None:
        return setting
    with one_blas_thread():
        seen = watch(setting, {}, compute=compute.within(Phrase("what the car sees")))[
            VUT_KEY
        ]
    return replace(setting, seen_by_vut=freeze(seen))


# ---------- the cache for the next call
# Raise it whenever the same inputs give other detections.
_KIND = "place-rsus/views/2"


def _names(
    setting: Setting, units: Mapping[UnitKey, CandidatePose]
) -> dict[UnitKey, str]:
    """Names in the cache of the frames in which each unit and the VUT detect."""
    hashes = Fingerprints()
    vut = hashes.of(
        setting.vut_sensors, setting.vut_camera, load_vut_camera(), load_vut_lidar()
    )
    return {VUT_KEY: f"vut-{vut}"} | {
        key: f"unit-{hashes.of(unit.pose, unit.sensor)}" for key, unit in units.items()
    }


def _open_cache(setting: Setting, compute: Compute) -> CachedArrays:
    """Cache of detected frames; empty where a network looks at pictures."""
    folder = compute.cache_folder
    if folder is None or setting.detector.needs_pictures:
        return CachedArrays(None, "views", kind=_KIND, fingerprint="")
    fingerprint = _fingerprint(setting, compute.seed)
    return CachedArrays(folder, "views", kind=_KIND, fingerprint=fingerprint)


def _fingerprint(setting: Setting, seed: int) -> str:
    """Hash of all that detections depend on, except what looks.

    That is, without the units and the VUT's sensors.
    """
    scene = setting.scene
    runs = setting.runs
    weathers = dict.fromkeys(run.weather for run in runs)
    return Fingerprints().of(
        _KIND,
        seed,
        setting.detector,
        load_min_iou(),
        load_lidar_detection(),
        scene.vertices_m,
        scene.triangles,
        scene.triangle_instance,
        [instance.class_name for instance in scene.instances],
        [pick_weather(name, "runs: weather") for name in weathers],
        draw_index(runs),
        [
            (
                run.weather,
                run.encounter.vut,
                run.encounter.vru,
                run.obstruction,
                run.traffic,
                run.terrain,
                run.time_s,
                run.vut_position_m,
                run.vut_yaw_deg,
                run.vru_position_m,
                run.vru_yaw_deg,
                run.vru_shape,
            )
            for run in runs
        ],
    )


class _Watcher:
    """Looks from every unit, then lets the detector find the VRU.

    Renderers are loaded only then: not where all is known from an earlier call.
    """

    def __init__(self, setting: Setting, compute: Compute) -> None:
        self._setting = setting
        self._compute = compute
        self._seed = compute.seed
        self._surroundings = build_surroundings(setting.scene, setting.runs)
        mount = load_vut_camera()
        self._mount = replace(mount, camera=setting.vut_camera or mount.camera)

    def look(
        self, units: Mapping[UnitKey, CandidatePose], *, with_vut: bool
    ) -> tuple[dict[UnitKey, Evidence], dict[UnitKey, BoolArray]]:
        """Evidence of cameras, and the frames in which LiDARs detect.

        Parameters
        ----------
        units : mapping of UnitKey to CandidatePose
            Units to look from.
        with_vut : bool
            Look from the VUT, too, with the sensors that the setting gives it.

        Returns
        -------
        evidence : dict of UnitKey to Evidence
            Of cameras.
        detected : dict of UnitKey to (n_frames,) bool
            By LiDARs.
        """
        from . import perceive

        seed = self._seed
        around = self._surroundings
        mount = self._mount
        least_px = self._setting.detector.min_box_height_px
        n_frames = self._setting.axis.n_frames
        parts = np.array_split(np.arange(n_frames), min(_VUT_JOBS, n_frames))
        looks: dict[UnitKey, Future[Evidence]] = {}
        scans: dict[UnitKey, Future[BoolArray]] = {}
        by_vut: list[Future[Evidence]] = []
        # One job for each unit, and several for the VUT's camera.
        with threads(self._compute.workers) as pool:
            if with_vut and "camera" in self._setting.vut_sensors:
                by_vut = [
                    pool.submit(
                        perceive.perceive_frames,
                        around.take(frames),
                        mount,
                        min_height_px=least_px,
                    )
                    for frames in parts
                ]
            if with_vut and "lidar" in self._setting.vut_sensors:
                rng = build_rng(seed, VUT_KEY, "lidar")
                scans[VUT_KEY] = pool.submit(
                    perceive.scan_frames, around, mount, load_vut_lidar(), rng
                )
            for key, unit in units.items():
                if isinstance(unit.sensor, LidarModel):
                    scans[key] = pool.submit(
                        perceive.scan_frames,
                        around,
                        unit.pose,
                        unit.sensor,
                        build_rng(seed, key),
                    )
                else:
                    looks[key] = pool.submit(
                        perceive.perceive_frames,
                        around,
                        (unit.pose, unit.sensor),
                        min_height_px=least_px,
                    )
            jobs: list[Future[Any]] = [*by_vut, *looks.values(), *scans.values()]
            for n_done, future in enumerate(as_completed(jobs), start=1):
                future.result()
                self._compute.progress(STAGE, n_done, len(jobs))
        seen = {key: future.result() for key, future in looks.items()}
        if by_vut:
            seen[VUT_KEY] = _join([future.result() for future in by_vut])
        return seen, {
            key: self._find_in_points(key, future.result(), units.get(key))
            for key, future in scans.items()
        }

    def _find_in_points(
        self, key: UnitKey, is_enough: BoolArray, unit: CandidatePose | None
    ) -> BoolArray:
        """Frames in which the detector finds the VRU in a LiDAR's points.

        Parameters
        ----------
        key : UnitKey
            Of the unit.
        is_enough : (n_frames,) bool
            Frames with enough points on the VRU.
        unit : CandidatePose or None
            None for the VUT itself.

        Returns
        -------
        detected : (n_frames,) bool
            All of `is_enough` if the detector has no table for LiDARs.
        """
        table = self._setting.detector.lidar
        runs = self._setting.runs
        around = self._surroundings
        if table is None:
            return is_enough
        vru_m = np.concatenate([run.vru_position_m[:, :2] for run in runs])
        if unit is None:
            lidar_m = np.concatenate([run.vut_position_m[:, :2] for run in runs])
        else:
            lidar_m = unit.pose.position_m[:2]
        east_m, north_m = (vru_m - lidar_m).T
        distance = np.hypot(east_m, north_m)
        rng = build_rng(self._seed, key, table.name)
        return is_enough & table.detect(
            distance, around.vru_class, around.draw_index, rng
        )

    def find(
        self, looks: Mapping[UnitKey, Evidence], units: Mapping[UnitKey, CandidatePose]
    ) -> dict[UnitKey, BoolArray]:
        """Frames in which the detector finds the VRU in what each camera shows."""
        detector = self._setting.detector
        if not detector.needs_pictures:
            return {key: self._detect(key, evidence) for key, evidence in looks.items()}
        heights = [box_height_px(evidence.visible_px) for evidence in looks.values()]
        least_px = max(detector.min_box_height_px, np.finfo(float).tiny)
        n_pictures = sum(int((height >= least_px).sum()) for height in heights)
        _log.warning(
            "%s pictures for the network: about %.0f minutes of processor time",
            n_pictures,
            n_pictures * detector.seconds_per_picture / 60.0,
        )
        source = build_picture_source(
            self._setting.scene, self._setting.runs, seed=self._seed
        )
        # The VUT's pictures take longest, for nothing stands still in them: they are
        # drawn first.
        longest_first = sorted(looks.items(), key=lambda item: item[0] != VUT_KEY)
        with threads(self._compute.workers) as pool, closing(source):
            found = {
                key: pool.submit(
                    self._detect,
                    key,
                    self._with_pictures(evidence, source, units.get(key)),
                )
                for key, evidence in longest_first
            }
            pending = set(found.values())
            while pending:
                done, pending = wait(
                    pending, timeout=_POLL_S, return_when=FIRST_COMPLETED
                )
                for future in done:
                    future.result()
                self._compute.progress(STAGE, source.n_drawn, n_pictures)
        return {key: found[key].result() for key in looks}

    def _detect(self, key: UnitKey, evidence: Evidence) -> BoolArray:
        """Frames in which the detector finds the VRU in one camera's evidence."""
        found = self._setting.detector.detect(evidence, build_rng(self._seed, key))
        return is_matched(found, evidence.visible_px, min_iou=load_min_iou())

    def _with_pictures(
        self, evidence: Evidence, source: PictureSource, unit: CandidatePose | None
    ) -> Evidence:
        """Evidence with pictures for the detector, whole ones and crops."""
        camera: FrameCamera = self._mount
        if unit is not None:
            assert isinstance(unit.sensor, CameraModel)
            camera = unit.pose, unit.sensor
        crops = source.crops(camera, evidence.amodal_px)
        return replace(evidence, picture=source.pictures(camera), crops=crops)


def _join(parts: Sequence[Evidence]) -> Evidence:
    """Evidence of consecutive frames in one."""
    values = {
        one.name: [getattr(part, one.name) for part in parts]
        for one in fields(Evidence)
    }
    arrays: dict[str, Any] = {
        name: np.concatenate(each)
        for name, each in values.items()
        if each[0] is not None
    }
    return Evidence(**arrays)


# ---------- verdicts: confirmation, braking, contact
_Contact = tuple[float, float]
Party = tuple[BoolArray, float]
"""Detected frames that reach the VUT, (n_frames,), and the time until it knows. [s]"""


class Judge:
    """Verdicts on the same runs.

    Remembers which onsets of braking end in contact, and at what speed.

    Parameters
    ----------
    runs : sequence of Run
        The runs.
    axis : FrameAxis
        Their frames.
    rule : AebRule
        Confirmation, latency and braking.
    cache_folder : Path, optional
        Where verdicts are kept for the next call; by default nowhere.
    """

    def __init__(
        self,
        runs: Sequence[Run],
        axis: FrameAxis,
        rule: AebRule,
        cache_folder: Path | None = None,
    ) -> None:
        self.axis = axis
        self._runs = runs
        self._rule = rule
        self._cache_folder = cache_folder
        # By encounter, which runs that differ by weather alone share, then by onset.
        self._contacts: dict[int, dict[float, _Contact]] = {
            id(run.encounter): {} for run in runs
        }

    def verdicts(self, fused: Sequence[Sequence[Party]]) -> tuple[Verdict, ...]:
        """Verdicts on groups of parties.

        In each frame any one party of a group may be the detector. Braking begins
        when the last message has arrived that confirms the track which is alive at
        the last moment; whether it avoids contact is asked of the bodies, not of
        the last moment.
        """
        return cached_value(
            self._cache_folder,
            "verdicts",
            lambda: self._find_verdicts(fused),
            kind=tuple[Verdict, ...],
            made_from=(
                [run.encounter for run in self._runs],
                self.axis,
                self._rule,
                fused,
            ),
        )

    def _find_verdicts(self, fused: Sequence[Sequence[Party]]) -> tuple[Verdict, ...]:
        """Verdicts on groups of parties, found anew."""
        arrivals = [earliest_arrival_s(parties, self.axis) for parties in fused]
        onsets = [
            find_onsets(arrival, self.axis, rule=self._rule) for arrival in arrivals
        ]
        contacts = self._find_contacts(np.array([each.onset_s for each in onsets]))
        return tuple(
            Verdict(
                detected=np.isfinite(arrival),
                confirmation_time_s=each.confirmation_s,
                onset_time_s=each.onset_s,
                is_avoided=np.isinf(time_s),
                impact_speed_kmh=speed_mps / MPS_PER_KMH,
            )
            for arrival, each, (time_s, speed_mps) in zip(
                arrivals, onsets, contacts, strict=True
            )
        )

    def _find_contacts(self, onset_s: FloatArray) -> FloatArray:
        """Time and speed at contact after onsets of braking.

        Parameters
        ----------
        onset_s : (n, n_runs) float
            [s]

        Returns
        -------
        contacts : (n, 2, n_runs) float
            The time is infinite where there is no contact. [s], [m/s]
        """
        contacts = np.empty((len(onset_s), 2, len(self._runs)))
        for index, run in enumerate(self._runs):
            asked = onset_s[:, index].tolist()
            known = self._contacts[id(run.encounter)]
            new = [each for each in dict.fromkeys(asked) if each not in known]
            if new:
                found = find_contacts(run.encounter, new, self._rule)
                rows = zip(found.time_s.tolist(), found.speed_mps.tolist(), strict=True)
                known.update(zip(new, rows, strict=True))
            contacts[:, :, index] = [known[each] for each in asked]
        return contacts


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PartyDetections:
    """Detections of each party of a layout.

    Attributes
    ----------
    layout : Layout
        The layout.
    units : mapping of str to Party
        By the unit's id.
    vut : Party
        The VUT's own sensors.
    vam : Party, optional
        Messages of road users, if any send them.
    """

    layout: Layout
    units: Mapping[str, Party]
    vut: Party
    vam: Party | None = None


def judge_layouts(
    judge: Judge, seen: Sequence[PartyDetections], *, cars: float = 0.0
) -> list[Evaluation]:
    """Evaluations of layouts by what their units and the VUT detect.

    Parameters
    ----------
    judge : Judge
        Gives the verdicts.
    seen : sequence of PartyDetections
        Detections of each layout.
    cars : float
        Share of VUTs that see for themselves.
    """
    # Groups of parties to judge, for each layout.
    fused: list[dict[tuple[str, ...], list[Party]]] = []
    for one in seen:
        rsus = [*one.units.values()]
        groups: dict[tuple[str, ...], list[Party]] = {
            ("unit", name): [party] for name, party in one.units.items()
        }
        groups["vut",] = [one.vut]
        groups["rsu_all",] = rsus
        groups["vut_and_rsus",] = [*rsus, one.vut]
        if one.vam is not None:
            groups["vam",] = [one.vam]
            groups["all_sources",] = [*rsus, one.vut, one.vam]
        fused.append(groups)
    # All of them are judged at once: verdicts come back in the same order.
    verdicts = iter(
        judge.verdicts([parties for groups in fused for parties in groups.values()])
    )
    evaluations = []
    for one, groups in zip(seen, fused, strict=True):
        found = {key: next(verdicts) for key in groups}
        evaluations.append(
            Evaluation(
                layout=one.layout,
                axis=judge.axis,
                vut=found["vut",],
                units={name: found["unit", name] for name in one.units},
                rsu_all=found["rsu_all",],
                vut_and_rsus=found["vut_and_rsus",],
                others={
                    name: found[name,] for name in ("vam", "all_sources") if one.vam
                },
                cars=cars,
            )
        )
    return evaluations


# ---------- VRU awareness messages (VAM)
@dataclass(frozen=True, slots=True, kw_only=True)
class VamRule:
    """When a device sends: see ``data/vam.toml``.

    Attributes
    ----------
    min_interval_s, max_interval_s : float
        Not sooner after the last message, and not later. [s]
    position_change_m, speed_change_mps, heading_change_deg : float
        Changes that make a message due. [m], [m/s], [deg]
    """

    min_interval_s: float
    max_interval_s: float
    position_change_m: float
    speed_change_mps: float
    heading_change_deg: float


@cache
def load_vam_rule() -> VamRule:
    """Rule of the standard, from ``data/vam.toml``."""
    return read_data("placement", "vam.toml", VamRule)


def sent_frames(run: Run, rule: VamRule) -> BoolArray:
    """Frames of a run in which the VRU's device sends.

    Parameters
    ----------
    run : Run
        Its VRU moves.
    rule : VamRule
        When a message is due.

    Returns
    -------
    is_sent : (n_frames,) bool
        The first frame is one of them.
    """
    time = run.time_s
    position = run.vru_position_m
    yaw = run.vru_yaw_deg
    steps = np.linalg.norm(np.diff(position, axis=0), axis=1)
    speed = np.zeros(1)
    if len(time) > 1:
        # The last frame has the speed of the one before.
        speed = np.append(steps / np.diff(time), 0.0)
        speed[-1] = speed[-2]
    is_sent = np.zeros(len(time), dtype=bool)
    is_sent[0] = True
    last = 0
    for frame in range(1, len(time)):
        waited_s = time[frame] - time[last] + _ROUNDING_S
        is_due = waited_s >= rule.max_interval_s or (
            waited_s >= rule.min_interval_s
            and (
                np.linalg.norm(position[frame] - position[last])
                > rule.position_change_m
                or abs(speed[frame] - speed[last]) > rule.speed_change_mps
                or abs(wrap_deg(yaw[frame] - yaw[last])) > rule.heading_change_deg
            )
        )
        if is_due:
            is_sent[frame] = True
            last = frame
    return is_sent


def known_frames(
    runs: Sequence[Run], links: Radio, rng: np.random.Generator
) -> BoolArray:
    """Frames in which the VUT knows of the VRU from its own messages.

    Parameters
    ----------
    runs : sequence of Run
        All runs.
    links : Radio
        Share of VRUs with a device, and of lost messages.
    rng : Generator
        Says who is equipped and which messages are lost.

    Returns
    -------
    known : (n_frames,) bool
        Of all runs, end to end.

    Notes
    -----
    A message that was received counts until the next one must come. The device is taken
    to know its own position exactly.
    """
    rule = load_vam_rule()
    random: dict[int, tuple[float, FloatArray]] = {}
    known = []
    for run in runs:
        key = id(run.encounter)
        # The random numbers of an encounter are the same in all weathers.
        if key not in random:
            random[key] = (float(rng.random()), rng.random(len(run.time_s)))
        equipment, reception = random[key]
        is_received = reception >= links.packet_loss
        received_s = np.where(sent_frames(run, rule) & is_received, run.time_s, -np.inf)
        age_s = run.time_s - np.maximum.accumulate(received_s)
        is_fresh = age_s <= rule.max_interval_s + _ROUNDING_S
        known.append((equipment < links.vam_rate) & is_fresh)
    return np.concatenate(known)


_ROUNDING_S = 1.0e-6


# ---------- evaluation of layouts
def evaluate_layout(
    layout: Layout, setting: Setting, *, compute: Compute = DEFAULT_COMPUTE
) -> Evaluation:
    """Evaluate one layout; see :func:`evaluate_layouts`."""
    return evaluate_layouts([layout], setting, compute=compute)[0]


def evaluate_layouts(
    layouts: Sequence[Layout], setting: Setting, *, compute: Compute = DEFAULT_COMPUTE
) -> list[Evaluation]:
    """Verdicts of layouts: render every frame, detect, confirm and brake.

    Parameters
    ----------
    layouts : sequence of Layout
        Units at the same pose in several layouts are rendered once.
    setting : Setting
        Scene, runs, braking rule, detector, radio.
    compute : Compute
        What is left to chance are misses, lost messages, who carries a device. A unit's
        luck depends on its pose, not on the layout that it is part of. For the progress
        see :func:`placement.evaluator.evaluate.watch`.

    Returns
    -------
    evaluations : list of Evaluation
        One per layout.

    Raises
    ------
    InputError
        The setting's axis does not belong to its runs.
    """
    runs = setting.runs
    axis = setting.axis
    times_s = np.concatenate([run.time_s for run in runs])
    if tuple(run.id for run in runs) != axis.run_ids or not np.array_equal(
        times_s, axis.time_s
    ):
        refuse("axis", "frames of other runs", "the frame axis of these runs")
    seen = received(layouts, setting, compute=compute)
    judge = Judge(runs, axis, setting.rule, compute.cache_folder)
    if setting.radio.vam_rate > 0.0:
        rng = build_rng(compute.seed, "vam")
        known = known_frames(setting.runs, setting.radio, rng)
        seen = [replace(one, vam=(known, setting.rule.latency_s)) for one in seen]
    return judge_layouts(judge, seen, cars=setting.cars)


def received(
    layouts: Sequence[Layout], setting: Setting, *, compute: Compute
) -> list[PartyDetections]:
    """What the VUT gets to know from the units of layouts, and by itself.

    Road users' own messages are not in it. Parameters are those of
    :func:`evaluate_layouts`.
    """
    compute.progress(STAGE, 0, 0)
    units = {unit_key(unit): unit for layout in layouts for unit in layout.units}
    with one_blas_thread():
        detected = watch(setting, units, compute=compute)
    return [
        PartyDetections(
            layout=layout,
            units=_arriving(layout, setting, detected, compute.seed),
            vut=(detected[VUT_KEY], setting.rule.latency_s),
        )
        for layout in layouts
    ]


def evaluate_again(
    evaluations: Sequence[Evaluation],
    asked: Setting,
    setting: Setting,
    *,
    compute: Compute = DEFAULT_COMPUTE,
) -> list[Evaluation]:
    """Evaluate layouts in another setting, without looking twice at the same frames.

    Only runs that the first setting lacks are looked at; messages that were lost there
    are lost here, too.

    Parameters
    ----------
    evaluations : sequence of Evaluation
        Of the layouts in `asked`.
    asked, setting : Setting
        The setting of these evaluations, and the other one. Scene, sensors and detector
        are the same.
    compute : Compute
        Of what has to be looked at.

    Returns
    -------
    evaluations : list of Evaluation
        In `setting`, in the same order.
    """
    known = {run.id: index for index, run in enumerate(asked.runs)}
    is_known = np.array(
        [
            run.id in known and _has_same_frames(run, asked.runs[known[run.id]])
            for run in setting.runs
        ]
    )
    # Rows of the frames: first those of `asked`, then those that are looked at now.
    starts = np.empty(len(setting.runs), dtype=int)
    for row in np.flatnonzero(is_known):
        starts[row] = asked.axis.run_start[known[setting.runs[row].id]]
    further: list[Evaluation] | None = None
    if not is_known.all():
        rest = [setting.runs[row] for row in np.flatnonzero(~is_known)]
        axis = build_frame_axis(rest, np.full(len(rest), 1.0 / len(rest)))
        starts[~is_known] = asked.axis.n_frames + axis.run_start[:-1]
        further = evaluate_layouts(
            [one.layout for one in evaluations],
            replace(setting, runs=tuple(rest), axis=axis, seen_by_vut=None),
            compute=compute,
        )
    lengths = [len(run.time_s) for run in setting.runs]
    frames = np.concatenate(
        [start + np.arange(n) for start, n in zip(starts, lengths, strict=True)]
    )
    seen = []
    for index, one in enumerate(evaluations):
        parts = [one]
        if further is not None:
            parts.append(further[index])
        seen.append(_seen_in_frames(parts, frames, setting.rule))
    judge = Judge(setting.runs, setting.axis, setting.rule, compute.cache_folder)
    return judge_layouts(judge, seen, cars=setting.cars)


def _has_same_frames(one: Run, other: Run) -> bool:
    """True if both bodies are at the same places at the same times."""
    pairs = (
        (one.time_s, other.time_s),
        (one.vut_position_m, other.vut_position_m),
        (one.vut_yaw_deg, other.vut_yaw_deg),
        (one.vru_position_m, other.vru_position_m),
        (one.vru_yaw_deg, other.vru_yaw_deg),
    )
    return all(np.array_equal(first, second) for first, second in pairs)


def _seen_in_frames(
    parts: Sequence[Evaluation], frames: IntArray, rule: AebRule
) -> PartyDetections:
    """Detections of a layout's parties in `frames`, rows of all parts end to end."""

    def detected(verdicts: Sequence[Verdict]) -> BoolArray:
        return np.concatenate([verdict.detected for verdict in verdicts])[frames]

    layout = parts[0].layout
    vam: Party | None = None
    if "vam" in parts[0].others:
        known = detected([part.others["vam"] for part in parts])
        vam = (known, rule.latency_s)
    units = {}
    for unit in layout.units:
        by_unit = detected([part.units[unit.id] for part in parts])
        units[unit.id] = (by_unit, unit.latency(rule))
    by_vut = detected([part.vut for part in parts])
    return PartyDetections(
        layout=layout, units=units, vut=(by_vut, rule.latency_s), vam=vam
    )


def _arriving(
    layout: Layout, setting: Setting, detected: Mapping[UnitKey, BoolArray], seed: int
) -> dict[str, Party]:
    """Messages of each unit that reach the VUT, by its id.

    In all weathers the same frames of a run are lost.
    """
    draws, frame_draw = np.unique(draw_index(setting.runs), return_inverse=True)
    units = {}
    for unit in layout.units:
        random = build_rng(seed, unit_key(unit), "cpm").random(len(draws))
        arrives = (random >= setting.radio.packet_loss)[frame_draw]
        units[unit.id] = (
            detected[unit_key(unit)] & arrives,
            unit.latency(setting.rule),
        )
    return units
