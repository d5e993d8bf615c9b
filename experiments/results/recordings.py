"""The result of judging a recording's units, or of choosing the best of them."""

from collections.abc import Callable, Sequence
from typing import TypeVar

import numpy as np
from msgspec import UNSET, UnsetType
from msgspec.structs import asdict as fields_of

from placement.evaluation import Verdict, apr, apr_by_case, detected_share
from placement.optimiser import Fusion, Limits, PlacementProblem, apr_one_failed
from placement.recordings import (
    RecordedEvaluation,
    Recording,
    is_longitudinal,
    recorded_table,
)
from scenarios.aeb import AebRule

from .drives import RefusalRecord, versions
from .evaluations import PartyAprRecord
from .numbers import finite_or_none
from .record import Record, StageRecord

_T = TypeVar("_T")


class RecordedUnitRecord(Record, frozen=True, kw_only=True):
    """A recorded unit; a recording does not tell where it hangs."""

    id: str
    folder: str


class RecordedAprRecord(Record, frozen=True, kw_only=True):
    """APR of each party; None where the recording has no vehicle's own detections."""

    vut: PartyAprRecord | None
    rsu_all: PartyAprRecord
    vut_and_rsus: PartyAprRecord | None
    units: dict[str, PartyAprRecord]
    apr_without_worst_unit: float


class RecordedGreedyRecord(Record, frozen=True, kw_only=True):
    """Units chosen one by one."""

    layout: tuple[RecordedUnitRecord, ...]
    vut: PartyAprRecord | None
    rsu_all: PartyAprRecord
    vut_and_rsus: PartyAprRecord | None
    units: dict[str, PartyAprRecord]
    apr_without_worst_unit: float


class DetectedShareRecord(Record, frozen=True, kw_only=True):
    """Share of the frames in which each party detects the road user."""

    vut: float | None
    rsu_all: float
    vut_and_rsus: float | None
    units: dict[str, float]


class RecordedDriveRecord(Record, frozen=True, kw_only=True):
    """A drive of the recording, and whether all units together avoid its accident."""

    run: str
    case: str
    first_frame: int
    frames: int
    missing_frames: int
    vut_speed_kmh: float
    vru_speed_kmh: float
    closing_speed_mps: float
    motion: str
    last_brake_time_s: float
    is_avoided: bool


class RecordedFramesRecord(Record, frozen=True, kw_only=True):
    """Numbers of frames."""

    recorded: int
    in_drives: int
    missing_in_drives: int
    several_vrus_in_view: int


class RecordedResult(Record, frozen=True, kw_only=True):
    """What ``--recording`` finds: ``summary.json``, and what ``--json`` prints.

    The fields of a result that a recording has; those after "versions" where units were chosen.
    There is no surrogate that could disagree.
    """

    name: str
    recording: str
    layout: tuple[RecordedUnitRecord, ...]
    budget: int | None
    fusion: str
    runs: int
    cases: tuple[str, ...]
    weathers: tuple[str, ...]
    track_memory_s: float | None = None
    not_driven: tuple[RefusalRecord, ...] = ()
    apr: float
    bound: float | None
    gap: float | None
    apr_without_worst_unit: float
    evaluation: RecordedAprRecord
    detected_share: DetectedShareRecord
    drives: tuple[RecordedDriveRecord, ...]
    frames: RecordedFramesRecord
    skipped: dict[str, int]
    baseline: RecordedAprRecord | None
    surrogate_disagreement: None = None
    seconds: dict[str, float]
    versions: dict[str, str]
    candidates: int | UnsetType = UNSET
    stages: tuple[StageRecord, ...] | UnsetType = UNSET
    solver: str | UnsetType = UNSET
    baseline_name: str | UnsetType = UNSET
    greedy: RecordedGreedyRecord | UnsetType = UNSET


def build_recorded_result(
    recording: Recording, evaluation: RecordedEvaluation, rule: AebRule
) -> RecordedResult:
    """The units of a recording, or some of them; "seconds" is empty."""
    axis = evaluation.axis
    evaluated = build_recorded_apr_record(evaluation, rule)
    return RecordedResult(
        name=recording.folder.name,
        recording=str(recording.folder),
        layout=build_recorded_units(list(evaluation.units)),
        budget=None,
        fusion="any",
        runs=axis.n_runs,
        cases=tuple(dict.fromkeys(axis.cases)),
        weathers=tuple(dict.fromkeys(axis.weathers)),
        track_memory_s=finite_or_none(rule.track_memory_s),
        apr=evaluated.rsu_all.all,  # type: ignore[arg-type]
        bound=None,
        gap=None,
        apr_without_worst_unit=evaluated.apr_without_worst_unit,
        evaluation=evaluated,
        detected_share=_detected_share(evaluation),
        drives=_drives(recording, evaluation),
        frames=RecordedFramesRecord(
            recorded=recording.n_frames,
            in_drives=axis.n_frames,
            missing_in_drives=recording.n_missing,
            several_vrus_in_view=evaluation.n_ambiguous,
        ),
        skipped=dict(recording.skipped),
        baseline=None,
        seconds={},
        versions=versions(),
    )


def build_recorded_units(folder_names: Sequence[str]) -> tuple[RecordedUnitRecord, ...]:
    """Units by the names of their folders."""
    return tuple(RecordedUnitRecord(id=rsu_name(name), folder=name) for name in folder_names)


def build_recorded_apr_record(evaluation: RecordedEvaluation, rule: AebRule) -> RecordedAprRecord:
    """APR of every party, over all drives and by case."""
    axis, n_units = evaluation.axis, len(evaluation.units)

    def ratios(verdict: Verdict) -> PartyAprRecord:
        return PartyAprRecord(all=apr(verdict, axis), by_case={**apr_by_case(verdict, axis)})

    return RecordedAprRecord(
        vut=_known(ratios, evaluation.vut),
        rsu_all=ratios(evaluation.rsu_all),
        vut_and_rsus=_known(ratios, evaluation.vut_and_rsus),
        units={rsu_name(name): ratios(unit) for name, unit in evaluation.units.items()},
        apr_without_worst_unit=apr_one_failed(
            recorded_problem(evaluation, budget_units=n_units, fusion="any", rule=rule),
            range(n_units),
        ),
    )


def build_recorded_greedy_record(
    folder_names: Sequence[str], evaluation: RecordedEvaluation, rule: AebRule
) -> RecordedGreedyRecord:
    """Units chosen one by one, and what they are worth."""
    return RecordedGreedyRecord(
        layout=build_recorded_units(folder_names),
        **fields_of(build_recorded_apr_record(evaluation, rule)),
    )


def recorded_problem(
    evaluation: RecordedEvaluation, *, budget_units: int, fusion: Fusion, rule: AebRule
) -> PlacementProblem:
    """The choice among recorded units: each alone on a site of its own."""
    n_units = len(evaluation.units)
    return PlacementProblem(
        table=recorded_table(evaluation),
        limits=Limits(
            site_index=np.arange(n_units),
            site_capacity=np.ones(n_units, dtype=np.int64),
            budget_units=budget_units,
        ),
        fusion=fusion,
        rule=rule,
    )


def rsu_name(folder_name: str) -> str:
    """What a roadside unit is called, by the name of its folder."""
    return f"RSU{folder_name}"


def _known(measure: Callable[[Verdict], _T], verdict: Verdict | None) -> _T | None:
    return None if verdict is None else measure(verdict)


def _detected_share(evaluation: RecordedEvaluation) -> DetectedShareRecord:
    def share(verdict: Verdict) -> float:
        return detected_share(verdict, evaluation.axis)

    return DetectedShareRecord(
        vut=_known(share, evaluation.vut),
        rsu_all=share(evaluation.rsu_all),
        vut_and_rsus=_known(share, evaluation.vut_and_rsus),
        units={rsu_name(name): share(unit) for name, unit in evaluation.units.items()},
    )


def _drives(
    recording: Recording, evaluation: RecordedEvaluation
) -> tuple[RecordedDriveRecord, ...]:
    axis = evaluation.axis
    return tuple(
        RecordedDriveRecord(
            run=axis.run_ids[index],
            case=axis.cases[index],
            first_frame=drive.first_number,
            frames=drive.n_frames,
            missing_frames=drive.n_missing,
            vut_speed_kmh=float(axis.vut_speed_kmh[index]),
            vru_speed_kmh=3.6 * drive.vru_speed_mps,
            closing_speed_mps=drive.closing_speed_mps,
            motion="same direction" if is_longitudinal(drive) else "crossing",
            last_brake_time_s=float(axis.last_brake_time_s[index]),
            is_avoided=bool(evaluation.rsu_all.is_avoided[index]),
        )
        for index, drive in enumerate(recording.drives)
    )
