"""What a city costs beside its tasks: ``python -m experiments.bench.city_driver``.

A grid of streets has as many junctions as are asked for. One of them is solved; all get
its front, so that what is measured is the process that reads the map, makes the tasks,
takes the answers, chooses and writes.
"""

import logging
import os
import pickle
import resource
import tempfile
from collections.abc import Iterator
from functools import cache, partial
from math import ceil, sqrt
from pathlib import Path
from time import perf_counter
from unittest.mock import patch
from xml.sax.saxutils import quoteattr

import click
import msgspec

from placement.question import Question

from ..city import inputs, pages, run
from ..city.tasks import JunctionAnswer, JunctionTask, run_junction
from ..engine.start import EngineWish
from ..progress import StageProgress, tell

_FEW_RUNS = Question(cases="CPNC-50", along_arms="0", speeds="50")
_SEARCH = inputs.CitySearch(is_coarse=True, max_units=2, max_junction_s=3600.0)
_APART_M = 120.0
_LAMP_M = 6.0
# Of a degree; of longitude the same, at the equator.
_LATITUDE_M = 111_320.0
_ANSWER = "PLACE_RSUS_BENCH_ANSWER"


def write_grid(path: Path, n_junctions: int) -> None:
    """Write an OpenStreetMap file of streets that cross.

    With a lamp at each crossing.
    """
    n_columns = ceil(sqrt(n_junctions))
    n_rows = ceil(n_junctions / n_columns)
    with path.open("w") as file:
        file.write('<osm version="0.6">\n')
        file.writelines(_lines(n_columns, n_rows))
        file.write("</osm>\n")


def _lines(n_columns: int, n_rows: int) -> Iterator[str]:
    """Nodes first, then ways: the crossings, an end of each street, and lamps."""

    def number(column: int, row: int) -> int:
        return (row + 1) * (n_columns + 2) + column + 2

    def node(number: int, x_m: float, y_m: float, **tags: str) -> str:
        place = f'lat="{y_m / _LATITUDE_M:.9f}" lon="{x_m / _LATITUDE_M:.9f}"'
        inner = _tags(tags)
        return f'<node id="{number}" {place}>{inner}</node>\n'

    n_nodes = (n_columns + 2) * (n_rows + 2) + 2
    for row in range(-1, n_rows + 1):
        for column in range(-1, n_columns + 1):
            x_m = _APART_M * column
            y_m = _APART_M * row
            yield node(number(column, row), x_m, y_m)
            yield node(
                n_nodes + number(column, row),
                x_m + _LAMP_M,
                y_m + _LAMP_M,
                highway="street_lamp",
            )
    along = [
        [number(column, row) for column in range(-1, n_columns + 1)]
        for row in range(n_rows)
    ]
    across = [
        [number(column, row) for row in range(-1, n_rows + 1)]
        for column in range(n_columns)
    ]
    for index, nodes in enumerate([*along, *across], start=1):
        refs = "".join(f'<nd ref="{one}"/>' for one in nodes)
        tags = _tags({"highway": "residential", "name": f"Street {index}"})
        yield f'<way id="{index}">{refs}{tags}</way>\n'


def _tags(tags: dict[str, str]) -> str:
    return "".join(
        f'<tag k="{key}" v={quoteattr(value)}/>' for key, value in tags.items()
    )


def answer_recorded(task: JunctionTask) -> JunctionAnswer:
    """Record of the junction of a task, with the front that was solved once."""
    recorded = _recorded(os.environ[_ANSWER])
    junction = task.chosen.junction
    record = msgspec.structs.replace(
        recorded.record, key=task.key, id=junction.id, name=junction.name
    )
    return JunctionAnswer(record, recorded.files)


@cache
def _recorded(path: str) -> JunctionAnswer:
    answer: JunctionAnswer = pickle.loads(Path(path).read_bytes())
    return answer


def _record_first(task: JunctionTask) -> JunctionAnswer:
    """Solve a junction, and keep its answer for all others, in whatever process."""
    answer = run_junction(task)
    assert not answer.record.reason, answer.record.reason
    Path(os.environ[_ANSWER]).write_bytes(pickle.dumps(answer))
    return answer


def measure(
    n_junctions: int, engine: EngineWish, folder: Path, *, n_pages: int
) -> dict[str, float]:
    """Processor seconds and memory of a city of which every front is recorded."""
    os.environ[_ANSWER] = str(folder / "answer")
    small = folder / "small.osm"
    write_grid(small, 2)
    run_once = partial(
        run.run_city,
        _FEW_RUNS,
        search=_SEARCH,
        seed=0,
        command="",
        tell=lambda sentence: None,
    )
    with patch.object(run, "run_junction", _record_first):
        run_once(
            maps=[small],
            wish=inputs.CityWish(budget_units=1),
            engine=EngineWish(workers=2),  # in processes: memory here is the driver's
            out=folder / "small",
            progress=StageProgress(),
        )
    path = folder / "grid.osm"
    write_grid(path, n_junctions)
    before_s = _own_cpu_s()
    began_s = perf_counter()
    with (
        patch.object(run, "run_junction", answer_recorded),
        patch.object(pages, "MAX_ROWS", n_pages),
    ):
        result = run_once(
            maps=[path],
            wish=inputs.CityWish(budget_units=n_junctions // 2),
            engine=engine,
            out=folder / "city",
            progress=StageProgress(),
        )
    return {
        "junctions": len(result.junctions),
        "cpu_s": round(_own_cpu_s() - before_s, 1),
        "peak_memory_mib": round(_peak_mib()),
        "wall_s": round(perf_counter() - began_s, 1),
        **{f"{name} (wall)": seconds for name, seconds in result.seconds.items()},
    }


def _own_cpu_s() -> float:
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def _peak_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


@click.command()
@click.option("--junctions", type=int, default=100, show_default=True)
@click.option("--workers", type=int, default=1, show_default=True)
@click.option(
    "--pages",
    "n_pages",
    type=int,
    default=pages.MAX_ROWS,
    show_default=True,
    help="At most.",
)
@click.option("--scheduler", default="", help='"local": by dask on this machine.')
def main(junctions: int, workers: int, n_pages: int, scheduler: str) -> None:
    """Measure a city of recorded fronts; a call each, for the peak of memory."""
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    wish = EngineWish(workers=workers, scheduler=scheduler, max_bytes=2**30)
    with tempfile.TemporaryDirectory() as folder:
        figures = measure(junctions, wish, Path(folder), n_pages=n_pages)
    for name, value in figures.items():
        tell(f"{name}: {value:g}")


if __name__ == "__main__":
    main()
