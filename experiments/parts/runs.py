"""The runs: what is driven, and every outcome."""

import math
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from placement.evaluation import Evaluation, Outcome, run_outcome
from placement.setting import Setting
from scenarios.positions import AT_ZERO

from ..results.drives import describe_left_out, describe_limits, describe_places, lacking_room
from ..results.numbers import count_runs, number, percent
from ..results.tables import margin_s
from .accidents import is_weighted, several_weathers
from .section import Block, Box, Bullets, Section, Subheading, Table


def cases_section(setting: Setting) -> Section:
    """Cases that are driven, and those that cannot be."""
    note = [
        "Last moment: the latest time at which braking still avoids the impact, which would be at "
        "0; of each case's runs the earliest and the latest.",
        *describe_hopeless(setting),
    ]
    blocks: list[Block] = [" ".join(note), Box("cases", [case_table(setting)])]
    refusals = describe_refusals(setting)
    if refusals:
        blocks += [Subheading("Not driven"), Bullets(refusals)]
    return Section("cases", "What is driven", blocks)


def runs_section(evaluations: Mapping[str, Evaluation]) -> Section:
    """How every run ends."""
    note = (
        "Avoided, with the time to spare between the onset of braking and the last moment; or hit, "
        "with the time by which braking comes too late. Lost again: confirmed early enough, but "
        "not known any more at the last moment."
    )
    return Section("runs", "Every run", [note, run_table(evaluations)])


def case_table(setting: Setting) -> Table:
    """The cases driven: what, how fast, from where, how late to brake; and their weights."""
    has_weights = is_weighted(setting.axis)
    refused = [refusal.approach for refusal in setting.refusals]
    every = dict.fromkeys([*(run.approach for run in setting.runs), *refused])
    rows = []
    for name, indices in runs_by_case(setting).items():
        runs = [setting.runs[index] for index in indices]
        case = runs[0].case
        vru_speeds_kmh = sorted({run.case.vru_speed_kmh for run in runs})
        approaches = dict.fromkeys(run.approach for run in runs)
        last_s = [run.last_brake_time_s for run in runs if math.isfinite(run.last_brake_time_s)]
        rows.append(
            [
                name,
                case.title,
                f"{case.vru.name}, {_steps(vru_speeds_kmh)}\N{NO-BREAK SPACE}km/h",
                _steps(sorted({run.vut_speed_kmh for run in runs})),
                "all" if len(approaches) == len(every) > 1 else ", ".join(approaches),
                str(len(runs)),
                *([percent(float(setting.axis.weight[indices].sum()))] if has_weights else []),
                number(min(last_s, default=None)),
                number(max(last_s, default=None)),
            ]
        )
    columns = [
        "case",
        "what happens",
        "road user",
        "car (km/h)",
        "from",
        "runs",
        *(["weight"] if has_weights else []),
        "last moment, earliest (s)",
        "latest (s)",
    ]
    return Table(
        caption="Cases" + (f"; from all: {', '.join(every)}" if len(every) > 1 else ""),
        columns=columns,
        rows=rows,
        numeric=range(5, len(columns)),
    )


def _steps(values: Sequence[float]) -> str:
    """Ascending values: as a range where the steps between them are equal, else each."""
    steps = np.diff(values)
    if len(values) > 2 and np.allclose(steps, steps[0]):
        return f"{values[0]:g} to {values[-1]:g} by {steps[0]:g}"
    return ", ".join(f"{value:g}" for value in values)


def describe_hopeless(setting: Setting) -> list[str]:
    """Which cases have runs that no braking avoids, in sentences."""
    hopeless = [run for run in setting.runs if not math.isfinite(run.last_brake_time_s)]
    n_runs = Counter(run.case.name for run in hopeless)
    names = [name for name in runs_by_case(setting) if n_runs[name]]
    return [
        f"In {count_runs(n_runs[name])} of {name} no braking avoids the impact." for name in names
    ]


def describe_refusals(setting: Setting) -> list[str]:
    """What cannot be driven, and why; speeds are told at the junction alone."""
    places: dict[tuple[str, str, str], dict[str, list[str]]] = {}
    for refusal in lacking_room(setting):
        speeds = refusal.speeds_text if refusal.position == AT_ZERO.name else ""
        of_reason = places.setdefault((refusal.case.name, speeds, refusal.reason), {})
        of_reason.setdefault(refusal.approach, []).append(refusal.position)
    sentences = [
        f"{case} from the {describe_places(positions)}"
        + (f" at {speeds} km/h" if speeds else "")
        + f": {reason.removesuffix('.')}."
        for (case, speeds, reason), positions in places.items()
    ]
    return [*sentences, *describe_limits(setting), *describe_left_out(setting)]


def runs_by_case(setting: Setting) -> dict[str, list[int]]:
    """Indices of the runs of each case, in the order in which the cases first appear."""
    indices: dict[str, list[int]] = {}
    for index, run in enumerate(setting.runs):
        indices.setdefault(run.case.name, []).append(index)
    return indices


def run_table(evaluations: Mapping[str, Evaluation]) -> Table:
    """A row per run, the least time to spare first; the first evaluation is the subject."""
    subject = next(iter(evaluations.values()))
    axis = subject.axis
    verdicts = [*(item.headline for item in evaluations.values()), subject.vut]
    margins = [margin_s(verdict, axis) for verdict in verdicts]
    has_weathers, has_weights = bool(several_weathers(axis)), is_weighted(axis)
    rows = [
        [
            axis.run_ids[index],
            *([axis.weathers[index]] if has_weathers else []),
            *([percent(float(axis.weight[index]))] if has_weights else []),
            number(axis.last_brake_time_s[index]),
            *(
                outcome(run_outcome(verdict, axis, int(index)), float(margin[index]))
                for verdict, margin in zip(verdicts, margins, strict=True)
            ),
        ]
        for index in np.argsort(margins[0], kind="stable")
    ]
    columns = [
        "run",
        *(["weather"] if has_weathers else []),
        *(["weight"] if has_weights else []),
        "last moment (s)",
        *evaluations,
        "VUT",
    ]
    n_hit = int((~subject.headline.is_avoided).sum())
    hits = f", {n_hit} of them hit" if n_hit else ""
    return Table(
        caption="Runs: case / from / speed in km/h" + (" / weather" if has_weathers else ""),
        columns=columns,
        rows=rows,
        numeric=range(1, len(columns)),
        summary=f"{len(rows)} runs{hits}: those with the least time to spare first",
    )


def outcome(words: Outcome, margin_s: float) -> str:
    """How a run ends, with the time to spare or the time by which braking comes too late."""
    if words == "avoided":
        return f"avoided, {number(margin_s)} s"
    if words == "lost again":
        return "HIT, lost again"
    return f"HIT, {number(-margin_s)} s late" if math.isfinite(margin_s) else "HIT, not confirmed"
