"""Frames that are not told: messages lost, units out of order, cameras dirty or dazzled."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from geometry.arrays import BoolArray, FloatArray
from geometry.lidar import LidarModel
from geometry.weather import pick_weather

from ..candidates import CandidatePose
from ..detection_table import DetectionTable
from ..evaluator.surroundings import draw_index
from .uncertainty import Blinding
from .worlds import Sample, link_frames, mount_key, pose_key, unit_key


def silence(sample: Sample, table: DetectionTable) -> DetectionTable:
    """A table without the detections that do not reach the VUT, the same ones in all weathers.

    All is drawn for each run, and anew each time that a world is looked at, but for low sun, which
    is that of the VUT and shines by day alone. Poses that may be the same unit (see
    :func:`.unit_key`) are out of order and dirty together. LiDARs are never blinded.
    """
    drawn, loss = sample.uncertainty, sample.setting.radio.packet_loss
    if loss == 0.0 and not drawn.may_fail:
        return table
    from .drawing import lose_frames

    order = link_frames(draw_index(sample.setting.runs))
    n_frames = [len(run.time_s) for run in sample.setting.runs]
    is_silent = _silent_runs(sample) if drawn.may_fail else None
    mounts = pose_key if drawn.loss_shared_by == "unit" else mount_key
    packed = np.array(table.packed)
    for row in np.flatnonzero(packed.any(axis=1)).tolist():
        planned = sample.planned[row]
        if is_silent is not None:
            silent = is_silent(planned, sample.candidates[row])
            if silent.any():
                packed[row] &= np.packbits(~np.repeat(silent, n_frames), bitorder="little")
        if loss:
            lose_frames(
                *(order.run_of_frame, order.place_of_frame),
                *(sample.streams.key("message", *mounts(planned)), loss),
                *(sample.streams.key("burst", *mounts(planned)), 1.0 / drawn.burst_frames),
                packed[row],
            )
    return DetectionTable(pose_ids=table.pose_ids, axis=table.axis, packed=packed)


def blinded_frames(sample: Sample) -> BoolArray:
    """Frames in which the VUT's camera is dirty or dazzled, (n_frames,); none beside a LiDAR.

    Each run's VUT is another car.
    """
    runs, blinding = sample.setting.runs, sample.uncertainty.blinding
    n_frames = [len(run.time_s) for run in runs]
    if sample.setting.vut_sensors != ("camera",) or blinding == Blinding():
        return np.zeros(sum(n_frames), dtype=bool)
    is_low, sun = _low_sun(sample)
    yaw_rad = np.radians(np.concatenate([run.vut_yaw_deg for run in runs]))
    towards = np.repeat(sun, n_frames, axis=0)
    cosine = towards[:, 0] * np.cos(yaw_rad) + towards[:, 1] * np.sin(yaw_rad)
    dazzled = np.repeat(is_low, n_frames) & (
        cosine > np.cos(np.radians(blinding.dazzled_within_deg))
    )
    dirty = _coins(sample)("dirt of the VUT") < blinding.dirty_share
    blinded: BoolArray = dazzled | np.repeat(dirty, n_frames)
    return blinded


def _silent_runs(sample: Sample) -> Callable[[CandidatePose, CandidatePose], BoolArray]:
    """Runs in which a unit tells nothing, (n_runs,): of its pose as planned, and as mounted."""
    outages, blinding = sample.uncertainty.outages, sample.uncertainty.blinding
    coins = _coins(sample)
    is_low, sun = _low_sun(sample)
    least = np.cos(np.radians(blinding.dazzled_within_deg))

    @cache
    def is_pole_out(mount: tuple[object, ...]) -> BoolArray:
        return coins("pole", *mount) < outages.pole_share

    @cache
    def is_unit_out(unit: tuple[object, ...]) -> BoolArray:
        return coins("unit", *unit) < outages.unit_share

    @cache
    def is_dirty(unit: tuple[object, ...]) -> BoolArray:
        return coins("dirt", *unit) < blinding.dirty_share

    def is_silent(planned: CandidatePose, mounted: CandidatePose) -> BoolArray:
        unit = unit_key(planned)
        silent = is_unit_out(unit) | is_pole_out(mount_key(planned))
        if isinstance(planned.sensor, LidarModel):
            return silent
        yaw, pitch = np.radians([mounted.pose.yaw_deg, mounted.pose.pitch_deg])
        axis = [np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)]
        is_dazzled: BoolArray = is_low & (sun @ axis > least)
        return silent | is_dirty(unit) | is_dazzled

    return is_silent


def _low_sun(sample: Sample) -> tuple[BoolArray, FloatArray]:
    """Runs with low sun (n_runs,), and unit vectors towards it (n_runs, 3)."""
    blinding, runs = sample.uncertainty.blinding, sample.setting.runs
    coins = _coins(replace(sample, streams=replace(sample.streams, draw=0)))
    is_low = coins("low sun") < blinding.low_sun_share
    is_low &= [pick_weather(run.weather, "runs: weather").sun_lux > 0.0 for run in runs]
    yaw = 2.0 * np.pi * coins("yaw of the sun")
    height = np.radians(blinding.sun_below_deg) * coins("height of the sun")
    level = np.cos(height)
    return is_low, np.stack([level * np.cos(yaw), level * np.sin(yaw), np.sin(height)], axis=1)


def _coins(sample: Sample) -> Callable[..., FloatArray]:
    """Function of a thing: its numbers from 0 to 1 by run (n_runs,), the same in all weathers."""
    from .drawing import draw_coins

    runs = sample.setting.runs
    first = np.cumsum([0, *(len(run.time_s) for run in runs[:-1])])
    counter = link_frames(draw_index(runs)).run_of_frame[first]

    def draw(*thing: object) -> FloatArray:
        coins = np.empty(len(runs))
        draw_coins(counter, sample.streams.key(*thing), coins)
        return coins

    return draw
