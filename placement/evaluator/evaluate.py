"""Frame by frame to a verdict for every run."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from threadpoolctl import threadpool_limits

from geometry.arrays import BoolArray
from geometry.errors import InputError, Unquoted

from ..evaluation import Evaluation
from ..layout import Layout
from ..setting import Setting
from .awareness import known_frames
from .judge import Judge
from .surroundings import draw_index
from .watch import VUT_KEY, UnitKey, build_rng, unit_key, watch


def evaluate_layout(
    layout: Layout,
    setting: Setting,
    *,
    seed: int = 0,
    workers: int = 1,
    on_progress: Callable[[int, int], None] | None = None,
) -> Evaluation:
    """Evaluate one layout; see :func:`evaluate_layouts`."""
    evaluations = evaluate_layouts(
        [layout], setting, seed=seed, workers=workers, on_progress=on_progress
    )
    return evaluations[0]


def evaluate_layouts(
    layouts: Sequence[Layout],
    setting: Setting,
    *,
    seed: int = 0,
    workers: int = 1,
    on_progress: Callable[[int, int], None] | None = None,
) -> list[Evaluation]:
    """Verdicts of layouts by rendering every frame, detecting, confirming and braking.

    Parameters
    ----------
    layouts : sequence of Layout
        Units at the same pose in several layouts are rendered once.
    setting : Setting
        Scene, runs, braking rule, detector, radio.
    seed : int
        Of what is left to chance: misses, lost messages, who carries a device. A unit's luck
        depends on its pose, not on the layout that it is part of.
    workers : int
        Threads.
    on_progress : callable, optional
        See :func:`placement.evaluator.watch.watch`.

    Returns
    -------
    evaluations : list of Evaluation
        One per layout.

    Raises
    ------
    InputError
        The setting's axis does not belong to its runs, or `workers` is less than 1.
    """
    _check(setting, workers)
    units = {unit_key(unit): unit for layout in layouts for unit in layout.units}
    with threadpool_limits(1):  # one BLAS thread per worker: idle ones spin
        detected = watch(
            setting, units, seed=seed, workers=workers, on_progress=on_progress or _ignore
        )
    judge = Judge(setting.runs, setting.axis, setting.rule)
    return [_evaluate(layout, setting, detected, judge, seed) for layout in layouts]


def _check(setting: Setting, workers: int) -> None:
    runs, axis = setting.runs, setting.axis
    if tuple(run.id for run in runs) != axis.run_ids or not np.array_equal(
        np.concatenate([run.time_s for run in runs]), axis.time_s
    ):
        raise InputError("axis", Unquoted("frames of other runs"), "the frame axis of these runs")
    if workers < 1:
        raise InputError("workers", workers, "a whole number, at least 1")


def _evaluate(
    layout: Layout,
    setting: Setting,
    detected: Mapping[UnitKey, BoolArray],
    judge: Judge,
    seed: int,
) -> Evaluation:
    links, rule = setting.links, setting.rule
    draws, frame_draw = np.unique(draw_index(setting.runs), return_inverse=True)
    units = {}
    for unit in layout.units:
        key = unit_key(unit)
        arrives = (build_rng(seed, key, "cpm").random(len(draws)) >= links.packet_loss)[frame_draw]
        units[unit.id] = (detected[key] & arrives, unit.latency(rule))
    vut = (detected[VUT_KEY], rule.latency_s)
    others = {}
    if links.vam_rate > 0.0:
        vam = (known_frames(setting.runs, links, build_rng(seed, "vam")), rule.latency_s)
        others = {
            "vam": judge.verdict([vam]),
            "all_sources": judge.verdict([*units.values(), vut, vam]),
        }
    return Evaluation(
        layout=layout,
        axis=setting.axis,
        vut=judge.verdict([vut]),
        units={name: judge.verdict([party]) for name, party in units.items()},
        rsu_all=judge.verdict(list(units.values())),
        vut_and_rsus=judge.verdict([*units.values(), vut]),
        others=others,
    )


def _ignore(done: int, total: int) -> None:
    """Take no notice of progress."""
