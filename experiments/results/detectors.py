"""The result of a fitted detector: its response table, recall by group, false alarms."""

from collections.abc import Mapping
from typing import Annotated

from placement.detectors.evidence import Interval
from placement.detectors.fitting import Group, ResponseFit
from placement.detectors.sightings import FalseAlarms

from .record import Record, Share, says


class IntervalRecord(Record, frozen=True, kw_only=True):
    """A figure with its 95 % interval."""

    value: float
    low: float
    high: float


class RecallRecord(Record, frozen=True, kw_only=True):
    """Frames that have something in common."""

    name: Annotated[str, says("What they have in common.")]
    frames: Annotated[int, says("Frames with a road user.", ge=0)]
    found: Annotated[int, says("Of these, those in which it was found.", ge=0)]
    recall: IntervalRecord
    expected: Annotated[Share, says("Mean probability of the fitted table.")]


class FalseAlarmsRecord(Record, frozen=True, kw_only=True):
    """Boxes on nothing, and tracks of them."""

    pictures: Annotated[int, says("Pictures that were looked at.", ge=0)]
    alarms: Annotated[int, says("Boxes in them that overlap no road user.", ge=0)]
    per_picture: IntervalRecord
    chances: Annotated[
        int, says("Pictures with enough consecutive ones before them to confirm a track.", ge=0)
    ]
    confirmed: Annotated[int, says("False tracks that were confirmed.", ge=0)]
    per_hour: Annotated[
        IntervalRecord | None,
        says("False tracks per hour and unit; null: no consecutive frames were looked at."),
    ]


class DetectorFitResult(Record, frozen=True, kw_only=True):
    """What ``place-rsus detector fit`` finds: ``fit.json``, and what ``--json`` prints."""

    name: Annotated[str, says("Of the table.")]
    source: Annotated[str, says("What was looked at, in words.")]
    frames: Annotated[int, says("Frames with a road user.", ge=0)]
    found: Annotated[int, says("Of these, those in which it was found.", ge=0)]
    tracks: Annotated[int, says("Cameras and runs that the frames are of.", ge=0)]
    unknown: Annotated[
        tuple[str, ...], says("What the source does not tell, and is as in the built-in table.")
    ]
    table: dict[str, IntervalRecord]
    groups: dict[str, tuple[RecallRecord, ...]]
    calibration: tuple[RecallRecord, ...]
    false_alarms: FalseAlarmsRecord
    command: str
    seconds: dict[str, float]
    versions: dict[str, str]


def build_interval_record(interval: Interval) -> IntervalRecord:
    """An interval as a record."""
    return IntervalRecord(value=interval.value, low=interval.low, high=interval.high)


def build_fit_records(
    fit: ResponseFit,
) -> tuple[
    dict[str, IntervalRecord], dict[str, tuple[RecallRecord, ...]], tuple[RecallRecord, ...]
]:
    """Figures of the table, recall by group, and calibration."""
    groups: Mapping[str, tuple[Group, ...]] = fit.groups
    return (
        {key: build_interval_record(interval) for key, interval in fit.intervals.items()},
        {kind: _recalls(entries) for kind, entries in groups.items()},
        _recalls(fit.calibration),
    )


def _recalls(groups: tuple[Group, ...]) -> tuple[RecallRecord, ...]:
    return tuple(
        RecallRecord(
            name=group.name,
            frames=group.frames,
            found=group.found,
            recall=build_interval_record(group.recall),
            expected=group.expected,
        )
        for group in groups
    )


def build_alarms_record(alarms: FalseAlarms, frame_rate_hz: float) -> FalseAlarmsRecord:
    """False alarms with their rates."""
    per_hour = alarms.per_hour(frame_rate_hz)
    return FalseAlarmsRecord(
        pictures=alarms.pictures,
        alarms=alarms.alarms,
        per_picture=build_interval_record(alarms.per_picture),
        chances=alarms.chances,
        confirmed=alarms.confirmed,
        per_hour=None if per_hour is None else build_interval_record(per_hour),
    )
