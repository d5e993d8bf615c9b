"""What a layout may lack of the best one over all worlds: the gap that remains."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

from geometry.phrases import Phrase

from .cache import cached_value
from .compute import RunTasks, check_whole, run_here
from .growth import check_mean
from .optimiser import Solution, solve_placement
from .optimiser.greedy import solve_greedy
from .pipeline import Assembly, pick_layout
from .question import N_BLOCKS, N_JUDGED
from .sampling.out_of_sample import MeanEstimate, SampledApr, estimate_mean


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """Some sampled worlds, and what can be reached in them.

    Attributes
    ----------
    first : int
        Number of its first world.
    bound : float
        Mean APR that no layout exceeds in its worlds, proven. 0 .. 1.
    apr : float
        Mean APR of the layout found in its worlds.
    found : tuple of int
        Rows of the candidates.
    greedy : tuple of int
        Rows of the layout that greedy choice finds in its worlds.
    """

    first: int
    bound: float
    apr: float
    found: tuple[int, ...]
    greedy: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class GapEstimate:
    """Limits of the best mean APR and of a layout's own mean APR.

    Both hold at once with 95 % confidence.

    Attributes
    ----------
    most : MeanEstimate
        Of the blocks' bounds: no layout's APR over all worlds is above its
        `high`.
    least : MeanEstimate
        Of the layout in worlds that nothing was chosen in: its APR is not below
        its `low`.
    """

    most: MeanEstimate
    least: MeanEstimate

    @property
    def gap(self) -> float:
        """What the layout may lack of the best at most; 0 if nothing."""
        return max(0.0, self.most.high - self.least.low)

    @property
    def bias(self) -> float:
        """Part of the gap that more worlds in a block would reduce.

        A better layout would reduce it, too.
        """
        return max(0.0, self.most.mean - self.least.mean)

    @property
    def chance(self) -> float:
        """Part of the gap that more blocks would reduce.

        More worlds to judge in would reduce it, too.
        """
        return self.gap - min(self.bias, self.gap)


def estimate_gap(bounds: Sequence[float], aprs: Sequence[float]) -> GapEstimate:
    """Estimate the gap from blocks' bounds and a layout's APRs.

    `bounds` (n_blocks,) are those of the blocks, `aprs` (n_worlds,) those of the
    layout in other worlds. The expected bound of a block is not below the best
    expected APR: in each block the best layout is at least as good as the one that
    is best over all. Both means have an interval of Student's t with 95 %, of which
    one end each counts: 2.5 % on either side, 5 % together.

    References
    ----------
    .. [1] W.-K. Mak, D. P. Morton, R. K. Wood, "Monte Carlo bounding techniques for
       determining
       solution quality in stochastic programs", Operations Research Letters 24 (1999).

    Examples
    --------
    >>> estimate = estimate_gap([0.98, 0.982, 0.984], [0.97, 0.98, 0.975, 0.975])
    >>> round(estimate.bias, 4), round(estimate.gap, 4)
    (0.007, 0.0185)
    """
    return GapEstimate(most=estimate_mean(bounds), least=estimate_mean(aprs))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Certified:
    """Best layout found in blocks of worlds, and what it may lack.

    Attributes
    ----------
    blocks : tuple of Block
        Each with worlds of its own.
    pool : tuple of SampledApr
        Layouts found in the blocks, and the greedy ones, in the same fresh
        worlds; the best first.
    judged : SampledApr
        The best one in other fresh worlds.
    gap : GapEstimate
        From the bounds and these.
    """

    blocks: tuple[Block, ...]
    pool: tuple[SampledApr, ...]
    judged: SampledApr
    gap: GapEstimate


def certify(
    assembly: Assembly,
    *,
    n_blocks: int = N_BLOCKS,
    n_judged: int = N_JUDGED,
    run: RunTasks = run_here,
) -> Certified:
    """Find a layout for the mean over worlds, and limit what it lacks of the best.

    Each of the blocks has `assembly.n_samples` worlds, which no other block, and
    neither of the two times `n_judged` to judge in, has. `run` says where blocks are
    solved and worlds are looked at. Raises InputError for blocks
    of one world, fewer than two, or a question that is not for the highest mean APR
    within a budget.
    """
    check_whole("blocks", n_blocks, least=2)
    check_whole("judge", n_judged, least=2)
    check_whole("samples", assembly.n_samples, least=2)
    check_mean(
        assembly.wishes,
        "question",
        "a budget and the mean APR: only they are certified",
    )
    # Each block is solved by itself: its bound and its layouts are independent.
    compute = assembly.compute
    numbers = range(n_blocks)
    solved = dict(run(_solve_block, numbers, shared=(assembly, n_blocks)))
    blocks = tuple(solved[block] for block in numbers)
    # Equal layouts of several blocks are judged once.
    names = {
        **{one.greedy: f"greedy of block {n}" for n, one in enumerate(blocks, start=1)},
        **{one.found: f"best of block {n}" for n, one in enumerate(blocks, start=1)},
    }
    layouts = [
        pick_layout(assembly.candidates, rows, name) for rows, name in names.items()
    ]
    compute.progress(Phrase("choose in fresh worlds"), 0, 0)
    judge = partial(assembly.in_fresh_worlds, n_worlds=n_judged, run=run)
    pool = judge(layouts, first=0)
    pool = sorted(pool, key=lambda one: -one.estimate.mean)
    compute.progress(Phrase("judge in other fresh worlds"), 0, 0)
    best = [pool[0].layout]
    (judged,) = judge(best, first=n_judged)
    gap = estimate_gap([block.bound for block in blocks], judged.apr_by_sample.tolist())
    return Certified(blocks=blocks, pool=tuple(pool), judged=judged, gap=gap)


def _solve_block(assembly: Assembly, n_blocks: int, block: int) -> Block:
    """The best layout in the worlds of one block, with its bound."""
    first = block * assembly.n_samples
    compute = assembly.compute
    part = replace(
        assembly,
        first_sample=first,
        compute=compute.within(f"block {block + 1} of {n_blocks}"),
    )
    problem = part.problem

    def answer() -> tuple[Solution, tuple[int, ...]]:
        reduced = part.presolved
        solution = solve_placement(problem, reduced, effort=part.effort, n_stages=1)
        return solution, solve_greedy(problem, reduced)

    # Only a solution that is proven in its block is worth caching.
    solution, greedy = cached_value(
        compute.cache_folder,
        "block",
        answer,
        kind=tuple[Solution, tuple[int, ...]],
        made_from=(problem, part.effort),
        is_worth_it=lambda found: found[0].certificate.stages[0].gap == 0.0,
    )
    stage = solution.certificate.stages[0]
    return Block(
        first=first,
        bound=min(1.0, stage.bound),
        apr=stage.objective,
        found=tuple(sorted(solution.pose_index)),
        greedy=tuple(sorted(greedy)),
    )
