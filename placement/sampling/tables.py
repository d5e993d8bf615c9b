"""Detection tables of sampled worlds.

They are laid end to end in one table for the optimiser.
"""

import hashlib
import logging
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, partial
from threading import Lock

import numpy as np
from numpy.typing import NDArray

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.lidar import LidarModel
from geometry.phrases import Phrase
from geometry.weather import pick_weather

from ..candidates import CandidatePose
from ..compute import DEFAULT_COMPUTE, Compute, Progress, one_blas_thread, silent
from ..detection_table import DetectionTable, repeated_axis
from ..detectors.response import ResponseDetector
from ..evaluator import with_sight
from ..evaluator.surroundings import draw_index
from ..setting import Setting
from ..visibility import (
    build_detection_table,
    load_table,
    save_table,
    table_fingerprint,
)
from ..visibility.build import N_POINTS, at_each_mount
from ..visibility.casting import SharedScene, World, build_shared_scene, build_world
from ..visibility.sensing import build_sensing, cast_for
from .driving import TrafficCount
from .uncertainty import Blinding, Uncertainty
from .worlds import (
    RandomStreams,
    Sample,
    draw_samples,
    link_frames,
    mount_key,
    pose_key,
    unit_key,
)


# ---------- misses
def build_drawn_tables(
    sample: Sample,
    detector: ResponseDetector,
    *,
    compute: Compute,
    lasting: SharedScene | None = None,
    n_draws: int = 1,
) -> tuple[DetectionTable, ...]:
    """Detection tables of a world in which chance decides every frame.

    Only detections of cameras are drawn. Random numbers of a pose do not depend on
    the other poses, but for those of the person, and are the same in all weathers;
    frames are linked as in the evaluator. Boxes are not drawn; a LiDAR counts the
    points that it may expect. `lasting` is what this world shares with others. A
    table for each of `n_draws`: what can be seen, and who is hard to see, is the
    same in all.
    """
    setting = sample.setting
    world = build_world(
        setting.scene,
        setting.runs,
        n_points=N_POINTS,
        seed=compute.seed,
        rays=compute.rays,
        shared=lasting,
    )
    # Frames that share random numbers, and how noise lasts.
    numbers = draw_index(setting.runs)
    order = link_frames(numbers)
    lasting_noise = detector.lasting
    correlation = detector.frame_correlation
    deviations = np.array([0.0, 1.0])
    person = np.zeros(len(numbers))
    if lasting_noise is not None:
        correlation = lasting_noise.frame_correlation(correlation)
        shares = (lasting_noise.unit_person_share, lasting_noise.frame_share)
        deviations = np.sqrt(shares)
        person = lasting_noise.person[numbers]
    n_bytes = -(-setting.axis.n_frames // 8)
    packed = np.zeros((n_draws, len(sample.candidates), n_bytes), dtype=np.uint8)

    def fill(rows: list[int]) -> None:
        """Draw the detections of poses at one mount position."""
        from .detection_kernels import draw_frames

        candidates = [sample.candidates[row] for row in rows]
        limits, entry_of_frame = _limits(world, candidates, detector)
        for row, limit in zip(rows, limits, strict=True):
            planned = sample.planned[row]
            if (limit == -np.inf).all():
                continue
            for draw in range(n_draws):
                streams = replace(sample.streams, draw=draw)
                key = pose_key(planned)
                draw_frames(
                    limit,
                    world.views.weather_of_frame,
                    entry_of_frame,
                    *order,
                    streams.key("detector", *key),
                    correlation,
                    person,
                    streams.key("unit and person", *key),
                    deviations,
                    packed[draw, row],
                )

    at_each_mount(sample.candidates, fill, stage=STAGE, compute=compute)
    pose_ids = tuple(candidate.id for candidate in sample.candidates)
    return tuple(
        DetectionTable(pose_ids=pose_ids, axis=setting.axis, packed=one)
        for one in packed
    )


def seen_by_vut(sample: Sample, compute: Compute) -> BoolArray | None:
    """Frames in which the VUT's sensors detect in a sampled world.

    They are (n_frames,); None where no car sees. By the evaluator's routine; drawn
    detections have random numbers of this world.
    """
    compute = replace(compute, progress=silent)
    if sample.drawn_detector is not None:
        compute = replace(compute, seed=int(sample.streams.key("vut") >> np.uint64(1)))
    seen = with_sight(sample.setting, compute=compute).seen_by_vut
    if seen is None:
        return None
    return seen & ~blinded_frames(sample)


def _limits(
    world: World, candidates: Sequence[CandidatePose], detector: ResponseDetector
) -> tuple[FloatArray, IntArray]:
    """Limits below which a standard normal number is a detection.

    All candidates are at one mount position. (n, n_weathers, n_entries), and the
    entry that each frame shows; -1 where nothing is seen.
    """
    from scipy.special import ndtri

    position_m = candidates[0].pose.position_m
    sight = cast_for(
        world, position_m, [(candidate, detector) for candidate in candidates]
    )
    sensing = build_sensing(world, sight, position_m, detector)
    limits = np.full((len(candidates), *sensing.contrast.shape), -np.inf)
    # LiDARs are not drawn: they detect or they do not.
    lidars = [i for i, c in enumerate(candidates) if isinstance(c.sensor, LidarModel)]
    limits[lidars] = np.where(
        sensing.detected([candidates[i] for i in lidars]), np.inf, -np.inf
    )
    # Probabilities of cameras become limits of a normal number.
    for rows, evidence in sensing.evidence(candidates):
        entries = evidence.draw_index
        for weather, contrast in enumerate(sensing.contrast):
            probability = detector.probability(
                replace(evidence, contrast=contrast[entries])
            )
            limits[rows, weather, entries] = ndtri(probability)
    return limits, sight.entry_of_frame


def drawing_key(streams: RandomStreams, detector: ResponseDetector) -> str:
    """Text that names how a table is drawn, but for the probabilities."""
    lasting = detector.lasting
    if lasting is None:
        shares = ""
    else:
        shares = f" {lasting.person_share} {lasting.unit_person_share}"
    where = f"{streams.seed} {streams.purpose} {streams.index}"
    return f"2 {where} {detector.frame_correlation!r}{shares}"


# ---------- detection tables of sampled worlds
STAGE = Phrase("sampled detection tables")
_log = logging.getLogger(__name__)
# Unpacked at a time.
_ROWS = 256


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SampledTable:
    """Detections in many sampled worlds: every run once in each.

    Attributes
    ----------
    table : DetectionTable
        Run ids end in "#1", "#2" and so on; weights are divided by the number
        of worlds; last brake times have lost what messages take longer than the
        rule says.
    sample_index : (n_runs,) int
        World of each run of `table`, from 0.
    n_samples : int
        Number of worlds.
    seen_by_vut : (n_frames,) bool, optional
        Of `table`, where cars see.
    """

    table: DetectionTable
    sample_index: IntArray
    n_samples: int
    seen_by_vut: BoolArray | None = None


def sampled_table(
    setting: Setting,
    candidates: Sequence[CandidatePose],
    uncertainty: Uncertainty,
    *,
    n_samples: int,
    first: int = 0,
    compute: Compute = DEFAULT_COMPUTE,
) -> SampledTable:
    """Detections of all candidates in many sampled worlds.

    Worlds are laid end to end, from number `first` on. Where mounts, the street or
    detections are drawn, every world takes nearly as long as the plan's own table.
    A packed table has n_poses x n_frames / 8 bytes per world, in memory and in the
    cache, which has single worlds. Progress counts the mount positions of all.
    """
    samples = draw_samples(
        setting,
        candidates,
        uncertainty,
        n_samples=n_samples,
        seed=compute.seed,
        first=first,
    )
    compute.progress(STAGE, 0, 0)
    n_frames = setting.axis.n_frames
    packed = np.zeros((len(candidates), -(-n_samples * n_frames // 8)), dtype=np.uint8)
    last_brake_s = []
    seen = []
    worlds = build_sample_tables(samples, n_samples=n_samples, compute=compute)
    driving = TrafficCount()
    n_as_planned = 0
    # Worlds are laid end to end along the columns.
    for index, (sample, table) in enumerate(worlds):
        driving += sample.driving
        n_as_planned += sample.n_as_planned
        _append(packed, table.packed, first_bit=index * n_frames, n_bits=n_frames)
        last_brake_s.append(table.axis.last_brake_time_s)
        seen.append(seen_by_vut(sample, compute))
    tell_traffic(driving, uncertainty)
    if n_as_planned:
        n_all = n_samples * setting.axis.n_runs
        _log.info(
            "%d of %d drawn runs would have no impact: as planned", n_as_planned, n_all
        )
    seen_in_all = None
    if setting.cars:
        seen_in_all = np.concatenate([each for each in seen if each is not None])
    # They sum to 1.
    return SampledTable(
        table=DetectionTable(
            pose_ids=tuple(candidate.id for candidate in candidates),
            axis=repeated_axis(
                setting.axis,
                [f"#{number}" for number in range(1, n_samples + 1)],
                weight=np.tile(setting.axis.weight / n_samples, n_samples),
                last_brake_time_s=np.concatenate(last_brake_s),
            ),
            packed=packed,
        ),
        sample_index=np.repeat(np.arange(n_samples), setting.axis.n_runs),
        n_samples=n_samples,
        seen_by_vut=seen_in_all,
    )


def tell_traffic(driving: TrafficCount, uncertainty: Uncertainty) -> None:
    """Say in the log what drove by, and as a warning what SUMO found no room for."""
    if uncertainty.moving is not None:
        if driving.n_waiting:
            level = logging.WARNING
        else:
            level = logging.INFO
        _log.log(level, "traffic (%s): %s", uncertainty.moving.name, driving)


def build_sample_tables(
    samples: Iterable[Sample],
    *,
    n_samples: int = 1,
    compute: Compute = DEFAULT_COMPUTE,
    at_once: int = 1,
    lasting: SharedScene | None = None,
    n_draws: int = 1,
) -> Iterator[tuple[Sample, DetectionTable]]:
    """Detection tables of sampled worlds, one after the other.

    They come from the cache, or are built anew. Detections that are not told are
    taken out, see :func:`.silence`. Worlds that look as planned share one build,
    all of them what scene and bodies hide. The next world is drawn and built while
    one is looked at; with few poses, several may be built `at_once`, by one thread
    each. `n_samples` is for the progress, `lasting` as of :func:`share_scene`. Each
    world comes `n_draws` times, with detections and lost messages drawn anew; only
    single draws are cached.
    """
    lock = Lock()
    if lasting is None:
        shared = []
    else:
        shared = [lasting]

    def share(sample: Sample) -> SharedScene | None:
        """Shared scene of still worlds, built when first asked for."""
        if not sample.uncertainty.road_users.are_as_planned:
            # They are looked at in other places, world by world.
            return None
        # Where all tables are in the cache, nobody asks.
        with lock:
            if not shared:
                is_still = sample.uncertainty.moving is None
                shared.append(
                    share_scene(sample.setting, is_still=is_still, compute=compute)
                )
        return shared[0]

    # Worlds that look as planned wait for one and the same build.
    as_planned: Future[tuple[DetectionTable, ...]] | None = None
    pending: deque[tuple[Sample, Future[tuple[DetectionTable, ...]]]] = deque()
    if at_once == 1:
        workers = compute.workers
    else:
        workers = 1
    # A pool that ends while another is at work must not give BLAS its threads back.
    with one_blas_thread(), ThreadPoolExecutor(at_once) as pool:
        for index, sample in enumerate(samples):
            progress = _progress_of(index, n_samples, compute.progress)
            part = replace(compute, progress=progress, workers=workers)
            if not sample.looks_as_planned:
                tables = pool.submit(_obtain, sample, part, share, n_draws)
            elif as_planned is None:
                tables = as_planned = pool.submit(_obtain, sample, part, share, n_draws)
            else:
                tables = as_planned
                progress(STAGE, 1, 1)
            pending.append((sample, tables))
            # One more waits.
            if len(pending) > at_once:
                yield from _received(*pending.popleft())
        while pending:
            yield from _received(*pending.popleft())


def share_scene(setting: Setting, *, is_still: bool, compute: Compute) -> SharedScene:
    """Scene that all sampled worlds have in common.

    In still worlds nothing drives that was not planned.
    """
    return build_shared_scene(
        setting.scene,
        setting.runs,
        n_points=N_POINTS,
        seed=compute.seed,
        rays=compute.rays,
        caches="all" if is_still else "still",
    )


def _received(
    sample: Sample, tables: "Future[tuple[DetectionTable, ...]]"
) -> Iterator[tuple[Sample, DetectionTable]]:
    """A world and its tables without what is lost; its deadlines are its own."""
    for draw, table in enumerate(tables.result()):
        one = replace(sample, streams=replace(sample.streams, draw=draw))
        yield one, silence(one, replace(table, axis=sample.setting.axis))


def _obtain(
    sample: Sample,
    compute: Compute,
    share: Callable[[Sample], SharedScene | None],
    n_draws: int,
) -> tuple[DetectionTable, ...]:
    """Tables of a world before messages are lost, from the cache or built anew."""
    detector = sample.drawn_detector
    if detector is not None and n_draws > 1:
        return build_drawn_tables(
            sample, detector, compute=compute, lasting=share(sample), n_draws=n_draws
        )
    world = sample.setting, sample.candidates
    table = obtain_table(
        *world, sample=sample, share=partial(share, sample), compute=compute
    )
    return (table,) * n_draws


def obtain_table(
    setting: Setting,
    candidates: Sequence[CandidatePose],
    *,
    sample: Sample | None = None,
    share: Callable[[], SharedScene | None] = lambda: None,
    compute: Compute,
) -> DetectionTable:
    """Detection table of a setting, from the cache or built anew.

    A sampled world gives itself, and `share` what it has in common with others.
    """
    if sample is None:
        drawn = None
    else:
        drawn = sample.drawn_detector
    # The file's name is the fingerprint of everything that the table depends on.
    path = None
    if compute.cache_folder is not None:
        fingerprint = table_fingerprint(
            setting.scene,
            candidates,
            setting.runs,
            setting.table_detector,
            seed=compute.seed,
        )
        if sample is not None and drawn is not None:
            text = f"{fingerprint} drawn {drawing_key(sample.streams, drawn)}"
            fingerprint = hashlib.blake2b(text.encode(), digest_size=16).hexdigest()
        path = compute.cache_folder / f"table-{fingerprint}.npz"
        cached = load_table(
            path, fingerprint=fingerprint, candidates=candidates, axis=setting.axis
        )
        if cached is not None:
            _log.info("detection table read from %s", path)
            if sample is None:
                compute.progress(Phrase("detection table (cached)"), 0, 0)
            else:
                compute.progress(STAGE, 1, 1)
            return cached
    if sample is None:
        compute.progress(Phrase("detection table"), 0, 0)
    if sample is not None and drawn is not None:
        (table,) = build_drawn_tables(sample, drawn, compute=compute, lasting=share())
    else:
        table = build_detection_table(
            setting.scene,
            candidates,
            setting.runs,
            setting.axis,
            detector=setting.table_detector,
            compute=compute,
            shared=share(),
        )
    if path is not None:
        save_table(path, table, fingerprint=fingerprint)
    return table


def _append(
    packed: NDArray[np.uint8], part: NDArray[np.uint8], *, first_bit: int, n_bits: int
) -> None:
    """Write a table's columns into a larger table, from a bit on.

    That bit need not begin a byte.
    """
    # The first bit may lie within a byte: shift the part.
    byte, shift = divmod(first_bit, 8)
    for row in range(0, len(part), _ROWS):
        rows = slice(row, row + _ROWS)
        bits = np.unpackbits(part[rows], axis=1, count=n_bits, bitorder="little")
        shifted = np.packbits(
            np.pad(bits, ((0, 0), (shift, 0))), axis=1, bitorder="little"
        )
        packed[rows, byte : byte + shifted.shape[1]] |= shifted


def _progress_of(index: int, n_samples: int, progress: Progress) -> Progress:
    """Progress of one world, as part of that of all."""
    return lambda stage, done, total: progress(
        STAGE, index * total + done, n_samples * total
    )


# ---------- frames that are not reported: lost messages, outages, blinded cameras
def silence(sample: Sample, table: DetectionTable) -> DetectionTable:
    """Table without the detections that do not reach the VUT.

    They are the same ones in all weathers. All is drawn for each run, and anew each
    time that a world is looked at, but for low sun, which is that of the VUT and
    shines by day alone. Poses that may be the same unit (see :func:`.unit_key`) are
    out of order and dirty together. LiDARs are never blinded.
    """
    drawn = sample.uncertainty
    loss = sample.setting.radio.packet_loss
    if loss == 0.0 and not drawn.may_fail:
        return table
    from .detection_kernels import lose_frames

    # Numbers are the same in all weathers.
    order = link_frames(draw_index(sample.setting.runs))
    n_frames = [len(run.time_s) for run in sample.setting.runs]
    if drawn.may_fail:
        is_silent = _silent_runs(sample)
    else:
        is_silent = None
    if drawn.loss_shared_by == "unit":
        mounts = pose_key
    else:
        mounts = mount_key
    packed = np.array(table.packed)
    # Only poses that detect anything can lose something.
    for row in np.flatnonzero(packed.any(axis=1)).tolist():
        planned = sample.planned[row]
        if is_silent is not None:
            silent = is_silent(planned, sample.candidates[row])
            if silent.any():
                packed[row] &= np.packbits(
                    ~np.repeat(silent, n_frames), bitorder="little"
                )
        if loss:
            lose_frames(
                *order,
                sample.streams.key("message", *mounts(planned)),
                loss,
                sample.streams.key("burst", *mounts(planned)),
                1.0 / drawn.burst_frames,
                packed[row],
            )
    return DetectionTable(pose_ids=table.pose_ids, axis=table.axis, packed=packed)


def blinded_frames(sample: Sample) -> BoolArray:
    """Frames in which the VUT's camera is dirty or dazzled.

    They are (n_frames,); there are none where the VUT has a LiDAR. Each run's VUT
    is another car.
    """
    runs = sample.setting.runs
    blinding = sample.uncertainty.blinding
    n_frames = [len(run.time_s) for run in runs]
    if sample.setting.vut_sensors != ("camera",) or blinding == Blinding():
        return np.zeros(sum(n_frames), dtype=bool)
    is_low, sun = _low_sun(sample)
    yaw_rad = np.radians(np.concatenate([run.vut_yaw_deg for run in runs]))
    towards = np.repeat(sun, n_frames, axis=0)
    # Cosine of the angle between the VUT's heading and the sun.
    cosine = towards[:, 0] * np.cos(yaw_rad) + towards[:, 1] * np.sin(yaw_rad)
    dazzled = np.repeat(is_low, n_frames) & (
        cosine > np.cos(np.radians(blinding.dazzled_within_deg))
    )
    dirty = _coins(sample)("dirt of the VUT") < blinding.dirty_share
    return np.asarray(dazzled | np.repeat(dirty, n_frames))


def _silent_runs(sample: Sample) -> Callable[[CandidatePose, CandidatePose], BoolArray]:
    """Function that finds the runs in which a unit reports nothing.

    It takes the unit's pose as planned and as mounted, and returns (n_runs,) bool.
    """
    outages = sample.uncertainty.outages
    blinding = sample.uncertainty.blinding
    coins = _coins(sample)
    is_low, sun = _low_sun(sample)
    least = np.cos(np.radians(blinding.dazzled_within_deg))

    def is_silent(planned: CandidatePose, mounted: CandidatePose) -> BoolArray:
        """True for runs in which the unit reports nothing, (n_runs,)."""
        unit = unit_key(planned)
        pole = mount_key(planned)
        silent = coins("unit", *unit) < outages.unit_share
        silent |= coins("pole", *pole) < outages.pole_share
        if isinstance(planned.sensor, LidarModel):
            return silent
        # Optical axis of the unit as it is mounted.
        yaw, pitch = np.radians([mounted.pose.yaw_deg, mounted.pose.pitch_deg])
        axis = [np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)]
        is_dazzled: BoolArray = is_low & (sun @ axis > least)
        return silent | (coins("dirt", *unit) < blinding.dirty_share) | is_dazzled

    return is_silent


def _low_sun(sample: Sample) -> tuple[BoolArray, FloatArray]:
    """Runs with low sun (n_runs,), and unit vectors towards it (n_runs, 3)."""
    blinding = sample.uncertainty.blinding
    runs = sample.setting.runs
    coins = _coins(replace(sample, streams=replace(sample.streams, draw=0)))
    is_low = coins("low sun") < blinding.low_sun_share
    is_low &= [pick_weather(run.weather, "runs: weather").sun_lux > 0.0 for run in runs]
    # Direction of the sun: any yaw, up to a height.
    yaw = 2.0 * np.pi * coins("yaw of the sun")
    height = np.radians(blinding.sun_below_deg) * coins("height of the sun")
    level = np.cos(height)
    return is_low, np.stack(
        [level * np.cos(yaw), level * np.sin(yaw), np.sin(height)], axis=1
    )


def _coins(sample: Sample) -> Callable[..., FloatArray]:
    """Function of a thing that draws its numbers from 0 to 1 by run.

    They are (n_runs,), the same in all weathers.
    """
    from .detection_kernels import draw_coins

    runs = sample.setting.runs
    first = np.cumsum([0, *(len(run.time_s) for run in runs[:-1])])
    counter = link_frames(draw_index(runs)).run_of_frame[first]

    # Poses that may be the same unit share them.
    @cache
    def draw(*thing: object) -> FloatArray:
        coins = np.empty(len(runs))
        draw_coins(counter, sample.streams.key(*thing), coins)
        return coins

    return draw
