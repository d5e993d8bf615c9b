"""How a layout should be chosen: ``python -m experiments.study.worlds FOLDER``.

For cars that see or are blind, as planned or in sampled worlds, by the mean or the worst quarter:
what is found, and the answer that `place-rsus` gives, are judged in fresh worlds that nothing was
chosen in, beside greedy choice.
"""

import math
import resource
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import product
from multiprocessing import get_context
from pathlib import Path
from typing import TypeVar

import click
import msgspec
import numpy as np
from matplotlib.figure import Figure

from geometry.arrays import FloatArray
from geometry.clock import now_s
from geometry.errors import InputError, Unquoted
from geometry.files import read_bytes, write_atomically
from geometry.scene_files import load_scene
from placement.cache import hash_of_code
from placement.certify import estimate_gap
from placement.compute import Compute
from placement.optimiser import (
    presolve,
    solve_greedy,
    solve_placement,
    solve_sturdily,
    sturdy_problem,
)
from placement.optimiser.problem import apr, apr_one_failed
from placement.pipeline import Assembly, assemble, is_preferred, may_prefer, pick_layout
from placement.question import BLIND, N_JUDGED, SEE, Question
from placement.sampling.out_of_sample import (
    APART,
    cvar,
    estimate_mean,
    resampled_cvar,
)
from placement.wishes import GIVE_UP

from ..figures.axes import BLUE, WIDTH_IN, new_figure, to_png
from ..figures.plan import plot_plan
from ..language import mark
from ..progress import StageProgress
from ..results.numbers import percent
from ..results.tables import markdown_table

CARS = (BLIND, SEE)
TAILS = (1.0, 0.25)
Rows = tuple[int, ...]  # of the candidates, ascending
Wanted = tuple[int, float, float]  # budget, tail, and the APR given up to bear a failure
T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class Where:
    """Worlds that layouts are chosen in."""

    scene: str
    cars: str
    n_worlds: int  # 0: as planned
    block: int = 0  # worlds from block * n_worlds on

    @property
    def name(self) -> str:
        """In words."""
        worlds = f"{self.n_worlds} worlds, block {self.block + 1}" if self.n_worlds else "plan"
        return f"{scene_name(self.scene)}, cars {self.cars}, {worlds}"


class Chosen(msgspec.Struct, frozen=True, kw_only=True):
    """A layout that was found in some worlds, and greedy choice there."""

    budget: int
    tail: float
    given: float = 0.0  # APR that may be given up to keep more when a unit fails
    found: Rows
    greedy: Rows
    value: float  # of the found one there: its mean APR, or that of the worst worlds
    bound: float  # that no layout exceeds there
    asks_worlds: bool = False  # fresh worlds decide between the found and the greedy one
    processor_s: float
    memory_mib: float  # most of the process until then

    @property
    def wanted(self) -> Wanted:
        """What was asked for."""
        return self.budget, self.tail, self.given


class Records(msgspec.Struct, kw_only=True):
    """What has been computed so far; a part that is there is not computed again."""

    question: dict[str, object]
    code: str  # hash of the packages that decide
    chosen: dict[str, list[Chosen]] = {}  # by name of where
    fresh: dict[str, dict[str, list[float]]] = {}  # by scene and cars, by rows: APR by world
    deciding: dict[str, dict[str, list[float]]] = {}  # as fresh: in worlds that decide
    planned: dict[str, dict[str, tuple[float, float]]] = {}  # as fresh: APR, and if one unit fails
    too_large: list[str] = []  # names of where, which do not fit into memory: nothing is chosen


def scene_name(scene: str) -> str:
    """The study's junction, or a map by its file."""
    return Path(scene).stem if scene else "study"


def _assembly(question: Question, where: Where, compute: Compute) -> Assembly:
    asked = replace(question, scene=where.scene, cars=where.cars, samples=where.n_worlds)
    return replace(assemble(asked, compute=compute), first_sample=where.block * where.n_worlds)


def choose(
    question: Question, where: Where, wanted: Sequence[Wanted], compute: Compute
) -> list[Chosen]:
    """Best and greedy layouts for what is wanted, in the same worlds."""
    most = max(budget for budget, *_ in wanted)
    assembly = _assembly(replace(question, budget=most), where, compute)
    whole = assembly.problem
    table_s = time.process_time()
    chosen = []
    for budget, tail, given in wanted:
        started = time.process_time()
        problem = replace(whole, limits=replace(whole.limits, budget_units=budget), tail=tail)
        reduced = presolve(problem, workers=compute.workers)
        effort = assembly.effort
        if where.block:  # of further blocks the bound alone counts
            highest, sturdy = solve_placement(problem, reduced, effort=effort, n_stages=1), None
        else:
            highest, sturdy = solve_sturdily(problem, reduced, give_up=given, effort=effort)
        solution = sturdy or highest
        asked = sturdy_problem(problem, highest, given) if sturdy else problem
        stages = {stage.name: stage for stage in solution.certificate.stages}
        greedy = solve_greedy(problem, reduced)
        wishes = replace(assembly.wishes, budget_units=budget, tail=tail, give_up=given)
        wanting = replace(assembly, wishes=wishes)
        chosen.append(
            Chosen(
                budget=budget,
                tail=tail,
                given=given,
                found=tuple(sorted(solution.pose_index)),
                greedy=tuple(sorted(greedy)),
                value=stages["apr"].objective,
                bound=min(1.0, stages["apr"].bound),
                asks_worlds=not where.block and may_prefer(wanting, asked, solution, greedy),
                processor_s=table_s + time.process_time() - started,
                memory_mib=resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
            )
        )
    return chosen


def plan_values(
    question: Question, where: Where, layouts: Sequence[Rows], compute: Compute
) -> dict[str, tuple[float, float]]:
    """APR of layouts as planned, and what is left of it if one unit fails."""
    problem = _assembly(replace(question, budget=1), where, compute).problem
    return {_key(rows): (apr(problem, rows), apr_one_failed(problem, rows)) for rows in layouts}


def judge(
    question: Question,
    where: Where,
    layouts: Sequence[Rows],
    first: int,
    n_worlds: int,
    compute: Compute,
) -> dict[str, list[float]]:
    """APR of layouts in each of so many fresh worlds, from one of them on."""
    assembly = _assembly(replace(question, budget=1), where, compute)
    picked = [pick_layout(assembly.candidates, rows, _key(rows)) for rows in layouts]
    found = assembly.in_fresh_worlds(picked, n_worlds=n_worlds, first=first)
    return {one.layout.name: one.apr_by_sample.tolist() for one in found}


def _key(rows: Rows) -> str:
    return " ".join(map(str, rows))


@dataclass(frozen=True, slots=True, kw_only=True)
class Study:
    """What is computed."""

    question: Question
    scenes: tuple[str, ...]
    budgets: tuple[int, ...]
    samples: tuple[int, ...]
    n_blocks: int
    n_judged: int
    cars: tuple[str, ...] = CARS
    tails: tuple[float, ...] = TAILS

    def wheres(self) -> Iterator[Where]:
        """All worlds to choose in, in the order of work: few worlds first, the plan before all."""
        for cars, n, scene in product(self.cars, (0, *self.samples), self.scenes):
            for block in range(self.n_blocks if n else 1):
                yield Where(scene=scene, cars=cars, n_worlds=n, block=block)

    def wanted(self, where: Where) -> list[Wanted]:
        """Tails in the first block alone, where they have two worlds; on the plan the default."""
        tails = [
            tail
            for tail in self.tails
            if tail == 1.0 or (where.n_worlds * tail >= 2.0 and where.block == 0)
        ]
        given = (0.0,) if where.n_worlds else (0.0, GIVE_UP)
        return [*product(self.budgets, tails, given)]

    def layouts(self, records: Records, scene: str, cars: str, *, decide: bool) -> list[Rows]:
        """Layouts to judge: those of the first blocks, and with other cars the best ones alone.

        Or those between which other worlds decide.
        """
        layouts: dict[Rows, None] = {}
        for where in self.wheres():
            if where.scene != scene or where.block:
                continue
            for one in records.chosen.get(where.name, []):
                if decide and not (one.asks_worlds and where.cars == cars):
                    continue
                layouts[one.found] = None
                if where.cars == cars:
                    layouts[one.greedy] = None
        return [*layouts]


def in_own_process(function: Callable[..., T], *arguments: object) -> T:
    """Value of a function whose memory and processor time are nobody else's."""
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        return pool.submit(function, *arguments).result()


class TimeUp(Exception):
    """No further part begins: the time given is over."""


def run(study: Study, path: Path, compute: Compute, *, until_s: float = math.inf) -> Records:
    """Compute what the file of records lacks, and save it after each part.

    Raises TimeUp once a part ends after the instant `until_s` of `geometry.clock`; InputError if
    the file is of another question, or of other code.
    """
    records = _read(path, study.question)

    def save() -> None:
        write_atomically(path, msgspec.json.encode(records))
        if now_s() > until_s:
            raise TimeUp

    def judge_all(scene: str, cars: str) -> None:
        plan = Where(scene=scene, cars=cars, n_worlds=0)
        for known, first, n_worlds in (
            (records.deciding, APART, N_JUDGED),
            (records.fresh, 0, study.n_judged),
        ):
            layouts = study.layouts(records, scene, cars, decide=known is records.deciding)
            values = known.setdefault(plan.name, {})
            if new := [rows for rows in layouts if len(values.get(_key(rows), ())) < n_worlds]:
                compute.progress(f"judge {plan.name}", 0, 0)
                where = replace(plan, n_worlds=1)
                worlds = (first, n_worlds, compute)
                values |= in_own_process(judge, study.question, where, new, *worlds)
                save()

    wheres = [*study.wheres()]
    for index, where in enumerate(wheres):
        compute.progress(mark("choose"), index, len(wheres))
        known = records.chosen.setdefault(where.name, [])
        have = {one.wanted for one in known}
        missing = [one for one in study.wanted(where) if one not in have]
        if missing and where.name not in records.too_large:
            try:
                known += in_own_process(choose, study.question, where, missing, compute)
            except InputError as error:
                if error.where != "memory":
                    raise
                records.too_large.append(where.name)
            save()
        judge_all(where.scene, where.cars)
    for scene, cars in product(study.scenes, study.cars):
        judge_all(scene, cars)  # those that were chosen for other cars, too
        plan = Where(scene=scene, cars=cars, n_worlds=0)
        planned = records.planned.setdefault(plan.name, {})
        layouts = study.layouts(records, scene, cars, decide=False)
        if new := [rows for rows in layouts if _key(rows) not in planned]:
            planned |= in_own_process(plan_values, study.question, plan, new, compute)
            save()
    return records


def _read(path: Path, question: Question) -> Records:
    asked, code = msgspec.to_builtins(question), hash_of_code()
    if not path.exists():
        return Records(question=asked, code=code)
    try:
        records = msgspec.json.decode(read_bytes(path), type=Records)
    except msgspec.DecodeError as error:
        raise InputError(str(path), Unquoted(str(error)), "records of this command") from None
    if (records.question, records.code) != (asked, code):
        got = Unquoted("records of another question" if records.code == code else "other code")
        raise InputError(str(path), got, "a folder of its own for each")
    return records


# ---------- what came out


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """A layout that was found, greedy choice, and which of them is the answer, in fresh worlds."""

    where: Where
    chosen: Chosen
    found: FloatArray  # (n_judged,): APR in each fresh world
    greedy: FloatArray
    takes_greedy: bool = False  # other worlds preferred greedy choice
    bounds: tuple[float, ...] = ()  # of all blocks

    @property
    def is_same(self) -> bool:
        """True if both have the same APR in every world."""
        return bool((self.found == self.greedy).all())

    @property
    def answer(self) -> FloatArray:
        """APR of what `place-rsus` answers in each fresh world, (n_judged,)."""
        return self.greedy if self.takes_greedy else self.found

    @property
    def found_ahead(self) -> tuple[float, float]:
        """95 % interval of the difference of found and greedy, by what was chosen for."""
        if self.chosen.tail == 1.0:
            estimate = estimate_mean(self.found - self.greedy, bounds=(-1.0, 1.0))
            return estimate.low, estimate.high
        values = resampled_cvar([self.found, self.greedy], self.chosen.tail)
        low, high = np.quantile(values[0] - values[1], [0.025, 0.975])
        return float(low), float(high)

    @property
    def ahead(self) -> tuple[float, float]:
        """The same of the answer: nothing where it is greedy choice's."""
        return (0.0, 0.0) if self.takes_greedy else self.found_ahead

    def cells(self) -> list[str]:
        """Of the table."""
        one = self.chosen
        gap = "-"
        if len(self.bounds) > 1:
            estimate = estimate_gap(self.bounds, self.answer.tolist())
            gap = f"{_points(estimate.gap)} ({_points(estimate.bias)})"
        is_mean = one.tail == 1.0
        measured = [cvar(values, one.tail) for values in (self.found, self.greedy, self.answer)]
        error = self.answer.std(ddof=1) / np.sqrt(len(self.answer))
        low, high = self.found_ahead
        answer = "same" if self.is_same else "greedy" if self.takes_greedy else "found"
        return [
            str(one.budget),
            place_name(self.where.n_worlds, one.given),
            "mean" if is_mean else "worst quarter",
            percent(one.value) + ("" if one.bound <= one.value + 1.0e-9 else " (not proven)"),
            percent(measured[0]),
            "same" if one.found == one.greedy else percent(measured[1]),
            "-" if self.is_same else f"{_points(low)} to {_points(high)}",
            answer,
            percent(measured[2]) + (f" ± {_points(error)}" if is_mean else ""),
            gap,
            f"{one.processor_s:.0f}",
            f"{one.memory_mib:.0f}",
        ]


_COLUMNS = (
    *("units", "chosen in", "for", "value there", "found, in fresh worlds", "greedy there"),
    *("found ahead of greedy, 95 %", "the answer", "the answer in fresh worlds"),
    *("its gap, and bias", "processor s", "MiB"),
)


def place_name(n_worlds: int, given: float) -> str:
    """What a layout was chosen in, and whether some APR was given up."""
    if n_worlds:
        return f"{n_worlds} worlds"
    return "plan, default" if given else "plan, highest APR"


def _points(share: float) -> str:
    return f"{100.0 * share:.2f}"


def rows_of(study: Study, records: Records, scene: str, cars: str) -> tuple[list[Row], list[str]]:
    """Rows of the table of a scene, in its order, and in words those that are still missing."""
    plan = Where(scene=scene, cars=cars, n_worlds=0)
    fresh, deciding = (some.get(plan.name, {}) for some in (records.fresh, records.deciding))
    rows, missing = [], []
    for where in study.wheres():
        is_other = (where.scene, where.cars, where.block) != (scene, cars, 0)
        if is_other or where.name in records.too_large:
            continue
        blocks = [replace(where, block=block) for block in range(study.n_blocks)]
        have = {one.wanted: one for one in records.chosen.get(where.name, [])}
        for wanted in study.wanted(where):
            one = have.get(wanted)
            keys = [_key(one.found), _key(one.greedy)] if one else []
            judged = [np.array(fresh.get(key, ())[: study.n_judged]) for key in keys]
            told = [deciding.get(key, []) for key in keys if one and one.asks_worlds]
            if one is None or min(map(len, judged)) < study.n_judged or not all(told):
                budget, tail, given = wanted
                what = "" if tail == 1.0 else ", worst quarter"
                missing.append(f"{budget} in {place_name(where.n_worlds, given)}{what}")
                continue
            alike = [
                other.bound
                for block in blocks
                for other in records.chosen.get(block.name, [])
                if other.wanted == wanted
            ]
            rows.append(
                Row(
                    where=where,
                    chosen=one,
                    found=judged[0],
                    greedy=judged[1],
                    takes_greedy=bool(told) and is_preferred(greedy=told[1], found=told[0]),
                    bounds=tuple(alike) if where.n_worlds and one.tail == 1.0 else (),
                )
            )
    return sorted(rows, key=lambda row: (row.chosen.budget, -row.chosen.tail)), missing


def _one(records: Records, where: Where, budget: int, given: float = 0.0) -> Chosen:
    """The layout for the mean."""
    wanted = (budget, TAILS[0], given)
    return next(one for one in records.chosen[where.name] if one.wanted == wanted)


def _sight_rows(study: Study, records: Records, scene: str) -> Iterator[list[str]]:
    """Layouts chosen with cars of either kind, valued with cars of both kinds."""
    wheres = [Where(scene=scene, cars=cars, n_worlds=0) for cars in CARS]
    places = [(0, 0.0), (0, GIVE_UP), *((n_worlds, 0.0) for n_worlds in study.samples)]
    for budget, (n_worlds, given), chosen_for in product(study.budgets, places, CARS):
        where = Where(scene=scene, cars=chosen_for, n_worlds=n_worlds)
        if where.name in records.too_large:
            continue
        key = _key(_one(records, where, budget, given).found)
        cells = [str(budget), place_name(n_worlds, given), chosen_for]
        for judged in wheres:
            whole, failed = records.planned[judged.name][key]
            fresh = np.array(records.fresh[judged.name][key][: study.n_judged])
            cells += [percent(whole), percent(failed), percent(fresh.mean())]
        yield cells


_NAMES = {BLIND: "units alone", SEE: "with the car"}
_MARKS = {BLIND: "o", SEE: "s"}
_STYLES = {BLIND: "-", SEE: "--"}


def plot_sight(study: Study, records: Records, scene: str) -> Figure:
    """What is not prevented as planned, over the number of units, for cars of either kind."""
    figure = new_figure(WIDTH_IN, 0.45 * WIDTH_IN)
    for judged, axes in zip(CARS, figure.subplots(1, len(CARS)), strict=True):
        values = records.planned[Where(scene=scene, cars=judged, n_worlds=0).name]
        for cars in CARS:
            plan = Where(scene=scene, cars=cars, n_worlds=0)
            keys = [_key(_one(records, plan, budget).found) for budget in study.budgets]
            left = [100.0 * (1.0 - values[key][0]) for key in keys]
            axes.plot(
                *(study.budgets, left),
                color=BLUE if cars == BLIND else "black",
                marker=_MARKS[cars],
                linestyle=_STYLES[cars],
                markerfacecolor="none" if cars == SEE else BLUE,
                label=f"chosen for cars that {'see' if cars == SEE else 'are blind'}",
            )
        axes.set_ylim(0.0, max(1.0, *axes.get_ylim()))
        axes.set_xticks(study.budgets)
        axes.set_title(_NAMES[judged])
        axes.set_xlabel("units")
        axes.set_ylabel("not prevented [%]")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center", ncol=2)
    return figure


def plot_layouts(study: Study, records: Records, compute: Compute) -> Figure:
    """Layouts of the plan, of greedy choice and of worlds, at the first scene."""
    scene, budget = study.scenes[0], max(study.budgets)
    plan = Where(scene=scene, cars=BLIND, n_worlds=0)
    assembly = _assembly(replace(study.question, budget=budget), plan, compute)
    every, _ = rows_of(study, records, scene, BLIND)
    rows = [row for row in every if (row.chosen.budget, row.chosen.tail) == (budget, TAILS[0])]
    shown = {
        place_name(row.where.n_worlds, row.chosen.given): (row.chosen.found, row.found)
        for row in (*rows[:2], rows[-1])
    }
    shown["plan, greedy"] = rows[0].chosen.greedy, rows[0].greedy
    figure = new_figure(len(shown) * WIDTH_IN, 1.3 * WIDTH_IN)
    columns = figure.subplots(1, len(shown))
    for (name, (chosen, values)), axes in zip(shown.items(), columns, strict=True):
        layout = pick_layout(assembly.candidates, chosen, name)
        plot_plan(assembly.setting, layout, axes=axes)
        axes.set_title(f"{name}: {percent(float(values.mean()))} in fresh worlds")
    return figure


def describe(study: Study, records: Records, pictures: Mapping[str, str]) -> str:
    """What is done, as Markdown; pictures by "layouts" and by the names of scenes."""
    found = {
        (scene, cars): rows_of(study, records, scene, cars)
        for cars, scene in product(study.cars, study.scenes)
    }
    rows = [row for some, _ in found.values() for row in some]
    missing = {where: some for where, (_, some) in found.items() if some}
    lines = [
        "# Where to choose, and for which cars",
        "",
        f"{_headline(study, rows)} {_of_default(rows)}",
        "",
        f"Detector `{study.question.detector}`, seed 0. Each fresh world has four draws of "
        "detections. `value there` is the mean APR, or that of the worst quarter, in the worlds "
        "that were chosen in; the gap is what the answer may lack of the best over all worlds at "
        f"most, with 95 %, by {study.n_blocks} blocks of worlds; its bias is what more worlds in a "
        "block or a better layout would take away. Processor seconds have those of the table.",
        "",
        *(f"Not in the memory of this machine: {name}." for name in records.too_large),
        *(
            f"Not done yet for {scene_name(scene)}, cars {cars} (units in): {'; '.join(some)}."
            for (scene, cars), some in missing.items()
        ),
        "",
    ]
    for (scene, cars), (some, _) in found.items():
        lines += [f"## {scene_name(scene)}, cars {cars}", ""]
        lines += [*markdown_table(_COLUMNS, (row.cells() for row in some)), ""]
    valued = [
        f"{what}, {judged}"
        for judged in ("units alone", "with the car")
        for what in ("plan", "one unit failed", "fresh worlds")
    ]
    for scene in [one for one in study.scenes if scene_name(one) in pictures]:
        lines += [f"## {scene_name(scene)}: see or blind", ""]
        columns = ["units", "chosen in", "cars", *valued]
        lines += [*markdown_table(columns, _sight_rows(study, records, scene)), ""]
        lines += [f"![not prevented, by units]({pictures[scene_name(scene)]})", ""]
    if "layouts" in pictures:
        lines += [f"![plan, greedy, worlds]({pictures['layouts']})", ""]
    return "\n".join(lines)


def _headline(study: Study, rows: Sequence[Row]) -> str:
    """How answers do against greedy choice."""
    told = [row for row in rows if not row.is_same]
    behind = [row for row in told if row.ahead[1] < 0.0]
    in_worlds = [row for row in behind if row.where.n_worlds]
    n_before = sum(row.ahead[0] > 0.0 for row in told)
    return (
        f"In {study.n_judged} fresh worlds the answer is behind greedy choice, beyond chance, in "
        f"{len(behind)} of {len(told)} settings ({len(in_worlds)} of them chosen in worlds), and "
        f"ahead in {n_before}; in {sum(row.takes_greedy for row in told)} it is greedy choice's, "
        f"which is better in {N_JUDGED} other worlds. The layout found is behind in "
        f"{sum(row.found_ahead[1] < 0.0 for row in told)}. By chance alone a difference of nothing "
        f"looks like one behind in 2.5 %. Where both are the same, nothing is compared."
    )


def _of_default(rows: Sequence[Row]) -> str:
    """How the default does against greedy choice."""
    ours = [row for row in rows if row.chosen.given and not row.is_same]
    ahead = [100.0 * float((row.answer - row.greedy).mean()) for row in ours]
    n_behind = sum(row.ahead[1] < 0.0 for row in ours)
    n_before = sum(row.ahead[0] > 0.0 for row in ours)
    if not ours:
        return "The default chooses as greedy choice does."
    return (
        f"The default of `place-rsus` is behind in {n_behind} of its {len(ours)}, ahead in "
        f"{n_before}: {np.mean(ahead):+.2f} points in the mean, {min(ahead):+.2f} at worst."
    )


def _numbers(text: str, *, least: int = 1) -> tuple[int, ...]:
    try:
        numbers = tuple(int(part) for part in text.split(",") if text or least)
    except ValueError:
        numbers = ()
    if len(numbers) < least or min(numbers, default=1) < 1:
        raise click.UsageError(f"got {text!r}; expected whole numbers from 1 on, such as 1,2,3")
    return numbers


@click.command()
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
@click.option("--map", "maps", multiple=True, help="A map beside the study's junction; repeatable.")
@click.option("--detector", default="response", show_default=True, help="Of cameras.")
@click.option("--units", default="1,2,3", show_default=True, help="Budgets.")
@click.option(
    "--samples", default="4,8,16", show_default=True, help="Worlds to choose in; may be empty."
)
@click.option(
    "--cars", multiple=True, type=click.Choice(CARS), default=CARS, help="For whom; repeatable."
)
@click.option("--worst-quarter/--mean-only", default=True, help="What to choose for.")
@click.option("--blocks", type=click.IntRange(1), default=5, show_default=True)
@click.option("--judge", "n_judged", type=click.IntRange(2), default=60, show_default=True)
@click.option("--speeds", default="", help="VUT speeds; default: those of the question.")
@click.option("--time-limit", type=click.FloatRange(1.0), default=120.0, show_default=True)
@click.option("--hours", type=click.FloatRange(0.0), help="Begin no part later; default: all.")
@click.option("--workers", type=click.IntRange(1), default=2, show_default=True, help="Threads.")
@click.option(
    "--out", type=click.Path(path_type=Path), default="results/worlds.md", show_default=True
)
def main(
    *,
    folder: Path,
    maps: tuple[str, ...],
    detector: str,
    units: str,
    samples: str,
    cars: tuple[str, ...],
    worst_quarter: bool,
    blocks: int,
    n_judged: int,
    speeds: str,
    time_limit: float,
    hours: float | None,
    workers: int,
    out: Path,
) -> None:
    """Choose and judge layouts in sampled worlds; FOLDER has what is done, and is gone on with."""
    study = Study(
        question=Question(detector=detector, speeds=speeds, time_limit_s=time_limit),
        scenes=("", *maps),
        budgets=_numbers(units),
        samples=_numbers(samples, least=0),
        n_blocks=blocks,
        n_judged=n_judged,
        cars=cars,
        tails=TAILS if worst_quarter else TAILS[:1],
    )
    try:
        for name in maps:  # before anything is computed
            load_scene(name)
    except InputError as error:
        raise click.UsageError(str(error)) from None
    folder.mkdir(parents=True, exist_ok=True)
    progress = StageProgress()
    progress.start(quiet=False)
    compute = Compute(workers=workers, progress=progress, cache_folder=folder / "cache")
    path, figures = folder / "records.json", dict[str, Figure]()
    try:
        until_s = math.inf if hours is None else now_s() + 3600.0 * hours
        records = run(study, path, compute, until_s=until_s)
        if BLIND in cars:
            figures["layouts"] = plot_layouts(study, records, compute)
        for scene in study.scenes if set(cars) == set(CARS) else ():
            figures[scene_name(scene)] = plot_sight(study, records, scene)
    except TimeUp:
        click.echo(f"The time is up; the same command goes on with {folder}.")
        records = _read(path, study.question)
    except InputError as error:
        raise click.UsageError(str(error)) from None
    finally:
        progress.stop()
    pictures = {name: out.with_name(f"{out.stem}_{name}.png") for name in figures}
    for name, figure in figures.items():
        write_atomically(pictures[name], to_png(figure))
    names = {name: picture.name for name, picture in pictures.items()}
    write_atomically(out, describe(study, records, names))


if __name__ == "__main__":
    main()
