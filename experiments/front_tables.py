"""The front that ends with the layout of a report: what each further unit buys, and its proof."""

import math
from collections.abc import Mapping
from typing import Any, Literal, cast

from placement.layout import Certificate, Stage
from placement.optimiser import PlacementValue
from placement.optimiser.front import Front, FrontPoint, StageChoice

from .pareto_figures import plot_front
from .pictures import build_picture
from .sentences import NOTHING, number
from .tables import percent

_VALUES = PlacementValue._fields
_SHARES = ("apr", "apr_one_failed")
_COLUMNS = {
    "apr": "APR",
    "apr_one_failed": "APR if the most needed unit fails",
    "smallest_margin_s": "smallest time to spare (s)",
    "mean_margin_s": "mean time to spare (s)",
    "cost_eur": "cost (EUR)",
}


def read_front(summary: Mapping[str, Any]) -> Front:
    """A front from its plain object, without the rows of the detection table.

    Parameters
    ----------
    summary : mapping
        By :func:`experiments.pareto_jobs.summarise_front`, as it is or read back from JSON.
    """
    return Front(
        by=cast(Literal["units", "cost"], summary["by"]),
        points=tuple(_read_point(point) for point in summary["points"]),
        stages=cast(StageChoice, summary["optimised"]),
        settled=summary["settled"],
        refused=tuple((entry["units"], entry["reason"]) for entry in summary["refused"]),
        presolve=None,
    )


def _read_point(point: Mapping[str, Any]) -> FrontPoint:
    return FrontPoint(
        units=point["units"],
        pose_index=tuple(range(len(point["pose_ids"]))),
        value=PlacementValue(*(point[name] for name in _VALUES)),
        certificate=Certificate(
            stages=tuple(
                Stage(**{**stage, "bound": _known(stage["bound"]), "gap": _known(stage["gap"])})
                for stage in point["stages"]
            ),
            solver=point["solver"],
        ),
    )


def _known(value: float | None) -> float:
    """JSON has no infinity: it writes null."""
    return math.inf if value is None else value


def front_rows(front: Front) -> list[list[str]]:
    """A row for each point: what its layout is worth, and whether more is ruled out.

    Parameters
    ----------
    front : Front
        By units or by cost.

    Returns
    -------
    rows : list of list of str
        Units; the fields of :class:`placement.optimiser.PlacementValue`; the proof.
    """
    return [
        [
            str(point.units),
            *(_shown(name, getattr(point.value, name)) for name in _VALUES),
            _proof(point, front),
        ]
        for point in front.points
    ]


def _shown(name: str, value: float) -> str:
    if name in _SHARES:
        return percent(value)
    return f"{value:,.0f}" if name == "cost_eur" else number(value, 3)


def _proof(point: FrontPoint, front: Front) -> str:
    if point.is_proven:
        return "proven"
    stage = next(stage for stage in point.certificate.stages if stage.gap != 0.0)
    what = _COLUMNS.get(stage.name, stage.name)
    if not math.isfinite(stage.bound):
        return f"open: nothing is proven of the {what}"
    more = "less" if stage.name == "cost_eur" else "more"
    bound = f"{100.0 * stage.bound:.2f} %" if stage.name in _SHARES else number(stage.bound, 3)
    return f"open: {what} no {more} than {bound}"


def proof_sentences(front: Front) -> list[str]:
    """What is proven of a front, and what is not.

    Parameters
    ----------
    front : Front
        By units or by cost.
    """
    n_points, n_proven = len(front.points), sum(point.is_proven for point in front.points)
    objectives = (
        "in APR, then in what is left when the most needed unit fails, then in time to spare and "
        "cost"
        if front.stages == "all"
        else "in APR, then in what is left when the most needed unit fails"
    )
    among = "no other choice among the candidate poses is better on the detection table"
    allowed = "units" if front.by == "units" else "money"
    if n_points == 1:
        first = (
            f"Proven: {among}, {objectives}."
            if n_proven
            else f"Not proven: another choice may be better, {objectives}."
        )
    elif n_proven == n_points:
        first = f"All {n_points} points are proven: with as many {allowed}, {among}, {objectives}."
    elif n_proven:
        first = (
            f"{n_proven} of {n_points} points are proven: with as many {allowed}, {among}, "
            f"{objectives}. Of the others the table says what is still open."
        )
    else:
        first = (
            f"None of the {n_points} points is proven: of each the table says what is still open."
        )
    sentences = [first]
    if front.settled is not None and front.by == "units":
        sentences.append(f"Proven, too: from {front.settled:g} units on nothing grows any more.")
    return sentences


def front_part(summary: Mapping[str, Any] | None) -> dict[str, Any] | None:
    """What ``templates/front.html.j2`` shows.

    Parameters
    ----------
    summary : mapping or None
        By :func:`experiments.pareto_jobs.summarise_front`, of
        :func:`placement.optimiser.pareto.front_below`; None: the best was not what was asked for.
    """
    if summary is None:
        return None
    front = read_front(summary)
    rows = front_rows(front)
    proof = proof_sentences(front)
    return {
        "sentences": list(summary["sentences"]),
        "proof": proof,
        "table": {
            "caption": "The best layout for each number of units",
            "columns": ["units", *(_COLUMNS[name] for name in _VALUES), "proof"],
            "rows": rows,
        },
        "poses": [
            [str(point["units"]), _listed(point["pose_ids"]), _listed(_sites(point))]
            for point in summary["points"]
        ],
        "figure": build_picture(
            plot_front(front),
            title="What each further unit buys",
            caption="Every point is the best layout found for as many units; open markers and "
            "bars: what is not yet ruled out. " + " ".join(proof),
            alt="Curves over the number of units. "
            + "; ".join(
                f"{row[0]}: APR {row[1]}, {row[2]} if one fails, {row[3]} s to spare, {row[6]}"
                for row in rows
            )
            + ".",
        ),
    }


def _sites(point: Mapping[str, Any]) -> list[str]:
    return [unit["site"] or NOTHING for unit in point["layout"]]


def _listed(names: list[str]) -> str:
    return ", ".join(names) or NOTHING
