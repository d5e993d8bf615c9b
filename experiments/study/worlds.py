"""How a layout should be chosen: ``python -m experiments.study.worlds FOLDER``.

For cars that see or are blind, as planned or in sampled worlds, by the mean or the worst quarter:
what is found is judged in fresh worlds that nothing was chosen in, beside greedy choice.
"""

import math
import resource
import time
from collections.abc import Callable, Iterator, Sequence
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
from placement.optimiser import presolve, solve_greedy, solve_placement, solve_sturdily
from placement.optimiser.problem import apr, apr_one_failed
from placement.pipeline import Assembly, assemble, pick_layout
from placement.question import BLIND, SEE, Question
from placement.sampling.out_of_sample import (
    cvar,
    estimate_mean,
    out_of_sample_layouts,
    resampled_cvar,
)
from placement.wishes import GIVE_UP

from ..figures.axes import BLUE, WIDTH_IN, new_figure, to_png
from ..figures.plan import plot_plan
from ..progress import StageProgress
from ..results.numbers import percent
from ..results.tables import markdown_table

CARS = (BLIND, SEE)
TAILS = (1.0, 0.25)
N_AT_ONCE = 10  # fresh worlds between two savings
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
        if given:
            highest, sturdy = solve_sturdily(
                problem, reduced, give_up=given, effort=assembly.effort
            )
            solution = sturdy or highest
        else:
            # Of further blocks the bound alone counts.
            n_stages = 1 if where.block else None
            solution = solve_placement(problem, reduced, effort=assembly.effort, n_stages=n_stages)
        stages = {stage.name: stage for stage in solution.certificate.stages}
        chosen.append(
            Chosen(
                budget=budget,
                tail=tail,
                given=given,
                found=tuple(sorted(solution.pose_index)),
                greedy=tuple(sorted(solve_greedy(problem, reduced))),
                value=stages["apr"].objective,
                bound=min(1.0, stages["apr"].bound),
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
    question: Question, where: Where, layouts: Sequence[Rows], first: int, compute: Compute
) -> dict[str, list[float]]:
    """APR of layouts in each of the next fresh worlds."""
    assembly = _assembly(replace(question, budget=1), where, compute)
    assert assembly.uncertainty is not None  # `where` has worlds
    found = out_of_sample_layouts(
        assembly.setting,
        [pick_layout(assembly.candidates, rows, _key(rows)) for rows in layouts],
        assembly.uncertainty,
        n_samples=N_AT_ONCE,
        first=first,
        fusion=assembly.fusion,
        compute=compute,
    )
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

    def wheres(self) -> Iterator[Where]:
        """All worlds to choose in; the plan first."""
        for scene, cars in product(self.scenes, CARS):
            yield Where(scene=scene, cars=cars, n_worlds=0)
            for n, block in product(self.samples, range(self.n_blocks)):
                yield Where(scene=scene, cars=cars, n_worlds=n, block=block)

    def wanted(self, where: Where) -> list[Wanted]:
        """Tails in the first block alone, where they have two worlds; on the plan the default."""
        has_tail = where.n_worlds * TAILS[1] >= 2.0 and where.block == 0
        given = (0.0,) if where.n_worlds else (0.0, GIVE_UP)
        return [*product(self.budgets, TAILS if has_tail else TAILS[:1], given)]

    def layouts(self, records: Records, scene: str, cars: str) -> list[Rows]:
        """Layouts to judge: those of the first blocks, and with other cars the best ones alone."""
        found: dict[Rows, None] = {}
        for where in self.wheres():
            if where.scene == scene and where.block == 0:
                for one in records.chosen.get(where.name, []):
                    found[one.found] = None
                    if where.cars == cars:
                        found[one.greedy] = None
        return [*found]


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

    wheres = [*study.wheres()]
    for index, where in enumerate(wheres):
        compute.progress("choose", index, len(wheres))
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
    for scene, cars in product(study.scenes, CARS):
        layouts = study.layouts(records, scene, cars)
        plan = Where(scene=scene, cars=cars, n_worlds=0)
        planned = records.planned.setdefault(plan.name, {})
        if new := [rows for rows in layouts if _key(rows) not in planned]:
            planned |= in_own_process(plan_values, study.question, plan, new, compute)
            save()
        fresh = records.fresh.setdefault(plan.name, {})
        for first in range(0, study.n_judged, N_AT_ONCE):
            compute.progress(f"judge {plan.name}", first, study.n_judged)
            if new := [rows for rows in layouts if len(fresh.get(_key(rows), ())) <= first]:
                some = in_own_process(
                    judge, study.question, replace(plan, n_worlds=1), new, first, compute
                )
                for key, values in some.items():
                    fresh[key] = [*fresh.get(key, [])[:first], *values]
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
    """A layout that was found, and greedy choice, in fresh worlds."""

    where: Where
    chosen: Chosen
    found: FloatArray  # (n_judged,): APR in each fresh world
    greedy: FloatArray
    bounds: tuple[float, ...]  # of all blocks

    @property
    def is_same(self) -> bool:
        """True if both have the same APR in every world."""
        return bool((self.found == self.greedy).all())

    @property
    def ahead(self) -> tuple[float, float]:
        """95 % interval of the difference of found and greedy, by what was chosen for."""
        if self.chosen.tail == 1.0:
            estimate = estimate_mean(self.found - self.greedy, bounds=(-1.0, 1.0))
            return estimate.low, estimate.high
        values = resampled_cvar([self.found, self.greedy], self.chosen.tail)
        low, high = np.quantile(values[0] - values[1], [0.025, 0.975])
        return float(low), float(high)

    def cells(self) -> list[str]:
        """Of the table."""
        one = self.chosen
        gap = "-"
        if len(self.bounds) > 1:
            estimate = estimate_gap(self.bounds, self.found.tolist())
            gap = f"{_points(estimate.gap)} ({_points(estimate.bias)})"
        measured = [cvar(values, one.tail) for values in (self.found, self.greedy)]
        error = self.found.std(ddof=1) / np.sqrt(len(self.found))
        low, high = self.ahead
        return [
            str(one.budget),
            place_name(self.where.n_worlds, one.given),
            "mean" if one.tail == 1.0 else "worst quarter",
            percent(one.value) + ("" if one.bound <= one.value + 1.0e-9 else " (not proven)"),
            percent(measured[0]) + (f" ± {_points(error)}" if one.tail == 1.0 else ""),
            "same" if one.found == one.greedy else percent(measured[1]),
            "-" if self.is_same else f"{_points(low)} to {_points(high)}",
            gap,
            f"{one.processor_s:.0f}",
            f"{one.memory_mib:.0f}",
        ]


_COLUMNS = (
    *("units", "chosen in", "for", "value there", "in fresh worlds", "greedy there"),
    *("ahead of greedy, 95 %", "gap, and its bias", "processor s", "MiB"),
)


def place_name(n_worlds: int, given: float) -> str:
    """What a layout was chosen in, and whether some APR was given up."""
    if n_worlds:
        return f"{n_worlds} worlds"
    return "plan, default" if given else "plan, highest APR"


def _points(share: float) -> str:
    return f"{100.0 * share:.2f}"


def rows_of(study: Study, records: Records, scene: str, cars: str) -> list[Row]:
    """Rows of the table of a scene, in its order."""
    fresh = records.fresh[Where(scene=scene, cars=cars, n_worlds=0).name]
    rows = []
    for where in study.wheres():
        if (where.scene, where.cars, where.block) != (scene, cars, 0):
            continue
        blocks = [replace(where, block=block) for block in range(study.n_blocks)]
        for one in records.chosen[where.name]:
            alike = [
                other.bound
                for block in blocks
                for other in records.chosen.get(block.name, [])
                if other.wanted == one.wanted
            ]
            found, greedy = (np.array(fresh[_key(rows)]) for rows in (one.found, one.greedy))
            rows.append(
                Row(
                    where=where,
                    chosen=one,
                    found=found[: study.n_judged],
                    greedy=greedy[: study.n_judged],
                    bounds=tuple(alike) if where.n_worlds and one.tail == 1.0 else (),
                )
            )
    return sorted(rows, key=lambda row: (row.chosen.budget, -row.chosen.tail))


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
    fresh = records.fresh[plan.name]
    shown = {
        place_name(0, GIVE_UP): _one(records, plan, budget, GIVE_UP).found,
        place_name(0, 0.0): _one(records, plan, budget).found,
        "plan, greedy": _one(records, plan, budget).greedy,
    }
    in_worlds = [replace(plan, n_worlds=n_worlds) for n_worlds in study.samples]
    for where in [one for one in in_worlds if one.name not in records.too_large][-1:]:
        shown[place_name(where.n_worlds, 0.0)] = _one(records, where, budget).found
    figure = new_figure(len(shown) * WIDTH_IN, 1.3 * WIDTH_IN)
    for (name, rows), axes in zip(shown.items(), figure.subplots(1, len(shown)), strict=True):
        layout = pick_layout(assembly.candidates, rows, name)
        plot_plan(assembly.setting, layout, axes=axes)
        mean = np.mean(fresh[_key(rows)][: study.n_judged])
        axes.set_title(f"{name}: {percent(float(mean))} in fresh worlds")
    return figure


def describe(study: Study, records: Records, pictures: Sequence[str]) -> str:
    """All of it, as Markdown; pictures are of the layouts, then of each scene."""
    rows = {
        (scene, cars): rows_of(study, records, scene, cars)
        for scene, cars in product(study.scenes, CARS)
    }
    told = [row for some in rows.values() for row in some if not row.is_same]
    behind = [row for row in told if row.ahead[1] < 0.0]
    before = [row for row in told if row.ahead[0] > 0.0]
    in_worlds = [row for row in behind if row.where.n_worlds]
    lines = [
        "# Where to choose, and for which cars",
        "",
        f"In {study.n_judged} fresh worlds the layout found is behind greedy choice, beyond "
        f"chance, in {len(behind)} of {len(told)} settings ({len(in_worlds)} of them chosen in "
        f"worlds), and ahead in {len(before)}. Where both are the same, nothing is compared. "
        f"{_of_default(rows)}",
        "",
        f"Detector `{study.question.detector}`, seed 0. Each fresh world has four draws of "
        "detections. `value there` is the mean APR, or that of the worst quarter, in the worlds "
        "that were chosen in; the gap is what the layout may lack of the best over all worlds at "
        f"most, with 95 %, by {study.n_blocks} blocks of worlds; its bias is what more worlds in a "
        "block or a better layout would take away. Processor seconds have those of the table.",
        "",
        *(f"Not in the memory of this machine: {name}." for name in records.too_large),
        "",
    ]
    for scene, picture in zip(study.scenes, pictures[1:], strict=True):
        for cars in CARS:
            lines += [f"## {scene_name(scene)}, cars {cars}", ""]
            lines += [*markdown_table(_COLUMNS, (row.cells() for row in rows[scene, cars])), ""]
        lines += [f"## {scene_name(scene)}: see or blind", ""]
        valued = [
            f"{what}, {judged}"
            for judged in ("units alone", "with the car")
            for what in ("plan", "one unit failed", "fresh worlds")
        ]
        columns = ["units", "chosen in", "cars", *valued]
        lines += [*markdown_table(columns, _sight_rows(study, records, scene)), ""]
        lines += [f"![not prevented, by units]({picture})", ""]
    lines += [f"![plan, greedy, worlds]({pictures[0]})", ""]
    return "\n".join(lines)


def _of_default(rows: dict[tuple[str, str], list[Row]]) -> str:
    """How the default does against greedy choice."""
    ours = [row for some in rows.values() for row in some if row.chosen.given and not row.is_same]
    ahead = [100.0 * float((row.found - row.greedy).mean()) for row in ours]
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
        n_judged=-(-n_judged // N_AT_ONCE) * N_AT_ONCE,
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
    try:
        until_s = math.inf if hours is None else now_s() + 3600.0 * hours
        records = run(study, folder / "records.json", compute, until_s=until_s)
    except TimeUp:
        click.echo(f"The time is up; the same command goes on with {folder}.")
        return
    except InputError as error:
        raise click.UsageError(str(error)) from None
    finally:
        progress.stop()
    figures = [plot_layouts(study, records, compute)]
    figures += [plot_sight(study, records, scene) for scene in study.scenes]
    names = ["layouts", *map(scene_name, study.scenes)]
    pictures = [out.with_name(f"{out.stem}_{name}.png") for name in names]
    for picture, figure in zip(pictures, figures, strict=True):
        write_atomically(picture, to_png(figure))
    write_atomically(out, describe(study, records, [picture.name for picture in pictures]))


if __name__ == "__main__":
    main()
