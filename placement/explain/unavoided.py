"""Why a run is not avoided: seen never or too late, what is in the way, and what would help."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from geometry.arrays import BoolArray, FloatArray, IntArray
from geometry.errors import InputError, Unquoted
from scenarios.aeb import confirmation_time_s, is_in_time
from scenarios.runs import Run

from ..candidates import CandidatePose
from ..detection_table import DetectionTable
from ..optimiser import PlacementProblem, run_margins_s
from ..optimiser.limits import fitting
from ..setting import Setting
from .hiding import Look, Reason, find_reasons, is_in_view

Outcome = Literal["hopeless", "never seen", "never confirmed", "too late"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Rescue:
    """A further unit that would save a run.

    Attributes
    ----------
    pose_index : int
        Row of the table.
    pose_id, site_id : str
        Its names.
    distance_m : float
        From the nearest unit that is chosen; 0 at the same mount. [m]
    margin_s : float
        Time to spare that it leaves. [s]
    """

    pose_index: int
    pose_id: str
    site_id: str
    distance_m: float
    margin_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Unavoided:
    """A run with weight that a set of poses does not avoid.

    Attributes
    ----------
    run_index : int
        Which run.
    run_id : str
        Its name.
    outcome : {"hopeless", "never seen", "never confirmed", "too late"}
        "hopeless": no frame comes early enough, whoever looks. Else what the chosen units achieve.
    late_s : float
        By how much braking sets in too late; infinite if it never does. [s]
    n_frames : int
        Frames from which braking in time could follow.
    n_seen : int
        Of these, those in which a chosen unit detects the road user.
    unit_id : str
        The chosen unit nearest to the road user in the last of these frames; of those, if there
        are any, that have it in view in one of them. Empty if hopeless.
    reasons : tuple of Reason
        Why that unit does not detect the road user in some of these frames, the most frequent one
        first.
    rescue : Rescue or None
        The nearest candidate that would save the run, as a further unit.
    """

    run_index: int
    run_id: str
    outcome: Outcome
    late_s: float
    n_frames: int
    n_seen: int
    unit_id: str
    reasons: tuple[Reason, ...]
    rescue: Rescue | None


def find_unavoided(
    setting: Setting,
    problem: PlacementProblem,
    candidates: Sequence[CandidatePose],
    pose_index: Sequence[int],
    *,
    seed: int = 0,
) -> tuple[Unavoided, ...]:
    """Runs that a set of poses does not avoid on the detection table, and why.

    Parameters
    ----------
    setting : Setting
        Scene, runs, planning detector.
    problem : PlacementProblem
        On a table of the setting's runs and of `candidates`.
    candidates : sequence of CandidatePose
        The rows of the table.
    pose_index : sequence of int
        What is mounted: at least one.
    seed : int
        Of the points on the VRUs: that of the table.

    Returns
    -------
    unavoided : tuple of Unavoided
        In the order of the runs; runs of weight 0, which no ratio knows, are not among them. A
        candidate that would save one is not forbidden, finds room at its site and is not too near
        to another unit; what it costs does not matter.

    Raises
    ------
    InputError
        The table has other runs, other candidates, or nothing is mounted.
    """
    axis, chosen = problem.table.axis, list(pose_index)
    if axis.run_ids != setting.axis.run_ids or axis.n_frames != setting.axis.n_frames:
        raise InputError("table", Unquoted(f"{axis.n_runs} other runs"), "the setting's runs")
    if tuple(candidate.id for candidate in candidates) != problem.table.pose_ids:
        raise InputError("candidates", Unquoted("others"), "the rows of the table")
    if not chosen:
        raise InputError("pose_index", chosen, "at least one pose")
    is_missed = run_margins_s(problem, chosen) == -np.inf
    missed = np.flatnonzero(is_missed & (axis.weight > 0.0))
    runs = [_Missed(setting, problem, candidates, chosen, run) for run in missed.tolist()]
    hopeful = [run for run in runs if run.outcome != "hopeless"]
    looks = [run.look() for run in hopeful]
    reasons = dict(
        zip((run.run for run in hopeful), find_reasons(setting, looks, seed=seed), strict=True)
    )
    helpers = _Helpers(problem, candidates, chosen)
    return tuple(
        Unavoided(
            run_index=run.run,
            run_id=axis.run_ids[run.run],
            outcome=run.outcome,
            late_s=run.late_s,
            n_frames=int(run.counts.sum()),
            n_seen=int((run.counts & run.seen).sum()),
            unit_id="" if run.outcome == "hopeless" else candidates[run.nearest].id,
            reasons=reasons.get(run.run, ()),
            rescue=None if run.outcome == "hopeless" else helpers.nearest(run.run),
        )
        for run in runs
    )


class _Missed:
    """One run that is not avoided."""

    def __init__(
        self,
        setting: Setting,
        problem: PlacementProblem,
        candidates: Sequence[CandidatePose],
        chosen: list[int],
        run: int,
    ) -> None:
        axis, rule = problem.table.axis, problem.rule
        self.run = run
        time_s = axis.time_s[axis.frames_of(run)]
        last_brake_s = axis.last_brake_time_s[run]
        self.counts = np.asarray(is_in_time(time_s, last_brake_s, latency_s=rule.latency_s))
        self.detected = _detected_in(problem.table, run)[chosen]
        self.seen = np.logical_or.reduce(self.detected, axis=0)
        together = self.seen if problem.fusion == "any" else self.detected
        confirmed_s = confirmation_time_s(together, time_s, n_confirmations=rule.n_confirmations)
        onset_s = float(np.min(confirmed_s)) + rule.latency_s
        self.late_s = onset_s - float(last_brake_s) if np.isfinite(last_brake_s) else np.inf
        self.outcome: Outcome = "too late"
        self.nearest = chosen[0]
        if int(self.counts.sum()) < rule.n_confirmations:
            self.outcome = "hopeless"
            return
        if not self.seen.any():
            self.outcome = "never seen"
        elif not np.isfinite(onset_s):
            self.outcome = "never confirmed"
        position = _who_should_see(
            setting.runs[run], [candidates[c] for c in chosen], np.flatnonzero(self.counts)
        )
        self.nearest = chosen[position]
        missed = self.counts & ~self.detected[position]
        self._look = Look(
            unit=candidates[self.nearest], run_index=run, frame_index=np.flatnonzero(missed)
        )

    def look(self) -> Look:
        """What the nearest unit should have seen."""
        return self._look


def _who_should_see(run: Run, units: Sequence[CandidatePose], frames: IntArray) -> int:
    """Of the units that have the VRU in view in some frames, that nearest to it in the last one.

    If none has, the nearest of all: another one may look elsewhere on purpose.
    """
    middle_m = np.column_stack(
        [
            run.vru_position_m[frames],
            np.full(len(frames), 0.5 * run.encounter.vru.height_m),
        ]
    )
    away_m = [np.hypot(*(unit.pose.position_m[:2] - middle_m[-1, :2])) for unit in units]
    looks_elsewhere = [not is_in_view(unit, middle_m).any() for unit in units]
    return int(np.lexsort((away_m, looks_elsewhere))[0])


class _Helpers:
    """Candidates that may join a set."""

    def __init__(
        self,
        problem: PlacementProblem,
        candidates: Sequence[CandidatePose],
        chosen: list[int],
    ) -> None:
        self.problem, self.candidates, self.chosen = problem, candidates, chosen
        unbound = replace(
            problem.limits,
            budget_units=None,
            budget_eur=None,
            is_forced=np.zeros_like(problem.limits.is_forced),
            is_forced_site=np.zeros_like(problem.limits.is_forced_site),
        )
        self.fits = np.flatnonzero(fitting(unbound, np.array(chosen, dtype=np.int64)))
        position_m: FloatArray = np.array([c.pose.position_m for c in candidates])
        between_m = np.linalg.norm(position_m[self.fits, None] - position_m[chosen][None], axis=2)
        self.distance_m: FloatArray = between_m.min(axis=1).round(6)

    def nearest(self, run: int) -> Rescue | None:
        """The nearest one that saves a run; of several at the same place the quickest."""
        problem = self.problem
        axis, rule = problem.table.axis, problem.rule
        detected = _detected_in(problem.table, run)
        seen = detected[self.fits]
        if problem.fusion == "any":
            seen = seen | detected[self.chosen].any(axis=0)
        confirmed_s = confirmation_time_s(
            seen, axis.time_s[axis.frames_of(run)], n_confirmations=rule.n_confirmations
        )
        last_brake_s = axis.last_brake_time_s[run]
        saves = np.isfinite(confirmed_s) & is_in_time(
            confirmed_s, last_brake_s, latency_s=rule.latency_s
        )
        if not saves.any():
            return None
        helping = np.flatnonzero(saves)
        best = helping[np.lexsort((confirmed_s[helping], self.distance_m[helping]))[0]]
        pose = int(self.fits[best])
        return Rescue(
            pose_index=pose,
            pose_id=self.candidates[pose].id,
            site_id=self.candidates[pose].site_id,
            distance_m=float(self.distance_m[best]),
            margin_s=float(last_brake_s - confirmed_s[best] - rule.latency_s),
        )


def _detected_in(table: DetectionTable, run: int) -> BoolArray:
    """V[c, f] of the frames of one run, (n_poses, n_frames of the run)."""
    frames = table.axis.frames_of(run)
    first_byte = frames.start // 8
    bits = np.unpackbits(
        table.packed[:, first_byte : -(-frames.stop // 8)], axis=1, bitorder="little"
    )
    skipped = frames.start - 8 * first_byte
    return bits[:, skipped : skipped + frames.stop - frames.start].astype(bool)
