"""Messages to the page: the junction once, then units and numbers whenever they change."""

import json
import shlex
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import msgspec
import numpy as np
from numpy.typing import NDArray

from geometry.arrays import FloatArray
from geometry.catalogue import Sensor, sensor_kind
from geometry.errors import InputError, check_one_of
from geometry.phrases import Phrase
from geometry.scene import Scene, Site
from geometry.sensors import CameraModel
from placement.candidates import CandidatePose, is_ring
from placement.detectors import DETECTOR_NAMES
from placement.evaluation import Evaluation, Verdict, apr, apr_by_case, run_outcomes
from placement.ground import BANDS, GroundCoverage, find_ground_coverage
from placement.layout import Layout
from placement.position_map import PositionMap, find_position_map
from placement.private_ground import PrivateGround, PrivateSight
from placement.question import BLIND, SEE, Question, question_fields, read_cars
from placement.setting import Setting, check_question
from placement.wishes import site_price_eur
from scenarios.cases import load_case_sets
from scenarios.runs import WEATHERS, FrameAxis, Run
from scenarios.weights import WEIGHT_WORDS, default_weights

from ..cli.options import JUDGED, option_of
from ..export.json import to_json_text
from ..figures.axes import describe_run
from ..language import mark, tr, trn
from ..parts.bill_of_materials import build_bill
from ..parts.player import centimetres, plan_record, svg_path, to_base64, unit_records
from ..results.numbers import euros, finite_or_none, percent
from ..results.record import build_evaluation_record
from .changes import mount_range_m
from .plan import History
from .requests import ChangeQuestion

BY_TABLE = "table"
BY_EVALUATOR = "evaluator"
# Private areas that are told: those that are seen the most
_MAX_AREAS = 200


def key_of(units: Sequence[CandidatePose]) -> tuple[object, ...]:
    """Key of a layout: equal for units that achieve the same together, one by one and by name.

    Parameters
    ----------
    units : sequence of CandidatePose
        The layout; their order counts.
    """
    keys = []
    for unit in units:
        pose = unit.pose
        east_m, north_m, up_m = pose.position_m.tolist()
        key = (
            unit.id,
            east_m,
            north_m,
            up_m,
            pose.yaw_deg,
            pose.pitch_deg,
            unit.sensor,
            unit.latency_s,
        )
        keys.append(key)
    return tuple(keys)


def scene_record(
    setting: Setting,
    *,
    models: Sequence[Sensor],
    chosen: Sequence[str],
    ground: PrivateGround | None = None,
    site_cost_eur: float | None = None,
) -> dict[str, Any]:
    """The constant part of a scene: plan, sites, runs, models of sensors.

    Parameters
    ----------
    setting : Setting
        Scene and runs.
    models : sequence of Sensor
        What can be mounted.
    chosen : sequence of str
        Names of the models that the optimiser may mount.
    ground : PrivateGround, optional
        Areas that no camera may have in its picture.
    site_cost_eur : float, optional
        Of every site, where the question says it. [EUR]
    """
    scene = setting.scene
    private = []
    if ground is not None:
        private = _private_areas(ground)
    return {
        "name": scene.name,
        "plan": plan_record(scene),
        "sites": [_site_record(site, site_cost_eur) for site in scene.sites],
        "sensors": [_sensor_record(model) for model in models],
        "grid": list(chosen),
        "runs": _run_records(setting),
        "cases": {run.case.name: tr(run.case.title) for run in setting.runs},
        "arms": _arm_records(setting),
        "bands": [name for name, _ in BANDS],
        "private": private,
    }


def _sensor_record(model: Sensor) -> dict[str, Any]:
    return {
        "name": model.name,
        "kind": sensor_kind(model),
        "price": model.price_eur,
        "isRing": is_ring(model),
    }


def _run_records(setting: Setting) -> list[dict[str, Any]]:
    """Each run: its name in words, where it ends, and its share of the weight of all."""
    axis = setting.axis
    total = axis.weight.sum()
    records = []
    for index, run in enumerate(setting.runs):
        record = {
            "id": run.id,
            "title": describe_run(axis, index),
            "frames": len(run.time_s),
            "ends": centimetres(run.vru_position_m[-1]),
            "weight": float(axis.weight[index] / total),
        }
        records.append(record)
    return records


def _site_record(
    site: Site, site_cost_eur: float | None, *, is_own: bool = False
) -> dict[str, Any]:
    low_m, high_m = site.height_range_m.tolist()
    price = euros(site_price_eur(site, site_cost_eur))
    if site_cost_eur is None and site.cost_eur == 0.0:
        price = tr("{price} (assumed)", price=price)
    return {
        "id": site.id,
        "kind": tr(site.kind),
        "place": centimetres(site.position_m[:2]),
        "low": low_m,
        "high": high_m,
        "capacity": site.capacity_units,
        "price": price,
        "isForbidden": site.use == "forbidden",
        "isOwn": is_own,
    }


def _private_areas(ground: PrivateGround) -> list[dict[str, str]]:
    """Each private area, with its outline as an SVG path in centimetres."""
    records = []
    for name, shape in zip(ground.names, ground.shapes, strict=True):
        records.append({"name": name, "path": svg_path(shape)})
    return records


def _arm_records(setting: Setting) -> list[dict[str, Any]]:
    """Every approach and position that is driven: the VUT's way, and where the impacts are."""
    found: dict[tuple[str, str], list[Run]] = {}
    for run in setting.runs:
        found.setdefault((run.approach, run.position), []).append(run)
    records = []
    for (approach, position), runs in found.items():
        impacts_m = np.mean([run.vut_position_m[-1] for run in runs], axis=0)
        longest = max(runs, key=lambda run: len(run.time_s))
        record = {
            "approach": tr(approach),
            "position": position,
            "place": centimetres(impacts_m),
            "way": centimetres(longest.vut_position_m),
        }
        records.append(record)
    return records


# ---------- what is asked


def change_question(
    question: Question, change: ChangeQuestion, begun: Question
) -> Question:
    """A question with what a browser changes.

    Parameters
    ----------
    question : Question
        Before it.
    change : ChangeQuestion
        The request; what it does not give stays as it is.
    begun : Question
        The question of the command line: browsers choose no other files than it names.

    Raises
    ------
    InputError
        A value is none that can be chosen.
    """
    asked = msgspec.structs.asdict(change)
    given = {name: value for name, value in asked.items() if value is not msgspec.UNSET}
    for name in (mark("detector"), mark("weights")):
        if name in given:
            check_one_of(name, given[name], _choices(begun)[name])
    # A file of cases would be read from this machine, whoever asks.
    cases = given.get("cases", "")
    if ".toml" in cases.lower() and cases != begun.cases:
        raise InputError(mark("cases"), cases, mark("sets and names of cases"))
    changed = replace(question, **given)
    if 0.0 < read_cars(changed.cars) < 1.0:
        expected = Phrase(
            "{one} or {other}: the page shows each run once", one=BLIND, other=SEE
        )
        raise InputError(mark("cars"), changed.cars, expected)
    # The detector is one of the choices, and may be a network that is slow to load.
    check_question(replace(changed, detector=DETECTOR_NAMES[0]))
    return changed


_OF_LAYOUT = (
    "case_range",
    "protect",
    "along_arms",
    "speeds",
    "approaches",
    "packet_loss",
    "n_confirmations",
    "track_memory_s",
    "latency_s",
    "deceleration_mps2",
    "build_up_s",
)
"""What a layout's own question says of runs and braking beside what the page can change.

None of it names a file: one that is sent must not make the server read another.
"""


def take_question(question: Question, found: Question, begun: Question) -> Question:
    """A question with what is driven, seen and judged in another one.

    Parameters
    ----------
    question : Question
        What the page asks now; its scene, sensors and prices stay.
    found : Question
        The one that a layout was found for, as a browser sent it.
    begun : Question
        The question of the command line: browsers choose no other files than it names.

    Raises
    ------
    InputError
        The page cannot ask this.
    """
    taken = {name: getattr(found, name) for name in _OF_LAYOUT}
    fields = ChangeQuestion.__struct_fields__
    change = ChangeQuestion(**{name: getattr(found, name) for name in fields})
    return change_question(replace(question, **taken), change, begun)


def _choices(begun: Question) -> dict[str, list[str]]:
    """Words that a browser may choose of, by field: those known, and the session's own."""
    known = {
        "detector": DETECTOR_NAMES,
        "weights": ("", *WEIGHT_WORDS),
        "cars": (BLIND, SEE),
    }
    choices = {}
    for name, words in known.items():
        each_once = dict.fromkeys([*words, getattr(begun, name)])
        choices[name] = list(each_once)
    return choices


_MEANINGS = {
    "case": mark(
        "Mean over cases, each averaged over approaches, positions and runs; not "
        "a mean over all runs."
    ),
    "run": mark(
        "Share of all runs: each counts the same, so cases with more runs count more."
    ),
    "fhwa-crash-types": mark(
        "Cases are weighted by how often cars hit people in this way, not by "
        "their number of runs."
    ),
    "euroncap-rating-2026": mark(
        "Cases are weighted by Euro NCAP points, not by their number of runs."
    ),
}
"""What weights mean, by their names."""


def question_record(question: Question, begun: Question) -> dict[str, Any]:
    """What the page lets choose of a question, and how the numbers are made again elsewhere.

    Parameters
    ----------
    question : Question
        What is asked now.
    begun : Question
        The question of the command line: its own files can be chosen, too.

    Returns
    -------
    dict
        For the page: values now, choices, what the weights mean, and the command.
    """
    names = msgspec.structs.fields(ChangeQuestion)
    weights = question.weights or default_weights(question.cases)
    meaning = tr("Runs are weighted by {name}.", name=weights)
    if weights in WEIGHT_WORDS:
        meaning = tr(_MEANINGS[weights])
    return {
        "now": {field.name: getattr(question, field.name) for field in names},
        "choices": {
            **_choices(begun),
            "weather": WEATHERS,
            "cases": [*load_case_sets()],
        },
        "defaultWeights": default_weights(question.cases),
        "meaning": meaning,
        "command": evaluate_command(question),
    }


def evaluate_command(question: Question) -> str:
    """Command that evaluates the saved layout, as a shell takes it.

    It has every option of what is driven and judged that differs from its default.
    """
    # The page saves the layout under this name.
    return (
        f"place-rsus evaluate --layout layout.json {question_words(question)}".strip()
    )


def question_words(question: Question) -> str:
    """Options of what is driven and judged that differ from their defaults."""
    words = []
    for field in question_fields().values():
        value = getattr(question, field.name)
        if field.name not in ("no_look", *JUDGED) or value == field.default:
            continue
        words.append(option_of(field))
        # A flag stands alone.
        if value is not True:
            words.append(f"{value}")
    return shlex.join(words)


def state_record(
    history: History, scene: Scene, *, site_cost_eur: float | None = None
) -> dict[str, Any]:
    """Units of the variant that is worked on, and the names of all variants.

    Parameters
    ----------
    history : History
        Its state is what is shown.
    scene : Scene
        With the poles of one's own.
    site_cost_eur : float, optional
        Of every site, where the question says it. [EUR]
    """
    state = history.state
    units = state.variant.units
    drawn = []
    if units:
        drawn = unit_records(state.variant.layout(scene), scene)
    records = []
    existing = state.existing_ids(units)
    for record, unit in zip(drawn, units, strict=True):
        fields = _unit_fields(unit, scene)
        label = unit.id
        title = record["title"]
        if unit.id in existing:
            label = tr("{unit} (existing)", unit=label)
            title = tr("{unit} (existing)", unit=title)
        records.append({**record, **fields, "label": label, "title": title})
    return {
        "units": records,
        "variants": [
            {"name": one.name, "units": len(one.units)} for one in state.variants
        ],
        "current": state.current,
        "poles": [
            _site_record(pole, site_cost_eur, is_own=True) for pole in state.poles
        ],
        "canUndo": history.can_undo,
        "canRedo": history.can_redo,
        "cost": cost_record(units, scene, site_cost_eur, existing=existing),
    }


def _unit_fields(unit: CandidatePose, scene: Scene) -> dict[str, Any]:
    """Fields of a unit that can be changed, and their ranges."""
    foot_m, low_m, high_m = mount_range_m(unit.pose, unit.site_id, scene)
    sensor = unit.sensor
    fov_range_deg = None
    if isinstance(sensor, CameraModel) and sensor.fov_range_deg:
        fov_range_deg = list(sensor.fov_range_deg)
    return {
        "id": unit.id,
        "site": unit.site_id,
        "sensor": sensor.name,
        "yawDeg": unit.pose.yaw_deg,
        "pitchDeg": unit.pose.pitch_deg,
        "heightM": float(unit.pose.position_m[2]) - foot_m,
        "heightRange": [low_m, high_m],
        "fovDeg": sensor.horizontal_fov_deg,
        "verticalFovDeg": sensor.vertical_fov_deg,
        "fovRange": fov_range_deg,
        "isRing": is_ring(sensor),
    }


def cost_record(
    units: Sequence[CandidatePose],
    scene: Scene,
    site_cost_eur: float | None = None,
    *,
    existing: Collection[str] = (),
) -> dict[str, Any] | None:
    """Cost of units and their sites in words, as the bill of materials has it.

    Parameters
    ----------
    units : sequence of CandidatePose
        What is mounted.
    scene : Scene
        Says what its sites cost.
    site_cost_eur : float, optional
        Of every site, where the question says it. [EUR]
    existing : collection of str
        Ids of units that are mounted already: neither they nor their sites are paid
        for.

    Returns
    -------
    dict or None
        None of nothing. A sum of which a part is not known is unknown, too.
    """
    if not units:
        return None
    layout = Layout(name="cost", units=tuple(units))
    bill = build_bill(layout, scene, site_cost_eur=site_cost_eur, kept_ids=existing)
    sensors_eur = _sum([item.sum_eur for item in bill.sensors])
    sites_eur = _sum([item.sum_eur for item in bill.sites])
    kept = ""
    if existing:
        kept = trn(
            "{n} sensor exists and is not paid for.",
            "{n} sensors exist and are not paid for.",
            len(existing),
        )
    return {
        "sensors": euros(sensors_eur),
        "sites": euros(sites_eur),
        "all": euros(_sum([sensors_eur, sites_eur])),
        "kept": kept,
        "assumed": [tr(assumption) for assumption in bill.assumed],
    }


def _sum(amounts: Sequence[float | None]) -> float | None:
    """Sum of amounts; None if one of them is not known."""
    known = [amount for amount in amounts if amount is not None]
    if len(known) < len(amounts):
        return None
    return sum(known)


def table_numbers(
    units: Sequence[CandidatePose],
    together: Verdict,
    alone: Mapping[str, Verdict],
    setting: Setting,
) -> dict[str, Any]:
    """Numbers by the detection table, which a drag shows at once.

    Parameters
    ----------
    units : sequence of CandidatePose
        Those of which each one's own APR is told.
    together : Verdict
        Of all units.
    alone : mapping of str to Verdict
        Of each of `units` alone, by id.
    setting : Setting
        Scene and runs.
    """
    verdicts = {unit.id: alone[unit.id] for unit in units}
    return {
        "source": BY_TABLE,
        **_shares(together, setting),
        "units": _units_apr(verdicts, setting.axis),
    }


def _units_apr(alone: Mapping[str, Verdict], axis: FrameAxis) -> dict[str, str]:
    """APR of each unit alone, in words."""
    found = {}
    for name, verdict in alone.items():
        found[name] = percent(finite_or_none(apr(verdict, axis)))
    return found


def evaluated_numbers(evaluation: Evaluation, setting: Setting) -> dict[str, Any]:
    """Numbers by the evaluator, with the same fields as those of the table and some more.

    Parameters
    ----------
    evaluation : Evaluation
        Of the layout.
    setting : Setting
        Scene and runs.

    Returns
    -------
    dict
        "record" is what ``evaluate --json`` has as "evaluation".
    """
    axis = evaluation.axis
    record = json.loads(to_json_text(build_evaluation_record(evaluation, setting.rule)))
    one_fails = ""
    if len(evaluation.units) > 1:
        one_fails = percent(record["apr_without_worst_unit"])
    return {
        "source": BY_EVALUATOR,
        **_shares(evaluation.headline, setting),
        "units": _units_apr(evaluation.units, axis),
        "vut": percent(record["vut"]["all"]),
        "withVut": percent(record["vut_and_rsus"]["all"]),
        "oneFails": one_fails,
        "record": record,
    }


def _shares(verdict: Verdict, setting: Setting) -> dict[str, Any]:
    """APR in total, by case, arm and road user; runs that are lost, and how each ends.

    Parameters
    ----------
    verdict : Verdict
        Of a layout.
    setting : Setting
        Scene and runs, in the order of the verdict.
    """
    axis = setting.axis
    road_users = np.array([run.road_user for run in setting.runs])
    approaches = np.array(axis.approaches)
    positions = np.array(axis.positions)
    arms = dict.fromkeys(zip(axis.approaches, axis.positions, strict=True))

    def share(mask: Any = None) -> float | None:
        """APR of the runs in a mask; None if they have no weight."""
        return finite_or_none(apr(verdict, axis, mask))

    def by(values: Any) -> dict[str, str]:
        """APR of the runs of each value, in words."""
        names = dict.fromkeys(values.tolist())
        return {tr(name): percent(share(values == name)) for name in names}

    by_case = {}
    for case, value in apr_by_case(verdict, axis).items():
        by_case[case] = percent(finite_or_none(value))
    by_arm = []
    for approach, position in arms:
        is_there = (approaches == approach) & (positions == position)
        by_arm.append(share(is_there))
    lost = []
    for index, outcome in enumerate(run_outcomes(verdict, axis)):
        if outcome != "avoided":
            has_weight = bool(axis.weight[index] > 0.0)
            lost.append([index, tr(outcome), has_weight])
    return {
        "apr": percent(share()),
        "byCase": by_case,
        "byApproach": by(approaches),
        "byRoadUser": by(road_users),
        "byArm": by_arm,
        "lost": lost,
    }


def private_record(
    units: Sequence[CandidatePose],
    ground: PrivateGround,
    sight: PrivateSight,
    *,
    max_share: float,
) -> list[dict[str, Any]]:
    """Private areas that units have in their pictures, those that are seen the most first.

    Parameters
    ----------
    units : sequence of CandidatePose
        What is mounted.
    ground : PrivateGround
        The areas.
    sight : PrivateSight
        Computes the share of each area that each unit sees, as `evaluate` reports it.
    max_share : float
        Share of an area that may be seen.

    Returns
    -------
    list of dict
        For each area its name and who sees it; "isTooMuch": more than is allowed.
    """
    # A row for each unit, a column for each area
    shares = sight.shares(units)
    most = shares.max(axis=0, initial=0.0)
    columns = np.argsort(-most, kind="stable").tolist()
    seen_columns = [column for column in columns if most[column] > 0.0]
    records = []
    for column in seen_columns[:_MAX_AREAS]:
        seen = []
        for row in np.argsort(-shares[:, column], kind="stable").tolist():
            share = float(shares[row, column])
            if share > 0.0:
                is_too_much = share > max_share
                record = {
                    "unit": units[row].id,
                    "share": percent(share),
                    "isTooMuch": is_too_much,
                }
                seen.append(record)
        records.append({"area": ground.names[column], "seen": seen})
    return records


def coverage_record(scene: Scene, units: Sequence[CandidatePose]) -> dict[str, Any]:
    """Pixel density on the road, cell by cell.

    Parameters
    ----------
    scene : Scene
        Has the road.
    units : sequence of CandidatePose
        What is mounted: of several cameras the finest counts; LiDARs take no pictures.

    Returns
    -------
    dict
        "band" has a byte for each cell, row by row from the south: the index of its
        band in ``BANDS``, of which 0 is the finest; 254: coarser than all; 255: unseen.
        "box" is in centimetres.
    """
    found = find_ground_coverage(scene, units)
    band = np.full(found.density.shape, 255, dtype=np.uint8)
    band[found.density > 0.0] = 254
    # The finest last: it wins
    for index in reversed(range(len(BANDS))):
        _, least = BANDS[index]
        band[found.density >= least] = index
    return {
        **_grid_record(found, band),
        "shares": {tr(name): percent(value) for name, value in found.shares().items()},
    }


ERROR_BANDS_M = (0.3, 0.4, 0.6, 1.0)
"""Bands of position errors by their most. [m]"""
_FAR_CM = 254


def errors_record(
    scene: Scene, units: Sequence[CandidatePose], detector: object
) -> dict[str, Any]:
    """Errors of reported places on the road, cell by cell.

    Returns
    -------
    dict
        As :func:`coverage_record`; "band" is by calibrated aims. "errors" has for each
        way of aiming, calibrated first, a byte for each cell: centimetres, 254 for all
        beyond, 255 where no camera sees an adult. "shares" are of the road's cells.
    """
    found = find_position_map(scene, units, detector)
    seen = np.isfinite(found.sd_m)
    centimetres_off = np.where(seen, 100.0 * found.sd_m, 0.0)
    errors = np.minimum(np.ceil(centimetres_off), _FAR_CM).astype(np.uint8)
    errors[~seen] = 255
    band = np.full(found.is_road.shape, 255, dtype=np.uint8)
    band[seen[0]] = 254
    # The smallest last: it wins
    for index in reversed(range(len(ERROR_BANDS_M))):
        band[found.sd_m[0] <= ERROR_BANDS_M[index]] = index
    words = [tr("up to {most:g} m", most=most) for most in ERROR_BANDS_M]
    words += [tr("more"), tr("unseen")]
    codes = [*range(len(ERROR_BANDS_M)), 254, 255]
    road = band[found.is_road]
    shares = [float((road == code).mean()) if len(road) else 0.0 for code in codes]
    return {
        **_grid_record(found, band),
        "errors": [to_base64(one) for one in errors],
        "shares": dict(zip(words, map(percent, shares), strict=True)),
    }


def _grid_record(
    found: GroundCoverage | PositionMap, band: NDArray[np.uint8]
) -> dict[str, Any]:
    """Cells of a layer: box in centimetres, columns, bands and which are road."""
    west, east = _edges_m(found.east_m)
    south, north = _edges_m(found.north_m)
    return {
        "box": centimetres([west, south, east, north]),
        "columns": len(found.east_m),
        "band": to_base64(band),
        "road": to_base64(found.is_road.astype(np.uint8)),
    }


def _edges_m(middles_m: FloatArray) -> tuple[float, float]:
    """Where the first cell begins and the last one ends, of the middles of equal cells."""
    half_m = 0.5 * (middles_m[1] - middles_m[0])
    return float(middles_m[0] - half_m), float(middles_m[-1] + half_m)
