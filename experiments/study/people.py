"""Speeds and starts of people as measured: ``python -m experiments.study.people FOLDER``.

FOLDER is the VRU Trajectory Dataset of Aschaffenburg (folders ``pedestrians`` and ``cyclists``,
each with ``moving`` and ``starting``): one CSV file a person, columns timestamp, x, y. Prints the
section ``people`` of uncertainties, see ``placement/data/uncertainty.toml``.
"""

from collections.abc import Iterator
from pathlib import Path

import click
import numpy as np

from geometry.arrays import FloatArray
from geometry.errors import InputError, Unquoted, refuse
from geometry.files import read_text

PROBABILITY = (0.01, *(0.1 * n for n in range(1, 10)), 0.99)
_REACH_S = 0.5  # speeds are those over so long before and after: sway of a step is less
_STEP_S = 0.1
# A start leads from a fifth to four fifths of the speed that is kept then.
_FROM, _TO = 0.2, 0.8


def measure(folder: Path) -> str:
    """The section as TOML.

    A speed is the median of a person who moves all the time; a start the mean acceleration of
    one who sets off. Raises InputError: there is no such file, or one cannot be read.
    """
    lines = [f"probability = {_listed(PROBABILITY)}"]
    for name, place in (("pedestrian", "pedestrians"), ("cyclist", "cyclists")):
        moving = [np.median(speed) for speed in _speeds_mps(folder / place / "moving")]
        starts = [_start_mps2(speed) for speed in _speeds_mps(folder / place / "starting")]
        starts = [start for start in starts if np.isfinite(start)]
        speed_kmh = np.quantile(moving, PROBABILITY) * 3.6
        start_mps2 = np.quantile(starts, PROBABILITY)
        words = f"speed_kmh = {_listed(speed_kmh)}, start_mps2 = {_listed(start_mps2)}"
        lines.append(f"# {len(moving)} who move, {len(starts)} who start")
        lines.append(f"{name} = {{ {words} }}")
    return "\n".join(lines) + "\n"


def _listed(values: object) -> str:
    return "[" + ", ".join(f"{value:.3g}" for value in np.asarray(values).tolist()) + "]"


def _speeds_mps(folder: Path) -> Iterator[FloatArray]:
    paths = sorted(folder.glob("*.csv"))
    if not paths:
        refuse(str(folder), "no .csv file", "one for each person")
    for path in paths:
        rows = [line.split(",") for line in read_text(path, "a CSV file").splitlines()[1:]]
        try:
            time, *place = np.array([row[1:4] for row in rows], dtype=np.float64).T
        except ValueError as error:
            raise InputError(str(path), Unquoted(error), "number, timestamp, x, y") from None
        at = np.arange(time[0] + _REACH_S, time[-1] - _REACH_S, _STEP_S)
        if len(at):
            ends = [
                np.stack([np.interp(at + reach, time, axis) for axis in place])
                for reach in (-_REACH_S, _REACH_S)
            ]
            yield np.hypot(*(ends[1] - ends[0])) / (2.0 * _REACH_S)


def _start_mps2(speed_mps: FloatArray) -> float:
    """Mean acceleration of a start; not a number where there is none."""
    kept = float(np.percentile(speed_mps, 95.0))
    fast = np.flatnonzero(speed_mps >= _TO * kept)
    slow = np.flatnonzero(speed_mps[: fast[0]] < _FROM * kept)
    if not len(slow):
        return float("nan")
    return (_TO - _FROM) * kept / (_STEP_S * float(fast[0] - slow[-1]))


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
def main(folder: Path) -> None:
    """Print quantiles of walking and riding speeds, and of accelerations of starts."""
    try:
        click.echo(measure(folder), nl=False)
    except InputError as error:
        click.echo(str(error), err=True)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
