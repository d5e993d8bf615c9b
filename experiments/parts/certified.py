"""A layout for the mean over worlds, and what it may lack of the best.

Value, words, table.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Annotated, Any

from msgspec.structs import asdict as fields_of

from placement.certify import GapEstimate, certify, estimate_gap
from placement.compute import Compute, RunTasks
from placement.growth import Growth, grow
from placement.pipeline import Assembly, assemble
from placement.question import AUTO, Question
from placement.sampling.out_of_sample import APART

from ..engine.start import EngineWish, start_engine
from ..engine.tasks import Engine, map_tasks
from ..export.json import to_json, to_json_text
from ..language import mark, tr, trn
from ..progress import StageProgress
from ..results.drives import DrivesRecord, build_drives_record
from ..results.folders import LAYOUT_FILE, expect_files, save_files
from ..results.numbers import percent
from ..results.record import Record, says
from .sampled_worlds import EstimateRecord, growth_sentences
from .section import Table

JSON_NAME = "certified.json"
_SMALL = 1.0e-9


class BlockRecord(Record, frozen=True, kw_only=True):
    """Some sampled worlds, and what can be reached in them."""

    first: Annotated[int, says("Number of the first world, from 0.", ge=0)]
    bound: Annotated[float, says("Mean APR that no layout exceeds in these worlds.")]
    apr: Annotated[float, says("Mean APR of the layout found in them, in them.")]


class PoolRecord(EstimateRecord, frozen=True, kw_only=True):
    """A layout of the pool in the worlds that choose among them."""

    name: Annotated[str, says("Where it was found.")]


class CertifiedResult(DrivesRecord, frozen=True, kw_only=True):
    """The best layout found in blocks of worlds, and what it may lack."""

    command: Annotated[str, says("That made it.")]
    candidates: Annotated[int, says("Number of poses to choose from.")]
    worlds_of_block: Annotated[int, says("Number of worlds in each block.", ge=2)]
    growth: Annotated[Growth | None, says("How many are enough; null: not asked.")] = (
        None
    )
    uncertainty: Annotated[str, says("Name of what is drawn in the worlds.")]
    seed: Annotated[int, says("Of the draws.", ge=0)]
    blocks: Annotated[
        tuple[BlockRecord, ...], says("Each with worlds of its own.", min_length=1)
    ]
    pool: Annotated[
        tuple[PoolRecord, ...], says("Layouts found, the best first.", min_length=1)
    ]
    units: Annotated[tuple[str, ...], says("Sites of the best one's units.")]
    apr_by_world: Annotated[
        tuple[float, ...], says("In worlds that nothing was chosen in.", min_length=1)
    ]
    apr: Annotated[float, says("Mean of these.")]
    least: Annotated[float, says("Its APR over all worlds is not below this.")]
    most: Annotated[float, says("No layout's APR over all worlds is above this.")]
    gap: Annotated[float, says("most - least: holds with 95 %.")]
    bias: Annotated[float, says("Part of the gap that larger blocks make smaller.")]
    chance: Annotated[float, says("Part of the gap that more worlds make smaller.")]
    seconds: Annotated[dict[str, float], says("Time per stage.")]


def run_certify(
    question: Question,
    *,
    n_blocks: int,
    n_judged: int,
    out: Path | None,
    engine: EngineWish,
    tell: Callable[[str], None],
    compute: Compute,
    command: str,
    progress: StageProgress,
    sign: Path | None = None,
) -> CertifiedResult:
    """Find a layout for the mean over worlds, and its gap.

    With a scheduler, `engine` says where blocks are solved and worlds are looked at.
    Without one that is this process with its threads: two processes of one thread each
    gave the same bytes, but took 42 instead of 25 processor seconds for three blocks of
    three worlds, and twice the memory. `tell` gets sentences about workers. Raises
    InputError as `certify`, of `out`, or of the engine.
    """
    expect_files(out, progress, sign=sign)
    growth = None
    # In worlds that neither a bound nor the layout is judged in.
    if question.samples == AUTO:
        growth = grow(question, first=APART, compute=compute).growth
        question = replace(question, samples=growth.taken)
    plan = assemble(question, compute=compute)
    if not engine.scheduler:
        engine = engine.with_workers(1)
    with start_engine(engine, n_tasks=n_blocks, tell=tell) as started:
        if started.is_here:
            found = certify(plan, n_blocks=n_blocks, n_judged=n_judged)
        else:
            progress(mark("blocks of worlds"), 0, n_blocks)
            found = certify(
                _for_workers(plan),
                n_blocks=n_blocks,
                n_judged=n_judged,
                run=_runner(started, progress),
            )
    assert plan.uncertainty is not None
    layout = replace(found.judged.layout, name="certified")
    result = CertifiedResult(
        command=command,
        candidates=len(plan.candidates),
        worlds_of_block=plan.n_samples,
        growth=growth,
        uncertainty=plan.uncertainty.name,
        seed=compute.seed,
        blocks=tuple(
            BlockRecord(first=one.first, bound=one.bound, apr=one.apr)
            for one in found.blocks
        ),
        pool=tuple(
            PoolRecord(name=one.layout.name, **asdict(one.estimate))
            for one in found.pool
        ),
        units=tuple(unit.site_id for unit in layout.units),
        apr_by_world=tuple(found.judged.apr_by_sample.tolist()),
        **_numbers(found.gap),
        **fields_of(build_drives_record(plan.setting)),
        seconds={},
    )
    return save_files(
        result,
        out,
        progress,
        lambda done: {
            LAYOUT_FILE: to_json(layout, plan.scene),
            JSON_NAME: to_json_text(done),
        },
        has_manifest=True,
        sign=sign,
    )


def _for_workers(plan: Assembly) -> Assembly:
    """The same, for workers that have one thread each."""
    return replace(
        plan,
        compute=replace(plan.compute, workers=1),
        effort=replace(plan.effort, workers=1),
    )


def _runner(engine: Engine, progress: StageProgress) -> RunTasks:
    """Runs tasks on an engine, and tells how many are done."""

    def run(
        function: Callable[..., Any], tasks: Iterable[Any], *, shared: tuple[Any, ...]
    ) -> Iterator[tuple[Any, Any]]:
        all_tasks = list(tasks)
        progress(progress.stage, 0, len(all_tasks))
        answers = map_tasks(function, all_tasks, engine=engine, shared=shared)
        for done, answer in enumerate(answers, start=1):
            yield answer
            progress(progress.stage, done, len(all_tasks))

    return run


def _numbers(gap: GapEstimate) -> dict[str, Any]:
    """What follows from the bounds of the blocks and the APR in each world."""
    return {
        "apr": gap.least.mean,
        "least": gap.least.low,
        "most": gap.most.high,
        "gap": gap.gap,
        "bias": gap.bias,
        "chance": gap.chance,
    }


def recompute(stored: CertifiedResult) -> list[str]:
    """What is wrong with the numbers, in words.

    Each is computed anew from bounds and APRs by world.
    """
    again = estimate_gap([block.bound for block in stored.blocks], stored.apr_by_world)
    wrong = [
        f"{name}: {getattr(stored, name):.6g}, recomputed {value:.6g}"
        for name, value in _numbers(again).items()
        if not abs(getattr(stored, name) - value) <= _SMALL
    ]
    first = [block.first for block in stored.blocks]
    if first != [index * stored.worlds_of_block for index in range(len(first))]:
        wrong.append("blocks: their worlds are not apart")
    above = [block.first for block in stored.blocks if block.apr > block.bound + _SMALL]
    wrong += [f"block from world {first}: APR above its bound" for first in above]
    best = max(stored.pool, key=lambda one: one.mean or 0.0)
    if best != stored.pool[0]:
        wrong.append("pool: the first one is not the best")
    return wrong


def words(result: CertifiedResult) -> list[str]:
    """What the layout prevents and may lack, the most important first."""
    n_judged = len(result.apr_by_world)
    n_blocks = len(result.blocks)
    loose = sum(block.bound > block.apr + _SMALL for block in result.blocks)
    sentences = [
        trn(
            "{n} unit at {sites} prevents {share} of the accidents in {worlds}"
            " sampled worlds that were not used for choosing; another layout within"
            " the budget could prevent at most {gap:.2f} points more (with 95 %"
            " confidence)",
            "{n} units at {sites} prevent {share} of the accidents in {worlds}"
            " sampled worlds that were not used for choosing; another layout within"
            " the budget could prevent at most {gap:.2f} points more (with 95 %"
            " confidence)",
            len(result.units),
            sites=", ".join(result.units),
            share=percent(result.apr),
            worlds=n_judged,
            gap=100.0 * result.gap,
        ),
        tr(
            "Over all worlds, the layout prevents at least {least:.2f} %, and no"
            " layout prevents more than {most:.2f} %. Larger blocks or a better"
            " layout would close {bias:.2f} points of the gap, more worlds"
            " {chance:.2f}",
            least=100.0 * result.least,
            most=100.0 * result.most,
            bias=100.0 * result.bias,
            chance=100.0 * result.chance,
        ),
        trn(
            "The upper limit is the mean of {blocks} proven bounds, one for "
            "each block of {n} world",
            "The upper limit is the mean of {blocks} proven bounds, one for "
            "each block of {n} worlds",
            result.worlds_of_block,
            blocks=n_blocks,
        ),
        *growth_sentences(result.growth),
    ]
    if loose:
        sentences.append(
            tr(
                "In {n} of {blocks} blocks, the solver ran out of time before it"
                " reached the bound: more time may lower the limit",
                n=loose,
                blocks=n_blocks,
            )
        )
    return sentences


def table(result: CertifiedResult) -> Table:
    """A row per layout of the pool."""
    return Table(
        caption=tr(
            "Layouts found, compared in the {n} worlds used to choose among them",
            n=len(result.apr_by_world),
        ),
        columns=[tr("layout"), tr("APR"), tr("from"), tr("to")],
        rows=[
            [tr(one.name), *map(percent, (one.mean, one.low, one.high))]
            for one in result.pool
        ],
        numeric=(1, 2, 3),
    )
