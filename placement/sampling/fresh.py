"""A layout in fresh worlds: what it is worth where it was not chosen."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from geometry.arrays import BoolArray, FloatArray, float_array
from geometry.errors import InputError
from scenarios.aeb import AebRule, is_in_time
from scenarios.exposure import weight_share
from scenarios.runs import FrameAxis, onset_times_s

from ..candidates import CandidatePose
from ..evaluation import earliest_arrival_s
from ..layout import Layout
from ..setting import Setting
from .luck import pose_key
from .risk import MeanEstimate, cvar, estimate_mean
from .samples import draw_samples
from .tables import StageProgress, build_sample_tables
from .uncertainty import Uncertainty

STAGE = "out of sample"
FUSIONS = ("any", "single")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SampledApr:
    """Accident prevention ratio of a layout, world by world.

    Attributes
    ----------
    layout : Layout
        Whose.
    axis : FrameAxis
        Runs as planned.
    apr_by_sample : (n_samples,) float
        In each world. 0 .. 1
    avoided_share : (n_runs,) float
        Of all worlds, those in which each run is avoided. 0 .. 1
    """

    layout: Layout
    axis: FrameAxis
    apr_by_sample: FloatArray
    avoided_share: FloatArray

    def __post_init__(self) -> None:
        for name, shape in (("apr_by_sample", (-1,)), ("avoided_share", (self.axis.n_runs,))):
            object.__setattr__(self, name, float_array(getattr(self, name), shape, name))

    @property
    def estimate(self) -> MeanEstimate:
        """Mean, standard error and 95 % confidence interval."""
        return estimate_mean(self.apr_by_sample)

    @property
    def worst(self) -> float:
        """The smallest of all worlds."""
        return float(self.apr_by_sample.min())

    def cvar(self, tail: float) -> float:
        """Mean over the worst share of the worlds, see :func:`placement.sampling.risk.cvar`."""
        return cvar(self.apr_by_sample, tail)

    def __repr__(self) -> str:
        return (
            f"SampledApr({self.layout.name!r}: {self.estimate.mean:.4f} in "
            f"{len(self.apr_by_sample)} samples)"
        )


def out_of_sample(
    setting: Setting,
    layout: Layout,
    uncertainty: Uncertainty,
    *,
    n_samples: int,
    seed: int = 0,
    fusion: str = "any",
    workers: int = 1,
    on_progress: StageProgress | None = None,
) -> SampledApr:
    """Judge one layout in fresh worlds; see :func:`out_of_sample_layouts`."""
    (judged,) = out_of_sample_layouts(
        setting,
        [layout],
        uncertainty,
        n_samples=n_samples,
        seed=seed,
        fusion=fusion,
        workers=workers,
        on_progress=on_progress,
    )
    return judged


def out_of_sample_layouts(
    setting: Setting,
    layouts: Sequence[Layout],
    uncertainty: Uncertainty,
    *,
    n_samples: int,
    seed: int = 0,
    fusion: str = "any",
    workers: int = 1,
    on_progress: StageProgress | None = None,
) -> list[SampledApr]:
    """Judge layouts in fresh worlds, all in the same ones.

    Parameters
    ----------
    setting : Setting
        What the layouts were planned in.
    layouts : sequence of Layout
        Units at the same pose in several layouts are looked from once.
    uncertainty : Uncertainty
        What is drawn.
    n_samples : int
        How many worlds.
    seed : int
        Of all draws. None is shared with the worlds that
        :func:`placement.sampling.tables.sampled_table` chooses in, also not for the same seed.
    fusion : {"any", "single"}
        "any": a frame counts if any unit detects; "single": one unit must confirm alone.
    workers : int
        Threads.
    on_progress : callable, optional
        Called with the stage, and how many worlds are done of how many.

    Returns
    -------
    judged : list of SampledApr
        One per layout, by detection tables; each unit with its own latency.

    Raises
    ------
    InputError
        The fusion is unknown; see :func:`placement.sampling.samples.draw_samples`.
    """
    if fusion not in FUSIONS:
        raise InputError("--fusion", fusion, "one of " + ", ".join(FUSIONS))
    units = {_key(unit): unit for layout in layouts for unit in layout.units}
    row = {key: index for index, key in enumerate(units)}
    # Two layouts may call different units the same.
    poses = [replace(unit, id=f"#{index}") for index, unit in enumerate(units.values())]
    samples = draw_samples(
        setting, poses, uncertainty, n_samples=n_samples, seed=seed, purpose="judge"
    )
    if on_progress is not None:
        on_progress(STAGE, 0, n_samples)
    avoided = np.zeros((len(layouts), n_samples, setting.axis.n_runs), dtype=bool)
    worlds = build_sample_tables(samples, seed=seed, workers=workers)
    for index, (_, table) in enumerate(worlds):
        detected = table.detected(slice(None))
        for which, layout in enumerate(layouts):
            avoided[which, index] = _avoided(
                [(unit, detected[row[_key(unit)]]) for unit in layout.units],
                table.axis,
                setting.rule,
                fusion,
            )
        if on_progress is not None:
            on_progress(STAGE, index + 1, n_samples)
    weight = setting.axis.weight
    return [
        SampledApr(
            layout=layout,
            axis=setting.axis,
            apr_by_sample=np.array([weight_share(world, weight) for world in by_sample]),
            avoided_share=by_sample.mean(axis=0),
        )
        for layout, by_sample in zip(layouts, avoided, strict=True)
    ]


def _key(unit: CandidatePose) -> tuple[object, ...]:
    return (unit.site_id, unit.sensor, *pose_key(unit))


def _avoided(
    parties: Sequence[tuple[CandidatePose, BoolArray]], axis: FrameAxis, rule: AebRule, fusion: str
) -> BoolArray:
    """Runs in which braking comes in time, (n_runs,)."""
    arrivals = [(detected, unit.latency(rule)) for unit, detected in parties]
    together = [arrivals] if fusion == "any" else [[arrival] for arrival in arrivals]
    avoided = np.zeros(axis.n_runs, dtype=bool)
    for fused in together:
        arrival = earliest_arrival_s(fused, axis)
        _, onset = onset_times_s(arrival, axis, n_confirmations=rule.n_confirmations)
        avoided |= is_in_time(onset, axis.last_brake_time_s, latency_s=0.0)
    return avoided
