"""Evaluation of layouts in sampled worlds that they were not chosen in."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from geometry.arrays import BoolArray, FloatArray, float_array, set_arrays
from geometry.errors import InputError, Unquoted
from geometry.phrases import Phrase
from scenarios.aeb import AebRule
from scenarios.runs import FrameAxis, find_onsets

from ..cache import cached_value
from ..candidates import CandidatePose
from ..compute import DEFAULT_COMPUTE, Compute, RunTasks, run_here, silent
from ..evaluation import earliest_arrival_s
from ..layout import Layout
from ..setting import Setting
from ..visibility.casting import SharedScene
from .driving import NO_TRAFFIC, TrafficCount
from .tables import build_sample_tables, seen_by_vut, share_scene, tell_traffic
from .uncertainty import Uncertainty
from .worlds import draw_samples, pose_key

# ---------- statistics of many worlds


_NO_SPREAD = 1.0e-12


@dataclass(frozen=True, slots=True, kw_only=True)
class MeanEstimate:
    """A mean that is estimated from samples.

    Attributes
    ----------
    mean : float
        Of the samples.
    standard_error : float
        Of the mean: standard deviation / sqrt(n); NaN for a single sample.
    low, high : float
        Confidence interval of the true mean.
    method : str
        How the interval was found, in words.
    """

    mean: float
    standard_error: float
    low: float
    high: float
    method: str


def estimate_mean(
    values: ArrayLike, *, bounds: tuple[float, float] = (0.0, 1.0)
) -> MeanEstimate:
    """Mean of independent samples, with a confidence interval.

    Samples lie within `bounds`. The interval has 95 % confidence: Student's t [1]_,
    cut off at the bounds. Where samples show no spread, at most a share q of all
    worlds differs, since n draws in a row would show none of a larger share with a
    probability below (1 - q)^n = 0.05, and these may be as bad or as good as can be
    [2]_. Raises InputError for no sample, or one out of bounds.

    References
    ----------
    .. [1] W. S. Gosset ("Student"), "The probable error of a mean", Biometrika 6
       (1908).
    .. [2] J. A. Hanley, A. Lippman-Hand, "If nothing goes wrong, is everything all
       right?", JAMA
       249 (1983): none in n, hence with 95 % confidence at most about 3 / n.

    Examples
    --------
    >>> estimate = estimate_mean([1.0] * 59)
    >>> round(estimate.low, 3), estimate.high
    (0.95, 1.0)
    """
    samples = float_array(values, (-1,), "samples")
    (lowest, highest) = bounds
    if len(samples) == 0:
        raise InputError("samples", Unquoted("none"), "at least one")
    if samples.min() < lowest - _NO_SPREAD or samples.max() > highest + _NO_SPREAD:
        raise InputError("samples", samples.tolist(), f"{lowest:g} .. {highest:g}")
    n = len(samples)
    # Rounding must not carry the mean out of its bounds.
    mean = min(max(math.fsum(samples) / n, lowest), highest)
    if n > 1:
        error = float(samples.std(ddof=1)) / math.sqrt(n)
    else:
        error = math.nan
    # Without spread, the rule of three; else Student's t.
    if np.ptp(samples) <= _NO_SPREAD:
        share = 1.0 - (1.0 - 0.95) ** (1.0 / n)
        low = mean + share * (lowest - mean)
        high = mean + share * (highest - mean)
        method = Phrase("95 % interval: no spread in {n} samples, rule of three", n=n)
    else:
        from scipy.special import stdtrit

        reach = float(stdtrit(n - 1, 0.5 + 0.5 * 0.95)) * error
        low = max(lowest, mean - reach)
        high = min(highest, mean + reach)
        method = Phrase("95 % interval: Student's t, {n} samples", n=n)
    return MeanEstimate(
        mean=mean, standard_error=error, low=low, high=high, method=method
    )


def cvar(apr_by_sample: ArrayLike, tail: float) -> float:
    """Conditional value at risk: mean over the worst share of worlds.

    Worlds are equally likely. max over t of t - mean(max(0, t - apr)) / tail. A
    tail of 1 is the expectation; up to 1 / n_samples, 0 among them, it is the worst
    world alone. Where the share ends within a world, that one counts in part.
    Raises InputError if there is no sample, or the tail is no share.

    References
    ----------
    .. [1] R. T. Rockafellar, S. Uryasev, "Optimization of conditional value-at-risk",
       Journal of
       Risk 2 (2000).

    Examples
    --------
    >>> cvar([0.5, 1.0, 0.9, 0.7], 0.5)
    0.6
    """
    samples: FloatArray = np.sort(float_array(apr_by_sample, (-1,), "samples"))
    # Each world counts fully, in part, or not at all.
    n_counted = max(1.0, tail * len(samples))
    counts = np.clip(n_counted - np.arange(len(samples)), 0.0, 1.0)
    return math.fsum(counts * samples) / n_counted


_N_RESAMPLED = 1000


def resampled_cvar(
    apr_by_sample: ArrayLike, tail: float, *, seed: int = 0
) -> FloatArray:
    """CVaR of layouts in worlds drawn with repetition.

    `apr_by_sample` is (n_layouts, n_samples). (n_layouts, 1000): the bootstrap's
    distribution (B. Efron, "Bootstrap methods: another look at the jackknife",
    Annals of Statistics 7, 1979). All layouts have the same worlds in each draw.
    """
    samples = float_array(apr_by_sample, (-1, -1), "samples")
    rng = np.random.default_rng(seed)
    drawn = rng.integers(samples.shape[1], size=(_N_RESAMPLED, samples.shape[1]))
    return np.array([[cvar(row[worlds], tail) for worlds in drawn] for row in samples])


# ---------- layouts in new worlds


STAGE = Phrase("out of sample")
APART = 100_000
"""First world to choose among layouts in; the answer is judged in others."""
TOGETHER = 10
"""Worlds that one task looks at: they share what all worlds have in common."""
# Of a world: a draw costs a sixth of a world.
N_DRAWS = 4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SampledApr:
    """Accident prevention ratio of a layout, world by world.

    Attributes
    ----------
    layout : Layout
        The layout that is judged.
    axis : FrameAxis
        Runs as planned.
    apr_by_sample : (n_samples,) float
        0 .. 1.
    avoided_share : (n_runs,) float
        Of all worlds, in which each run is avoided. 0 .. 1.
    driving : TrafficCount
        Vehicles that drove by in these worlds.
    alone : float
        Mean APR of all cars without units; 0 where they are blind. 0 .. 1.
    """

    layout: Layout
    axis: FrameAxis
    apr_by_sample: FloatArray
    avoided_share: FloatArray
    driving: TrafficCount = NO_TRAFFIC
    alone: float = 0.0

    def __post_init__(self) -> None:
        set_arrays(self, "", apr_by_sample=(-1,), avoided_share=(self.axis.n_runs,))

    @property
    def estimate(self) -> MeanEstimate:
        """Mean, standard error and 95 % confidence interval."""
        return estimate_mean(self.apr_by_sample)

    @property
    def worst(self) -> float:
        """The smallest of all worlds."""
        return float(self.apr_by_sample.min())

    def cvar(self, tail: float) -> float:
        """Mean over the worst share of the worlds, see :func:`.cvar`."""
        return cvar(self.apr_by_sample, tail)

    def __repr__(self) -> str:
        return (
            f"SampledApr({self.layout.name!r}: {self.estimate.mean:.4f} in "
            f"{len(self.apr_by_sample)} samples)"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FreshWorlds:
    """Runs that layouts avoid in some worlds that none was chosen in.

    Attributes
    ----------
    avoided : (n_layouts, n_worlds, n_runs) float
        Share of the draws in a world.
    driving : TrafficCount
        Vehicles that drove by, in all of them.
    alone : (n_worlds, n_runs) float
        Share of the cars that avoid it without units.
    """

    avoided: FloatArray
    driving: TrafficCount
    alone: FloatArray


def out_of_sample_layouts(
    setting: Setting,
    layouts: Sequence[Layout],
    uncertainty: Uncertainty,
    *,
    n_samples: int,
    first: int = 0,
    fusion: str = "any",
    compute: Compute = DEFAULT_COMPUTE,
    run: RunTasks = run_here,
) -> list[SampledApr]:
    """Evaluate layouts by detection tables in new sampled worlds.

    All layouts are judged in the same worlds. No draw is shared with the worlds of
    :func:`placement.sampling.tables.sampled_table`, also not for the same seed.
    What is avoided is cached, unless vehicles drive by or a network looks at
    pictures; progress counts the worlds. `run` says where they are looked at.
    """
    look = partial(look_at_fresh_worlds, n_worlds=n_samples, first=first, fusion=fusion)
    if run is run_here:
        obtain = partial(look, setting, layouts, uncertainty, compute=compute)
    else:
        shared = (setting, uncertainty, fusion, compute)
        obtain = partial(_look_in_parts, run, shared, layouts, first, n_samples)
    is_cached = uncertainty.moving is None and not setting.detector.needs_pictures
    folder = None
    if is_cached:
        folder = compute.cache_folder
    worlds = cached_value(
        folder,
        "fresh-worlds",
        obtain,
        kind=FreshWorlds,
        made_from=(
            *(
                setting.scene,
                setting.runs,
                setting.rule,
                setting.detector,
                setting.table_detector,
            ),
            *(setting.radio, setting.vut_sensors, setting.vut_camera, setting.cars),
            *(uncertainty, look.keywords, compute.seed),
            [[replace(unit, id="") for unit in layout.units] for layout in layouts],
        ),
    )
    return judge_layouts(setting, layouts, uncertainty, worlds)


def _look_in_parts(
    run: RunTasks,
    shared: tuple[Any, ...],
    layouts: Sequence[Layout],
    first: int,
    n_worlds: int,
) -> FreshWorlds:
    """What layouts avoid in fresh worlds, some of which are looked at together."""
    end = first + n_worlds
    parts = [
        (tuple(layouts), begin, min(TOGETHER, end - begin))
        for begin in range(first, end, TOGETHER)
    ]
    numbered = {
        begin: worlds
        for (_, begin, _), worlds in run(_look_at_part, parts, shared=shared)
    }
    return join_worlds([numbered[begin] for _, begin, _ in parts])


def join_worlds(parts: Sequence[FreshWorlds]) -> FreshWorlds:
    """What the same layouts avoid in the worlds of all parts, in their order."""
    driving = TrafficCount()
    for some in parts:
        driving += some.driving
    return FreshWorlds(
        avoided=np.concatenate([some.avoided for some in parts], axis=1),
        driving=driving,
        alone=np.concatenate([some.alone for some in parts]),
    )


def _look_at_part(
    setting: Setting,
    uncertainty: Uncertainty,
    fusion: str,
    compute: Compute,
    part: tuple[Sequence[Layout], int, int],
) -> FreshWorlds:
    layouts, first, n_worlds = part
    return look_at_fresh_worlds(
        setting,
        layouts,
        uncertainty,
        n_worlds=n_worlds,
        first=first,
        fusion=fusion,
        compute=compute,
    )


def look_at_fresh_worlds(
    setting: Setting,
    layouts: Sequence[Layout],
    uncertainty: Uncertainty,
    *,
    n_worlds: int,
    first: int = 0,
    fusion: str = "any",
    compute: Compute = DEFAULT_COMPUTE,
) -> FreshWorlds:
    """Runs that layouts avoid in so many fresh worlds, from one of them on.

    In each world, detections and lost messages are drawn ``N_DRAWS`` times, if chance
    decides them.
    """
    # Every unit once, even where several layouts have it.
    units = {_key(unit): unit for layout in layouts for unit in layout.units}
    row = {key: index for index, key in enumerate(units)}
    # Two layouts may call different units the same.
    poses = [replace(unit, id=f"#{index}") for index, unit in enumerate(units.values())]
    samples = draw_samples(
        setting,
        poses,
        uncertainty,
        n_samples=n_worlds,
        seed=compute.seed,
        purpose="judge",
        first=first,
    )
    compute.progress(STAGE, 0, n_worlds)
    if uncertainty.draws_anew:
        n_draws = N_DRAWS
    else:
        n_draws = 1
    avoided = np.zeros((len(layouts), n_worlds, setting.axis.n_runs))
    alone = np.zeros(avoided.shape[1:])
    quiet = replace(compute, cache_folder=None, progress=silent)
    lasting = None
    if uncertainty.road_users.are_as_planned:
        lasting = _shared(setting, uncertainty.moving is None, quiet)
    worlds = build_sample_tables(
        samples,
        compute=quiet,
        at_once=compute.workers,
        lasting=lasting,
        n_draws=n_draws,
    )
    driving = TrafficCount()
    # Each world comes once for every draw.
    for draw, (sample, table) in enumerate(worlds):
        index = draw // n_draws
        if draw % n_draws == 0:
            driving += sample.driving
            # Once in each world: nothing repeats in its images.
            seen = seen_by_vut(sample, quiet)
            if seen is None:
                own = []
            else:
                own = [(seen, setting.rule.latency_s)]
            if own:
                alone[index] = setting.cars * _avoided(
                    own, table.axis, setting.rule, fusion
                )
        detected = table.detected(slice(None))
        # Layouts are judged for cars that see, and for those that do not.
        for which, layout in enumerate(layouts):
            sent = [
                (detected[row[_key(u)]], u.latency(setting.rule)) for u in layout.units
            ]
            for share, arrivals in (
                (setting.cars, [*sent, *own]),
                (1.0 - setting.cars, sent),
            ):
                if share:
                    in_time = _avoided(arrivals, table.axis, setting.rule, fusion)
                    avoided[which, index] += share * in_time
        compute.progress(STAGE, index + 1, n_worlds)
    return FreshWorlds(avoided=avoided / n_draws, driving=driving, alone=alone)


# Worlds of one question may be looked at in parts.
@lru_cache(maxsize=1)
def _shared(setting: Setting, is_still: bool, compute: Compute) -> SharedScene:
    return share_scene(setting, is_still=is_still, compute=compute)


def judge_layouts(
    setting: Setting,
    layouts: Sequence[Layout],
    uncertainty: Uncertainty,
    worlds: FreshWorlds,
) -> list[SampledApr]:
    """Put together what layouts avoid in all worlds."""
    tell_traffic(worlds.driving, uncertainty)
    # APR of each world, and share of the worlds that avoid each run.
    weight = setting.axis.weight
    alone = worlds.alone.mean(axis=0)
    return [
        SampledApr(
            layout=layout,
            axis=setting.axis,
            # Exactly 1 where every run with weight is avoided in every draw.
            apr_by_sample=1.0 - (1.0 - by_sample) @ (weight / weight.sum()),
            avoided_share=by_sample.mean(axis=0),
            driving=worlds.driving,
            alone=float(alone @ (weight / weight.sum())),
        )
        for layout, by_sample in zip(layouts, worlds.avoided, strict=True)
    ]


def _key(unit: CandidatePose) -> tuple[object, ...]:
    return (unit.site_id, unit.sensor, *pose_key(unit))


def _avoided(
    arrivals: Sequence[tuple[BoolArray, float]],
    axis: FrameAxis,
    rule: AebRule,
    fusion: str,
) -> BoolArray:
    """True for runs in which braking comes in time, (n_runs,).

    `arrivals` are frames that are detected, with their latency.
    """
    if fusion == "any":
        together = [arrivals]
    else:
        together = [[arrival] for arrival in arrivals]
    avoided = np.zeros(axis.n_runs, dtype=bool)
    for fused in together:
        avoided |= find_onsets(
            earliest_arrival_s(fused, axis), axis, rule=rule
        ).is_in_time
    return avoided
