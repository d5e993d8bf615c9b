"""Layouts by the decision to brake: avoided runs against false braking."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from geometry.arrays import BoolArray, FloatArray
from geometry.errors import InputError
from geometry.phrases import Phrase
from scenarios.decision import (
    CarWays,
    DecisionRule,
    build_car_ways,
    frames_in_time,
    largest_of_runs,
    load_decision_rule,
    located_sd_m,
    overlap_probability,
    track,
)
from scenarios.runs import Run, build_frame_axis
from scenarios.twins import MAIN_KINDS, build_twins

from .compute import DEFAULT_COMPUTE, Compute, threads
from .evaluation import Evaluation, apr
from .evaluator import received
from .evaluator.evaluate import VUT_KEY, build_rng, unit_key
from .layout import Layout
from .positions import (
    Feet,
    GroundErrors,
    aim_sd_deg,
    build_feet,
    unit_errors,
    vut_errors,
)
from .sampling.uncertainty import BY_EYE, CALIBRATED
from .setting import Setting

STAGE = Phrase("decisions")
AIMS = (CALIBRATED, BY_EYE)
RESERVES_S = (0.0, 0.1, 0.2, 0.3, 0.5, 0.8, 1.2, 1.6)
"""Reserves that are tried, beside the rule's own. [s]"""


# ---------- encounters without a collision
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TwinSetting:
    """The twins of a setting's runs.

    Attributes
    ----------
    setting : Setting
        Its runs are the twins: each has the weight of the run that it belongs to, as
        a share of all.
    is_main : (n_twins,) bool
        True for whoever stops or moves aside; False for whoever turns off.
    """

    setting: Setting
    is_main: BoolArray


def build_twin_setting(setting: Setting, rule: DecisionRule) -> TwinSetting:
    """Twins of a setting's runs.

    InputError where none of the runs has one.
    """
    twins = build_twins(setting.runs, rule)
    if not twins:
        raise InputError("decision: clearance_m", rule.clearance_m, "room for a twin")
    runs = tuple(twin.run for twin in twins)
    weight = setting.axis.weight[[twin.of_run for twin in twins]]
    axis = build_frame_axis(runs, weight / weight.sum())
    return TwinSetting(
        setting=replace(setting, runs=runs, axis=axis, seen_by_vut=None),
        is_main=np.array([twin.kind in MAIN_KINDS for twin in twins]),
    )


# ---------- what a layout decides
@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Decided:
    """What cars decide by the reports of one layout, in drawn worlds.

    Attributes
    ----------
    aim_sd_deg : (float, float)
        Errors of bearing and tilt. [deg]
    reserves_s : (n_reserves,) float
        Ascending. [s]
    in_time : (n_reserves, n_worlds, n_runs) float
        Largest probability of an overlap in a run's frames after which braking still
        avoids: with a threshold up to that, the run is avoided.
    in_twins : (n_reserves, n_worlds, n_twins) float
        The same in all frames of the twins: with a threshold up to that, the car
        brakes for nothing.
    located_sd_m : (n_runs,) float
        See :func:`scenarios.decision.located_sd_m`.
    weight, twin_weight : (n_runs,), (n_twins,) float
        Shares.
    is_main : (n_twins,) bool
        See :class:`TwinSetting`.
    """

    aim_sd_deg: tuple[float, float]
    reserves_s: tuple[float, ...]
    in_time: FloatArray
    in_twins: FloatArray
    located_sd_m: FloatArray
    weight: FloatArray
    twin_weight: FloatArray
    is_main: BoolArray

    def avoided(self, reserve_s: float, threshold: float) -> float:
        """Share of the runs that a rule avoids, in the mean of the worlds."""
        brakes = self.in_time[self._row(reserve_s)] >= threshold
        return float((brakes @ self.weight).mean())

    def braked_for(
        self, reserve_s: float, threshold: float, *, main: bool = True
    ) -> float:
        """Share of the twins that a rule brakes for: the main ones, or the others.

        NaN where there are none.
        """
        weight = self.twin_weight * (self.is_main == main)
        brakes = self.in_twins[self._row(reserve_s)] >= threshold
        return float((brakes @ weight).mean() / weight.sum())

    def best_rule(self, limit: float) -> tuple[float, float, float]:
        """Most that any rule avoids that brakes for so many of the main twins at most.

        Returns the share avoided, the reserve and the threshold.
        """
        best = (0.0, self.reserves_s[0], 1.0)
        n_worlds = self.in_twins.shape[1]
        main_weight = self.twin_weight * self.is_main
        weight = np.tile(main_weight / main_weight.sum(), n_worlds) / n_worlds
        for reserve_s, values in zip(self.reserves_s, self.in_twins, strict=True):
            order = np.argsort(values, axis=None)[::-1]
            n_braked = np.searchsorted(np.cumsum(weight[order]), limit, side="right")
            # Just above the first twin that is one too many.
            if n_braked == len(order):
                threshold = 0.0
            else:
                threshold = float(np.nextafter(values.ravel()[order[n_braked]], 1.1))
            share = self.avoided(reserve_s, max(threshold, np.finfo(float).tiny))
            if share > best[0]:
                best = (share, reserve_s, threshold)
        return best

    def located(self, limit_m: float) -> float:
        """Located APR: share of the runs with a place known so well."""
        return float(self.weight @ (self.located_sd_m <= limit_m))

    def _row(self, reserve_s: float) -> int:
        return self.reserves_s.index(reserve_s)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LayoutDecisions:
    """A layout by detection and by decision.

    Attributes
    ----------
    layout : Layout
        The layout.
    detected_apr : float
        Share of the runs in which it is detected in time: the first reading.
    twins_detected : float
        Share of the twins in which it is confirmed: so many would be braked for by a
        car that brakes for whoever is detected.
    by_aim : mapping of str to Decided
        By how the units are aimed.
    """

    layout: Layout
    detected_apr: float
    twins_detected: float
    by_aim: Mapping[str, Decided]


def judge_decisions(
    evaluations: Sequence[Evaluation],
    setting: Setting,
    rule: DecisionRule,
    *,
    aims: Mapping[str, tuple[float, float]] | None = None,
    compute: Compute = DEFAULT_COMPUTE,
) -> list[LayoutDecisions]:
    """Judge evaluated layouts by what a car decides, in runs and in their twins.

    `aims` are errors of bearing and tilt, in degrees, by their names; by default those
    of AIMS. Twins are looked at by the evaluator. With cars that see, the car's own
    track is one more unit. Raises InputError where a share of the cars sees, or an
    error is none.
    """
    if aims is None:
        aims = {aimed: aim_sd_deg(aimed) for aimed in AIMS}
    twins = build_twin_setting(setting, rule)
    layouts = [one.layout for one in evaluations]
    seen = [
        {name: verdict.detected for name, verdict in one.units.items()}
        for one in evaluations
    ]
    of_vut = [one.vut.detected for one in evaluations]
    looked = received(layouts, twins.setting, compute=compute)
    found = []
    for number, layout in enumerate(layouts):
        in_twins = looked[number]
        in_runs = Reports(setting, layout, seen[number], of_vut[number], rule)
        beside = Reports(
            twins.setting,
            layout,
            {name: detected for name, (detected, _) in in_twins.units.items()},
            in_twins.vut[0],
            rule,
        )
        compute.progress(STAGE, number, len(layouts))
        by_aim = {
            aimed: _decide(in_runs, beside, twins.is_main, aim_deg, compute=compute)
            for aimed, aim_deg in aims.items()
        }
        calibrated = next(iter(by_aim.values()))
        tiny = np.finfo(float).tiny
        found.append(
            LayoutDecisions(
                layout=layout,
                detected_apr=apr(evaluations[number].headline, setting.axis),
                twins_detected=calibrated.braked_for(calibrated.reserves_s[-1], tiny),
                by_aim=by_aim,
            )
        )
    return found


class Reports:
    """What the units of a layout report of a setting's runs.

    Parameters
    ----------
    setting : Setting
        Runs and rule.
    layout : Layout
        The units.
    detected : mapping of str to (n_frames,) bool
        By the unit's id.
    by_vut : (n_frames,) bool
        What the VUT detects by itself; it counts where cars see.
    rule : DecisionRule
        Errors, tracks and decision.
    """

    def __init__(
        self,
        setting: Setting,
        layout: Layout,
        detected: Mapping[str, BoolArray],
        by_vut: BoolArray,
        rule: DecisionRule,
    ) -> None:
        self.setting = setting
        self.layout = layout
        self.rule = rule
        rows = [detected[unit.id] for unit in layout.units]
        if setting.cars:
            rows.append(by_vut)
        self.detected = np.array(rows)
        latency_s = max(unit.latency(setting.rule) for unit in layout.units)
        self.aeb = replace(setting.rule, latency_s=latency_s)

    @cached_property
    def _feet(self) -> Feet:
        return build_feet(self.setting.runs)

    def errors(self, aim_deg: tuple[float, float]) -> list[GroundErrors]:
        """Errors of each party's reports, the VUT's last where cars see."""
        feet = self._feet
        errors = [
            unit_errors(
                unit, self.setting.detector, feet, rule=self.rule, aim_sd_deg=aim_deg
            )
            for unit in self.layout.units
        ]
        if self.setting.cars:
            errors.append(vut_errors(self.setting, feet, rule=self.rule))
        return errors

    def keys(self) -> list[object]:
        """What the chance of each party hangs on: its pose, not the layout."""
        keys: list[object] = [unit_key(unit) for unit in self.layout.units]
        if self.setting.cars:
            keys.append(VUT_KEY)
        return keys


def _decide(
    in_runs: Reports,
    in_twins: Reports,
    is_main: BoolArray,
    aim_deg: tuple[float, float],
    *,
    compute: Compute,
) -> Decided:
    """What cars decide in drawn worlds, with units aimed so."""
    rule = in_runs.rule
    reserves_s = tuple(sorted({*RESERVES_S, rule.reserve_s}))
    # Of a run only frames count after which braking still avoids.
    axis = in_runs.setting.axis
    in_time = frames_in_time(axis, latency_s=in_runs.aeb.latency_s)
    every = np.ones(in_twins.setting.axis.n_frames, dtype=bool)
    drawn_runs = DrawnReports(in_runs, aim_deg, reserves_s, stream="runs")
    drawn_twins = DrawnReports(in_twins, aim_deg, reserves_s, stream="twins")
    found = [
        drawn_runs.largest(in_time, compute=compute),
        drawn_twins.largest(every, compute=compute),
    ]
    return Decided(
        aim_sd_deg=aim_deg,
        reserves_s=reserves_s,
        in_time=found[0],
        in_twins=found[1],
        located_sd_m=drawn_runs.located_sd_m(),
        weight=in_runs.setting.axis.weight,
        twin_weight=in_twins.setting.axis.weight,
        is_main=is_main,
    )


class DrawnReports:
    """Reports of a layout with drawn errors, and what the car makes of them."""

    def __init__(
        self,
        reports: Reports,
        aim_deg: tuple[float, float],
        reserves_s: Sequence[float],
        *,
        stream: str,
    ) -> None:
        runs = reports.setting.runs
        self._reports = reports
        self._reserves_s = reserves_s
        # Names the chance of these runs, beside that of others.
        self._stream = stream
        self._errors = reports.errors(aim_deg)
        self._covariance = np.stack([one.covariance_m2() for one in self._errors])
        self._place_m = np.concatenate([run.vru_position_m for run in runs])
        self._heading_rad = np.radians(
            np.concatenate([run.vut_yaw_deg for run in runs])
        )
        self._ways: CarWays = build_car_ways(
            runs, aeb=reports.aeb, longest_reserve_s=reserves_s[-1]
        )

    def largest(self, counts: BoolArray, *, compute: Compute) -> FloatArray:
        """Largest probability of an overlap, (n_reserves, n_worlds, n_runs).

        Of each run in frames that count, (n_frames,).
        """
        reports = self._reports
        axis = reports.setting.axis
        rule = reports.rule
        with threads(compute.workers) as pool:
            drawn_m = pool.map(
                lambda world: self._drawn_m(world, compute.seed), range(rule.draws)
            )
            tracks = track(
                reports.detected,
                np.stack([*drawn_m]),
                self._covariance,
                axis,
                aeb=reports.aeb,
                rule=rule,
            )

            def of_world(world: int) -> FloatArray:
                found = overlap_probability(
                    tracks, axis, self._ways, self._reserves_s, rule=rule, world=world
                )
                return largest_of_runs(np.where(counts, found, 0.0), axis)

            return np.stack([*pool.map(of_world, range(rule.draws))], axis=1)

    def _drawn_m(self, world: int, seed: int) -> FloatArray:
        """Reported places in one world, (n_units, n_frames, 2), in m."""
        reports = self._reports
        axis = reports.setting.axis
        rule = reports.rule
        position_m = np.empty((*reports.detected.shape, 2))
        for row, (key, errors) in enumerate(
            zip(reports.keys(), self._errors, strict=True)
        ):
            # A unit's aim is the same in runs and twins.
            aims = build_rng(seed, key, "aim", world).standard_normal(2)
            rng = build_rng(seed, key, self._stream, world)
            position_m[row] = errors.draw_m(
                aims, rng, axis.run_start, correlation=rule.box_correlation
            )
        position_m += self._place_m
        # The car takes itself to be elsewhere: as if all else were moved the other way.
        position_m -= self._car_errors_m(build_rng(seed, "car", self._stream, world))
        return position_m

    def located_sd_m(self) -> FloatArray:
        """How well each run's place of impact is known, (n_runs,), in m."""
        reports = self._reports
        setting = reports.setting
        sd_m = located_sd_m(
            reports.detected[None],
            self._covariance[None],
            setting.axis,
            impact_heading_rad(setting.runs),
            aeb=reports.aeb,
            rule=reports.rule,
        )
        of_layout: FloatArray = sd_m[0]
        return of_layout

    def _car_errors_m(self, rng: np.random.Generator) -> FloatArray:
        """Error of the car's own place, (n_frames, 2) in m, one in each run."""
        axis = self._reports.setting.axis
        rule = self._reports.rule
        drawn = rng.standard_normal((axis.n_runs, 2))
        drawn *= [rule.car_along_sd_m, rule.car_across_sd_m]
        along, across = np.repeat(drawn, np.diff(axis.run_start), axis=0).T
        cos = np.cos(self._heading_rad)
        sin = np.sin(self._heading_rad)
        return np.column_stack([along * cos - across * sin, along * sin + across * cos])


def find_located_shares(
    evaluations: Sequence[Evaluation],
    setting: Setting,
    *,
    limit_m: float,
) -> tuple[tuple[float, ...], ...]:
    """Located APR of evaluated layouts, for each way of aiming: 0 .. 1.

    Rows are layouts, columns ``AIMS``. By the default rule; nothing is drawn, and no
    twin is driven. With cars that see, the car's own track is one more unit. A run
    counts if its place of impact is known to `limit_m`, in m.
    """
    rule = load_decision_rule()
    heading_rad = impact_heading_rad(setting.runs)
    found = []
    for one in evaluations:
        detected = {name: verdict.detected for name, verdict in one.units.items()}
        reports = Reports(setting, one.layout, detected, one.vut.detected, rule)
        covariances_m2 = [
            [each.covariance_m2() for each in reports.errors(aim_sd_deg(aimed))]
            for aimed in AIMS
        ]
        sd_m = located_sd_m(
            np.stack([reports.detected] * len(AIMS)),
            np.array(covariances_m2),
            setting.axis,
            heading_rad,
            aeb=reports.aeb,
            rule=rule,
        )
        shares = (sd_m <= limit_m) @ setting.axis.weight
        found.append(tuple(shares.tolist()))
    return tuple(found)


def impact_heading_rad(runs: Iterable[Run]) -> FloatArray:
    """Heading of each run's car at the impact, (n_runs,), in rad."""
    return np.radians([float(run.vut_yaw_deg[-1]) for run in runs])
