"""Messages to the page: the junction once, then units and numbers whenever they change."""

import json
import re
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import msgspec
import numpy as np

from geometry.arrays import FloatArray
from geometry.catalogue import Sensor, sensor_kind
from geometry.errors import InputError, check_one_of
from geometry.frames import to_geographic
from geometry.phrases import Phrase
from geometry.scene import Scene, Site
from geometry.sensors import CameraModel
from placement.candidates import CandidatePose, is_ring
from placement.detectors import DETECTOR_NAMES
from placement.evaluation import Evaluation, Verdict, apr, apr_by_case, run_outcomes
from placement.ground import BANDS, PrivateGround, PrivateSight, find_ground_coverage
from placement.layout import Layout
from placement.question import BLIND, SEE, Question, question_fields, read_cars
from placement.setting import Setting, check_question
from scenarios.cases import load_case_sets
from scenarios.runs import WEATHERS, Run
from scenarios.scores import AVOIDED
from scenarios.weights import WEIGHT_WORDS, default_weights

from ..cli.options import JUDGED, option_of
from ..export.json import to_json, to_json_text
from ..figures.axes import describe_run
from ..language import mark, tr
from ..parts.bill_of_materials import build_bill
from ..parts.player import centimetres, plan_record, svg_path, to_base64, unit_records
from ..results.numbers import euros, finite_or_none, percent
from ..results.record import build_evaluation_record
from .plan import SCHEMA, Background, ChangeQuestion, History, PlanState, mount_range_m

BY_TABLE, BY_EVALUATOR = "table", "evaluator"
_HOST = r"[A-Za-z0-9](?:[A-Za-z0-9.-]*[A-Za-z0-9])?"
_TEMPLATE = re.compile(
    rf"(?P<origin>https?://(?P<host>{_HOST})(?::(?P<port>\d{{1,5}}))?)/[!#-&(-;=?-~]*"  # no ' " < >
)
_HIGHEST_PORT = 65535
_TILES_M = 1500.0  # around the junction, to each side
_FIT_STEPS, _FIT_ORDER = 9, 3
_MERCATOR_DEG = 85.0  # its tiles end a little farther north


def key_of(units: Sequence[CandidatePose]) -> tuple[object, ...]:
    """Equal for units that achieve the same together, one by one and by name."""
    return tuple(
        (
            unit.id,
            *unit.pose.position_m.tolist(),
            *(unit.pose.yaw_deg, unit.pose.pitch_deg, unit.sensor, unit.latency_s),
        )
        for unit in units
    )


def scene_record(
    setting: Setting,
    *,
    models: Sequence[Sensor],
    chosen: Sequence[str],
    ground: PrivateGround | None = None,
) -> dict[str, Any]:
    """The constant part of a session: plan, sites, runs, models of sensors."""
    scene, axis = setting.scene, setting.axis
    return {
        "name": scene.name,
        "plan": plan_record(scene, np.zeros((0, 2))),
        "sites": [_site_record(site) for site in scene.sites],
        "sensors": [
            {
                **{"name": model.name, "kind": sensor_kind(model), "price": model.price_eur},
                "isRing": is_ring(model),
            }
            for model in models
        ],
        "grid": list(chosen),
        "runs": [
            {
                **{"id": run.id, "title": describe_run(axis, index), "frames": len(run.time_s)},
                "ends": centimetres(run.vru_position_m[-1]),
                "weight": float(axis.weight[index] / axis.weight.sum()),
            }
            for index, run in enumerate(setting.runs)
        ],
        "cases": {run.case.name: tr(run.case.title) for run in setting.runs},
        "arms": _arm_records(setting),
        "bands": [name for name, _ in BANDS],
        "private": [] if ground is None else _private_areas(ground),
    }


def _site_record(site: Site, *, is_own: bool = False) -> dict[str, Any]:
    return {
        **{"id": site.id, "kind": tr(site.kind), "place": centimetres(site.position_m[:2])},
        **dict(zip(("low", "high"), site.height_range_m.tolist(), strict=True)),
        "capacity": site.capacity_units,
        "isForbidden": site.use == "forbidden",
        "isOwn": is_own,
    }


def _private_areas(ground: PrivateGround) -> list[dict[str, str]]:
    named = zip(ground.names, ground.shapes, strict=True)
    return [{"name": name, "path": svg_path(shape)} for name, shape in named]


def _arm_records(setting: Setting) -> list[dict[str, Any]]:
    """Every approach and position that is driven: the VUT's way, and where the impacts are."""
    found: dict[tuple[str, str], list[Run]] = {}
    for run in setting.runs:
        found.setdefault((run.approach, run.position), []).append(run)
    records = []
    for (approach, position), runs in found.items():
        impacts_m = np.mean([run.vut_position_m[-1] for run in runs], axis=0)
        longest = max(runs, key=lambda run: len(run.time_s))
        record = {"approach": tr(approach), "position": position, "place": centimetres(impacts_m)}
        records.append(record | {"way": centimetres(longest.vut_position_m)})
    return records


# ---------- what is asked


def change_question(question: Question, change: ChangeQuestion, begun: Question) -> Question:
    """A question with what a browser changes; files are those that the session has `begun` with.

    Raises InputError: a value is none that can be chosen.
    """
    asked = msgspec.structs.asdict(change)
    given = {name: value for name, value in asked.items() if value is not msgspec.UNSET}
    for name in (mark("detector"), mark("weights")):
        if name in given:
            check_one_of(name, given[name], _choices(begun)[name])
    cases = given.get("cases", "")
    if ".toml" in cases.lower() and cases != begun.cases:
        raise InputError(mark("cases"), cases, mark("sets and names of cases"))
    changed = replace(question, **given)
    if 0.0 < read_cars(changed.cars) < 1.0:
        raise InputError(
            mark("cars"),
            changed.cars,
            Phrase("{one} or {other}: the page tells each run once", one=BLIND, other=SEE),
        )
    check_question(replace(changed, detector=DETECTOR_NAMES[0]))
    return changed


def _choices(begun: Question) -> dict[str, list[str]]:
    known = {"detector": DETECTOR_NAMES, "weights": ("", *WEIGHT_WORDS), "cars": (BLIND, SEE)}
    return {name: [*dict.fromkeys([*words, getattr(begun, name)])] for name, words in known.items()}


_MEANINGS = {
    "case": mark(
        "Mean over cases, in each over approaches, positions and runs; not over all runs."
    ),
    "run": mark("Share of all runs: each counts the same, so cases with more runs count more."),
    "fhwa-crash-types": mark("Cases count by how often cars hit people so, not by their runs."),
    "euroncap-rating-2026": mark("Cases count by Euro NCAP's points, not by their runs."),
}
"""What weights mean, by their names."""


def question_record(question: Question, begun: Question) -> dict[str, Any]:
    """What the page lets choose of a question, and how the numbers are made again elsewhere."""
    names = msgspec.structs.fields(ChangeQuestion)
    weights = question.weights or default_weights(question.cases)
    meaning = tr("Runs count by the weights of {name}.", name=weights)
    if weights in WEIGHT_WORDS:
        meaning = tr(_MEANINGS[weights])
    if question.score != AVOIDED:
        meaning += " " + tr("A run that is not avoided counts by the speed that is left.")
    return {
        "now": {field.name: getattr(question, field.name) for field in names},
        "choices": _choices(begun) | {"weather": WEATHERS, "cases": [*load_case_sets()]},
        "defaultWeights": default_weights(question.cases),
        "meaning": meaning,
        "command": evaluate_command(question),
    }


def evaluate_command(question: Question) -> str:
    """Command that evaluates the saved layout, as a shell takes it."""
    words = ["place-rsus", "evaluate", "--layout", "layout.json"]
    for field in question_fields().values():
        value = getattr(question, field.name)
        if field.name in ("no_look", *JUDGED) and value != field.default:
            words += [option_of(field)] if value is True else [option_of(field), f"{value}"]
    return shlex.join(words)


def state_record(history: History, scene: Scene) -> dict[str, Any]:
    """Units of the variant that is worked on, and the names of all variants."""
    state = history.state
    units = state.variant.units
    drawn = unit_records(state.variant.layout(scene), scene) if units else []
    fields = [_unit_fields(unit, scene) for unit in units]
    return {
        "units": [record | own for record, own in zip(drawn, fields, strict=True)],
        "variants": [{"name": one.name, "units": len(one.units)} for one in state.variants],
        "current": state.current,
        "poles": [_site_record(pole, is_own=True) for pole in state.poles],
        "canUndo": history.can_undo,
        "canRedo": history.can_redo,
        "cost": cost_record(units, scene),
    }


def _unit_fields(unit: CandidatePose, scene: Scene) -> dict[str, Any]:
    """Fields of a unit that can be changed, and their ranges."""
    foot_m, *heights_m = mount_range_m(unit.pose, unit.site_id, scene)
    sensor = unit.sensor
    lens = sensor.fov_range_deg if isinstance(sensor, CameraModel) else None
    return {
        "id": unit.id,
        "site": unit.site_id,
        "sensor": sensor.name,
        "yawDeg": unit.pose.yaw_deg,
        "pitchDeg": unit.pose.pitch_deg,
        "heightM": float(unit.pose.position_m[2]) - foot_m,
        "heightRange": heights_m,
        "fovDeg": sensor.horizontal_fov_deg,
        "verticalFovDeg": sensor.vertical_fov_deg,
        "fovRange": list(lens) if lens else None,
        "isRing": is_ring(sensor),
    }


def cost_record(units: Sequence[CandidatePose], scene: Scene) -> dict[str, Any] | None:
    """Cost of units and their sites in words, as the bill of materials has it; None of nothing."""
    if not units:
        return None
    bill = build_bill(Layout(name="cost", units=tuple(units)), scene)
    sensors, sites = (_sum([one.sum_eur for one in items]) for items in (bill.sensors, bill.sites))
    sums = {"sensors": sensors, "sites": sites, "all": _sum([sensors, sites])}
    words = {name: euros(amount) for name, amount in sums.items()}
    return words | {"assumed": [*map(tr, bill.assumed)]}


def _sum(amounts: Sequence[float | None]) -> float | None:
    known = [amount for amount in amounts if amount is not None]
    return sum(known) if len(known) == len(amounts) else None


def layout_text(state: PlanState, scene: Scene) -> str:
    """The current variant as the layout file of ``--layout``; InputError: nothing is mounted."""
    return to_json_text(json.loads(to_json(state.variant.layout(scene))) | _pole_places(state))


def _pole_places(state: PlanState) -> dict[str, Any]:
    """Poles of one's own as files have them; nothing where there is none."""
    places = [
        {"id": pole.id, "x_m": float(pole.position_m[0]), "y_m": float(pole.position_m[1])}
        for pole in state.poles
    ]
    return {"poles": places} if places else {}


def plan_text(state: PlanState, scene: Scene, background: Background | None = None) -> str:
    """All variants in one file, each as a layout file has it, and the image below them."""
    variants = [
        json.loads(to_json(variant.layout(scene)))
        if variant.units
        else {"name": variant.name, "layout": []}
        for variant in state.variants
    ]
    record = {"schema": SCHEMA, "scene": scene.name, "variants": variants, **_pole_places(state)}
    if background is not None:
        record["background"] = msgspec.to_builtins(background)
    return to_json_text(record)


def table_numbers(
    units: Sequence[CandidatePose],
    together: Verdict,
    alone: Mapping[str, Verdict],
    setting: Setting,
) -> dict[str, Any]:
    """Numbers by the detection table, which a drag shows at once."""
    axis = setting.axis
    return {
        "source": BY_TABLE,
        **_shares(together, setting),
        "units": {unit.id: percent(finite_or_none(apr(alone[unit.id], axis))) for unit in units},
    }


def evaluated_numbers(evaluation: Evaluation, setting: Setting) -> dict[str, Any]:
    """Numbers by the evaluator; "record" is what ``evaluate --json`` has as "evaluation"."""
    axis = evaluation.axis
    record = json.loads(to_json_text(build_evaluation_record(evaluation, setting.rule)))
    return {
        "source": BY_EVALUATOR,
        **_shares(evaluation.headline, setting),
        "units": {
            name: percent(finite_or_none(apr(verdict, axis)))
            for name, verdict in evaluation.units.items()
        },
        "vut": percent(record["vut"]["all"]),
        "withVut": percent(record["vut_and_rsus"]["all"]),
        "oneFails": percent(record["apr_without_worst_unit"]) if len(evaluation.units) > 1 else "",
        "record": record,
    }


def _shares(verdict: Verdict, setting: Setting) -> dict[str, Any]:
    """APR in total, by case, arm and road user; runs that are lost, and how each ends."""
    axis = setting.axis
    met = np.array([run.road_user for run in setting.runs])
    approaches, positions = np.array(axis.approaches), np.array(axis.positions)
    arms = dict.fromkeys(zip(axis.approaches, axis.positions, strict=True))

    def share(mask: Any = None) -> float | None:
        return finite_or_none(apr(verdict, axis, mask))

    def by(values: Any) -> dict[str, str]:
        return {tr(name): percent(share(values == name)) for name in dict.fromkeys(values.tolist())}

    by_case = apr_by_case(verdict, axis).items()
    return {
        "apr": percent(share()),
        "byCase": {case: percent(finite_or_none(value)) for case, value in by_case},
        "byApproach": by(approaches),
        "byRoadUser": by(met),
        "byArm": [
            share((approaches == approach) & (positions == position)) for approach, position in arms
        ],
        "lost": [
            [index, tr(outcome), bool(axis.weight[index] > 0.0)]
            for index, outcome in enumerate(run_outcomes(verdict, axis))
            if outcome != "avoided"
        ],
    }


_MAX_AREAS = 200  # those that are seen the most


def private_record(
    units: Sequence[CandidatePose], ground: PrivateGround, sight: PrivateSight, *, max_share: float
) -> list[dict[str, Any]]:
    """Private areas that units have in their pictures, those that are seen the most first.

    The share that each unit sees, as `evaluate` reports; "isTooMuch": more than is allowed.
    """
    shares = sight.shares(units)
    most = shares.max(axis=0, initial=0.0)
    order = [int(column) for column in np.argsort(-most, kind="stable") if most[column] > 0.0]
    records = []
    for column in order[:_MAX_AREAS]:
        seen = [
            {"unit": units[row].id, "share": percent(share), "isTooMuch": share > max_share}
            for row in np.argsort(-shares[:, column], kind="stable").tolist()
            if (share := float(shares[row, column])) > 0.0
        ]
        records.append({"area": ground.names[column], "seen": seen})
    return records


def coverage_record(scene: Scene, units: Sequence[CandidatePose]) -> dict[str, Any]:
    """Pixel density on the road: the band of each cell, the finest 0; 254 coarser, 255 unseen."""
    found = find_ground_coverage(scene, units)
    band = np.full(found.density.shape, 255, dtype=np.uint8)
    band[found.density > 0.0] = 254
    for index, (_, least) in reversed([*enumerate(BANDS)]):
        band[found.density >= least] = index
    middles = (found.east_m, found.north_m)
    west, south = (float(line[0] - 0.5 * (line[1] - line[0])) for line in middles)
    east, north = (float(line[-1] + 0.5 * (line[1] - line[0])) for line in middles)
    return {
        "box": centimetres([west, south, east, north]),
        "columns": len(found.east_m),
        "band": to_base64(band),
        "road": to_base64(found.is_road.astype(np.uint8)),
        "shares": {tr(name): percent(value) for name, value in found.shares().items()},
    }


# ---------- tiles of a server that the user names
class TileServer(NamedTuple):
    """Where tiles of a map come from: ``https://HOST/{z}/{x}/{y}.png``, and whose they are."""

    template: str
    attribution: str
    origin: str  # the only one that the page may ask, such as "https://HOST"


def read_tile_server(template: str, attribution: str) -> TileServer:
    """The server of ``--tiles``, by default its own name as attribution; or InputError."""
    found = _TEMPLATE.fullmatch(template)
    names = sorted(re.findall(r"\{(.*?)\}", template))
    if found is None or names != ["x", "y", "z"] or int(found["port"] or 0) > _HIGHEST_PORT:
        raise InputError("--tiles", template, "an address such as https://HOST/{z}/{x}/{y}.png")
    return TileServer(template, attribution or found["host"], found["origin"])


def tile_frame(scene: Scene) -> dict[str, Any] | None:
    """How tiles lie on the plan of a scene; None: it does not say where on earth it lies.

    Tiles are squares of Web Mercator: of the whole map, 0 to 1 from west to east and from north to
    south (EPSG:3857, scaled). Around the junction the plan is a polynomial of these and they are
    one of the plan; each is fitted to a grid of 1.5 km to all sides, to less than a millimetre.
    """
    if not scene.crs:
        return None
    centre_m = scene.outline_m.mean(axis=0)
    steps = np.linspace(-1.0, 1.0, _FIT_STEPS)
    plan = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    lon_deg, lat_deg = to_geographic(centre_m + _TILES_M * plan, scene.crs).T
    if not (np.isfinite(lon_deg).all() and (np.abs(lat_deg) <= _MERCATOR_DEG).all()):
        return None
    north = np.arcsinh(np.tan(np.radians(lat_deg))) / (2.0 * np.pi)
    places = np.column_stack([(lon_deg + 180.0) / 360.0, 0.5 - north])
    middle = places.mean(axis=0)
    size = float(np.abs(places - middle).max())
    tiles = (places - middle) / size

    def fit(given: FloatArray, wanted: FloatArray) -> list[list[float]]:
        u, v = given.T
        powers = [u**i * v ** (n - i) for n in range(_FIT_ORDER + 1) for i in range(n, -1, -1)]
        found: list[list[float]] = np.linalg.lstsq(np.stack(powers, 1), wanted)[0].tolist()
        return found

    return {
        **{"middle": middle.tolist(), "size": size},
        **{"centre": (100.0 * centre_m).tolist(), "reach": 100.0 * _TILES_M},
        **{"toPlan": fit(tiles, plan), "toTiles": fit(plan, tiles)},
    }
