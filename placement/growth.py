"""Number of sampled worlds that are enough to choose a layout in."""

from dataclasses import dataclass, replace
from typing import Annotated, Literal, NamedTuple

from geometry.clock import now_s
from geometry.errors import InputError, Unquoted
from geometry.scene import Scene
from geometry.tables import says

from .compute import DEFAULT_COMPUTE, Compute
from .pipeline import Assembly, Placement, assemble, place
from .question import N_JUDGED, Question
from .sampling.out_of_sample import SampledApr, estimate_mean
from .sampling.worlds import pose_key
from .wishes import Wishes

SIZES = (4, 8, 16, 32, 64)
"""Worlds to choose in, round by round."""
Stopped = Literal["same", "no better", "time", "memory", "most"]
_GAIN = (
    "95 % interval of that less the round before's; null: the first round, or the same"
    " layout."
)
_STOPPED = (
    "Why no more were tried: same layout, none better beyond chance, or what had run"
    " out."
)
# Rounds take so many times the time limit of one, before the last one begins.
_TIMES = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class Round:
    """What was chosen in a number of worlds."""

    worlds: Annotated[int, says("Number of worlds to choose in.")]
    in_sample: Annotated[float, says("Mean APR of the layout in them.")]
    bound: Annotated[float, says("Mean APR that no layout exceeds in them.")]
    mean: Annotated[
        float, says("Mean APR of the layout in fresh worlds that only compare rounds.")
    ]
    low: Annotated[float | None, says(_GAIN)]
    high: Annotated[float | None, says(_GAIN)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Growth:
    """How many worlds to choose in are enough."""

    taken: Annotated[int, says("So many.")]
    compared_in: Annotated[int, says("Fresh worlds that compare rounds.")]
    stopped: Annotated[Stopped, says(_STOPPED)]
    rounds: Annotated[tuple[Round, ...], says("The fewest worlds first.")]


class Grown(NamedTuple):
    """What is best in as many worlds as are enough."""

    assembly: Assembly
    placement: Placement
    growth: Growth


def grow(
    question: Question,
    *,
    scene: Scene | None = None,
    first: int = 0,
    compute: Compute = DEFAULT_COMPUTE,
) -> Grown:
    """Choose in twice as many worlds until the layout gets no better.

    A round's layout is chosen in the worlds from `first` on, as if so many had been
    asked for. It is compared with that of the round before in 60 fresh worlds, the same
    ones for both: unless it is ahead with 95 % confidence, the fewer worlds are enough.
    No other round begins after five times the time limit, for 64 worlds, or where twice
    as many do not fit into memory.

    The best solution in n worlds tends to the best over all, and stopping by what fresh
    worlds measure, not by values in the worlds that were chosen in, is sequential
    sampling [1]_. Raises InputError as :func:`place`, or for a question that is not for
    the highest mean APR.

    References
    ----------
    .. [1] G. Bayraksan, D. P. Morton, "A sequential sampling procedure for stochastic
       programming",
       Operations Research 59 (2011).
    """
    began_s = now_s()
    rounds = list[Round]()
    best: tuple[Assembly, Placement, SampledApr] | None = None
    stopped: Stopped = "most"
    # Each round has twice as many worlds as the one before.
    for n_worlds in SIZES:
        if best is not None and now_s() - began_s > _TIMES * question.time_limit_s:
            stopped = "time"
            break
        asked = replace(question, samples=n_worlds)
        if best is None:
            setting = None
        else:
            setting = best[0].setting
        trial = assemble(asked, scene=scene, setting=setting, compute=compute)
        trial = replace(trial, first_sample=first)
        check_mean(
            trial.wishes, "samples", "a number: auto is for a budget and the mean APR"
        )
        try:
            found = place(trial, asks_worlds=True)
        except InputError as error:
            if best is None or error.where != "memory":
                raise
            stopped = "memory"
            break
        # Compare the round's layout with the one before in fresh worlds.
        before = None
        if best is not None:
            before = best[2]
        judged, this = _round(trial, found, before)
        rounds.append(this)
        if best is not None and not (this.low or 0.0) > 0.0:
            if this.low is None:
                stopped = "same"
            else:
                stopped = "no better"
            break
        best = trial, found, judged
    # The first round is taken in any case.
    assert best is not None
    # The best round is the last one that was ahead.
    assembly, placement, judged = best
    growth = Growth(
        taken=assembly.n_samples,
        compared_in=len(judged.apr_by_sample),
        stopped=stopped,
        rounds=tuple(rounds),
    )
    return Grown(assembly, placement, growth)


def _round(
    assembly: Assembly, found: Placement, before: SampledApr | None
) -> tuple[SampledApr, Round]:
    """Judge one round's layout in fresh worlds, next to the one before."""
    stage = found.certificate.stages[0]
    gain = None
    low = None
    high = None
    mounted = {pose_key(unit) for unit in found.layout.units}
    if before is not None and mounted == {
        pose_key(unit) for unit in before.layout.units
    }:
        judged = before
    else:
        fresh = found.preferred or assembly.in_fresh_worlds(
            [found.layout], n_worlds=N_JUDGED
        )
        judged = fresh[0]
        if before is not None:
            gain = estimate_mean(
                judged.apr_by_sample - before.apr_by_sample, bounds=(-1.0, 1.0)
            )
            low = gain.low
            high = gain.high
    return judged, Round(
        worlds=assembly.n_samples,
        in_sample=stage.objective,
        bound=min(1.0, stage.bound),
        mean=judged.estimate.mean,
        low=low,
        high=high,
    )


def check_mean(wishes: Wishes, where: str, expected: str) -> None:
    """Raise InputError unless the mean APR over all worlds is what is asked for."""
    if wishes.target is not None or wishes.survive or wishes.tail < 1.0:
        got = Unquoted("a target, failures or a tail of the worlds")
        raise InputError(where, got, expected)
