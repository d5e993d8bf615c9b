"""What the optimiser has to find on small problems: every layout, valued in plain
loops.

This is the specification: nothing of ``placement.optimiser`` is imported, and a problem
is read as plain data. Tolerances are the optimiser's promise, written down once more.
"""

from collections.abc import Iterator
from itertools import combinations
from math import inf
from typing import Any

TIE = 1.0e-9  # shares and times that differ by no more are equal
TIE_EUR = 1.0e-6
TIE_TIME_S = 1.0e-9  # an instant so much later is still in time
ROUNDING = 1.0e-4  # of a tie: what sums in another order differ by
FAR = 8.0  # ties: what is so far apart is no tie, nor a tie of a tie

Values = dict[str, float]


class Oracle:
    """All layouts of a problem within limits and floors, and what each is worth, by
    stage.
    """

    def __init__(self, problem: Any) -> None:
        self.problem = problem
        axis = problem.table.axis
        self.n_poses, self.n_runs = problem.table.n_poses, axis.n_runs
        self.weight: list[float] = axis.weight.tolist()
        self.least_weight = min(weight for weight in self.weight if weight > 0.0)
        self.detected = problem.table.detected(list(range(self.n_poses))).tolist()
        vut = problem.seen_by_vut
        self.detected.append([False] * axis.n_frames if vut is None else vut.tolist())
        self.time_s: list[float] = axis.time_s.tolist()
        self.last_brake_s: list[float] = axis.last_brake_time_s.tolist()
        self.run_start: list[int] = axis.run_start.tolist()
        self.site: list[int] = problem.limits.site_index.tolist()
        samples = problem.sample_index
        if samples is None:
            self.sample = [0] * self.n_runs
        else:
            self.sample = samples.tolist()
        self._margins: dict[tuple[int, tuple[int, ...]], float] = {}
        self._of_units: dict[tuple[int, ...], list[float]] = {}
        self._sees = [
            [self._frames_seen(pose, run) for run in range(self.n_runs)]
            for pose in range(self.n_poses + 1)  # the VUT comes last
        ]
        self.names = self._stages()
        self.layouts = {poses: self.values(poses) for poses in self._feasible()}

    def _stages(self) -> list[str]:
        goal = {"best": [], "fewest": ["units"], "cheapest": ["cost_eur"]}[
            self.problem.goal
        ]
        if self.problem.survive:
            survived = ["apr_survived"]
        else:
            survived = []
        usual = [
            "apr",
            "apr_one_failed",
            "smallest_margin_s",
            "mean_margin_s",
            "cost_eur",
        ]
        return [*goal, *survived, *(name for name in usual if name not in goal)]

    # ---------- one run

    def _frames_seen(self, pose: int, run: int) -> tuple[int, ...]:
        frames = range(self.run_start[run], self.run_start[run + 1])
        return tuple(frame for frame in frames if self.detected[pose][frame])

    def _margin_s(self, run: int, seen: tuple[int, ...]) -> float:
        """Time left when a confirmed track is alive at the last moment; minus infinity
        if none is.

        `seen` are the frames that detect, ascending.
        """
        rule = self.problem.rule
        last_moment_s = self.last_brake_s[run] - rule.latency_s
        known = [
            frame for frame in seen if self.time_s[frame] <= last_moment_s + TIE_TIME_S
        ]
        margin_s = -inf
        next_s = last_moment_s

        for place in range(len(known) - 1, -1, -1):
            if next_s - self.time_s[known[place]] > rule.track_memory_s + TIE_TIME_S:
                break  # the track is lost behind this frame, whatever came before
            next_s = self.time_s[known[place]]
            first = place - (rule.n_confirmations - 1)
            if first >= 0 and known[place] - known[first] == rule.n_confirmations - 1:
                margin_s = last_moment_s - next_s

        return margin_s

    def margins_s(self, poses: tuple[int, ...]) -> list[float]:
        """Margins of all runs."""
        if poses not in self._of_units:
            parties = (*poses, self.n_poses)
            if self.problem.fusion == "any":
                together = [parties]
            else:
                together = [(one,) for one in parties]
            margins = [-inf] * self.n_runs
            for run in range(self.n_runs):
                for units in together:
                    seen = tuple(
                        sorted({frame for p in units for frame in self._sees[p][run]})
                    )
                    if (run, seen) not in self._margins:
                        self._margins[run, seen] = self._margin_s(run, seen)
                    margins[run] = max(margins[run], self._margins[run, seen])
            self._of_units[poses] = margins
        return self._of_units[poses]

    # ---------- shares

    def _apr(self, poses: tuple[int, ...]) -> float:
        """Mean over the worst worlds up to the tail; of all where the tail is 1."""
        margins = self.margins_s(poses)
        n_samples = max(self.sample) + 1
        avoided = [0.0] * n_samples
        total = [0.0] * n_samples
        for run in range(self.n_runs):
            total[self.sample[run]] += self.weight[run]
            if margins[run] > -inf:
                avoided[self.sample[run]] += self.weight[run]

        all_worlds = sum(total)
        if self.problem.tail == 1.0:
            return sum(avoided) / all_worlds
        result = 0.0
        left = self.problem.tail

        for ratio, share in sorted(
            (a / t, t / all_worlds) for a, t in zip(avoided, total, strict=True)
        ):
            counted = min(share, left)
            result += counted * ratio
            left -= counted

        return result / self.problem.tail

    def _share_of(self, poses: tuple[int, ...], is_counted: list[bool]) -> float:
        margins = self.margins_s(poses)
        total = sum(self.weight[run] for run in range(self.n_runs) if is_counted[run])
        reached = sum(
            self.weight[run]
            for run in range(self.n_runs)
            if is_counted[run] and margins[run] > -inf
        )
        return reached / total

    def _after_failures(
        self, poses: tuple[int, ...], n_failures: int, share: Any
    ) -> float:
        """The least that is left when any so many units, or sites with all they carry,
        fail.
        """
        by_unit = self.problem.limits.failing == "unit"
        parts = sorted({pose if by_unit else self.site[pose] for pose in poses})
        least = inf

        for failed in combinations(parts, min(n_failures, len(parts))):
            left = tuple(
                p for p in poses if (p if by_unit else self.site[p]) not in failed
            )
            least = min(least, share(left))

        return least

    # ---------- layouts

    def cost_eur(self, poses: tuple[int, ...]) -> float:
        """Price of units, and of each of their sites once."""
        limits = self.problem.limits
        units = sum(float(limits.unit_cost_eur[pose]) for pose in poses)
        return units + sum(
            float(limits.site_cost_eur[s]) for s in {self.site[p] for p in poses}
        )

    def values(self, poses: tuple[int, ...]) -> Values:
        """What a layout is worth in every stage."""
        margins = self.margins_s(poses)
        counts = [
            r for r in range(self.n_runs) if margins[r] > -inf and self.weight[r] > 0.0
        ]
        avoided = sum(self.weight[run] for run in counts)
        mean_margin_s = 0.0
        if counts:
            weighted = sum(self.weight[run] * margins[run] for run in counts)
            mean_margin_s = weighted / avoided
        values = {
            "units": float(len(poses)),
            "cost_eur": self.cost_eur(poses),
            "apr": self._apr(poses),
            "apr_one_failed": self._after_failures(poses, 1, self._apr),
            "smallest_margin_s": min((margins[run] for run in counts), default=0.0),
            "mean_margin_s": mean_margin_s,
        }
        if self.problem.survive:
            values["apr_survived"] = self._after_failures(
                poses, self.problem.survive, self._apr
            )
        return {name: values[name] for name in self.names}

    def _feasible(self) -> Iterator[tuple[int, ...]]:
        most = self.problem.limits.budget_units
        for n_units in range(1, (self.n_poses if most is None else most) + 1):
            for poses in combinations(range(self.n_poses), n_units):
                if self._is_allowed(poses) and self._reaches_floors(poses):
                    yield poses

    def _is_allowed(self, poses: tuple[int, ...]) -> bool:
        limits = self.problem.limits
        sites = [self.site[pose] for pose in poses]
        if any(sites.count(site) > limits.site_capacity[site] for site in set(sites)):
            return False
        if (
            limits.budget_eur is not None
            and self.cost_eur(poses) > limits.budget_eur + TIE_EUR
        ):
            return False

        for pose in range(self.n_poses):
            if (limits.is_forced[pose] and pose not in poses) or (
                limits.is_forbidden[pose] and pose in poses
            ):
                return False

        for site in range(len(limits.site_capacity)):
            if limits.is_forced_site[site] and site not in sites:
                return False
        return not any(a in sites and b in sites for a, b in limits.rivals.tolist())

    def is_clearly_met(self) -> bool:
        """Does a layout reach all floors, be sums rounded as they may?"""
        tie = (1.0 - ROUNDING) * TIE
        return any(self._reaches_floors(poses, tie=tie) for poses in self.layouts)

    def _reaches_floors(self, poses: tuple[int, ...], *, tie: float = TIE) -> bool:
        for floor in self.problem.floors:

            def share(left: tuple[int, ...], counted: Any = floor.is_counted) -> float:
                if counted is None:
                    return self._apr(left)
                return self._share_of(left, counted)

            least = floor.share - tie
            if self._after_failures(poses, floor.n_failures, share) < least:
                return False

        return True

    # ---------- an answer

    def check(
        self, poses: tuple[int, ...], stages: Any, *, largest_gap: float = inf
    ) -> None:
        """Check a layout and its stages; 0 as the `largest_gap`: all must be proven
        best.

        A bound is what no layout exceeds that is as good in all stages before; a gap of
        0 says that the value is the best there is.
        """
        assert poses in self.layouts, f"{poses} breaks a limit or a floor"
        assert [stage.name for stage in stages] == self.names

        rivals = self.layouts

        for stage in stages:
            name, value = stage.name, self.layouts[poses][stage.name]
            sign, tie = _sense(name)
            best = sign * max(sign * values[name] for values in rivals.values())
            where = f"{name}: value {value!r}, best {best!r}, told {stage!r}"

            assert abs(stage.objective - value) <= tie, where

            least = sign * best - (1.0 + ROUNDING) * tie

            assert sign * stage.bound >= least, f"bound is beaten; {where}"
            assert sign * stage.bound >= sign * stage.objective, where
            assert (stage.gap == 0.0) == (stage.bound == stage.objective), where

            if stage.gap == 0.0:
                assert sign * value >= least, f"proven, but not best; {where}"

            assert stage.gap <= largest_gap, f"not proven; {where}"

            rivals = {
                units: values
                for units, values in rivals.items()
                if sign * values[name] >= sign * value - tie
            }

    def is_ambiguous(self, poses: tuple[int, ...]) -> bool:
        """True if layouts differ from one by about as much as ties do, but not by
        rounding.

        Ties are not transitive then, and a stage may have a gap that nothing closes.
        """
        for name in self.names:
            tie = _sense(name)[1]
            value = self.layouts[poses][name]
            for values in self.layouts.values():
                if ROUNDING * tie < abs(values[name] - value) < FAR * tie:
                    return True

        return False


def _sense(name: str) -> tuple[float, float]:
    """Sign that makes more better, and the tie tolerance of a stage."""
    if name in ("units", "cost_eur"):
        return -1.0, TIE_EUR
    return 1.0, TIE
