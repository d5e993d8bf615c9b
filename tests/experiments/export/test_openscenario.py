"""Runs as OpenSCENARIO, read back by the library and against the schema."""

import importlib.metadata
import importlib.util
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from functools import cache, partial

import numpy as np
import pytest
from met_cases import MET_CASES
from numpy.testing import assert_allclose
from short_runs import cut_run

from experiments.export.openscenario import (
    load_xosc,
    to_openscenario,
    validate_openscenario,
)
from geometry.actors import Shape, load_actors
from geometry.errors import InputError, MissingExtraError
from geometry.study_scene import load_study_scene
from scenarios.aeb import load_aeb_rule
from scenarios.cases import load_cases, select_cases
from scenarios.runs import WEATHERS, build_runs

CASES = {
    "CPNA-25": 30.0,  # straight, nothing hides the adult
    "CPNCO-50": 40.0,  # straight, a child behind two parked cars
    "CPTAfs-50": 10.0,  # turning
    "CBLA-50": 45.0,  # longitudinal, a cyclist
    "CBNA": 20.0,  # a cyclist behind the corner
}
MET = ("MEET-CAR", "MEET-MOTORCYCLE")
JUNCTION_2026 = {
    "CCCscp-near": (30.0, 50.0),  # a car behind three parked ones
    "CMCscp-far": (30.0, 50.0),
    "CCFtap": (10.0, 30.0),  # turning
    "CMFtap": (10.0, 30.0),
    "CMRs-50": (50.0, 0.0),  # stands
    "CMRb-50": (50.0, 50.0),  # brakes
    "CCRs-2026-50": (50.0, 0.0),
    "CCRm-2026-50": (50.0, 20.0),
    "CCRb-2026-50": (50.0, 50.0),
    "CCFhos-2026-50": (30.0, 50.0),
}
EVERY_CASE = [
    *(*CASES, *MET),
    *(pytest.param(case, marks=pytest.mark.long) for case in JUNCTION_2026),
]
needs_library = pytest.mark.skipif(
    importlib.util.find_spec("scenariogeneration") is None,
    reason="the extra openscenario is not installed",
)


@pytest.fixture(scope="module")
def some_runs():
    """By case and weather: one run each, from the first approach that carries the
    case.
    """
    lay = partial(
        build_runs,
        load_study_scene(),
        vut=load_actors()["vut"],
        rule=load_aeb_rule(),
    )
    cases = []
    for name, speed_kmh in CASES.items():
        case = load_cases()[name]
        cases.append(replace(case, vut_speeds_kmh=(speed_kmh,)))

    newer = []
    for name, pair in JUNCTION_2026.items():
        case = replace(load_cases()[name], vut_speeds_kmh=pair[:1])
        if case.pairs_kmh:
            case = replace(case, pairs_kmh=(pair,))
        newer.append(case)
    met = select_cases(str(MET_CASES)).cases

    runs, _ = lay(cases, weathers=WEATHERS)
    others, _ = lay([*met, *newer])
    found = {}
    for run in (*runs, *others):
        found.setdefault((run.case.name, run.weather), run)

    return found


@pytest.fixture(scope="module")
def written(some_runs):
    """The file of a case's run in a weather: made once, for to write one takes long."""

    @cache
    def text(case, weather="day"):
        return to_openscenario(some_runs[case, weather], road_network="Town05.xodr")

    return text


def export_of(run):
    """The file of a run, on the study's roads."""
    return to_openscenario(run, road_network="Town05.xodr")


def names_and_values(root, tag):
    """Names and values of all elements with a tag."""
    return {one.get("name"): one.get("value") for one in root.iter(tag)}


def rear_axle_m(actor):
    """Ahead of the middle of the box, by the facts (bicycle: ISO 19206-4)."""
    if actor.name == "cyclist":
        return actor.reference_ahead_m - 0.62
    return actor.front_axle_ahead_m - actor.wheelbase_m


def is_vehicle(actor):
    """Whether a body has axles."""
    return actor.class_name != "pedestrian"


def read_trajectories(text):
    """By entity, read by the library: time, x, y, yaw, (n, 4). [s, m, m, deg]"""
    from scenariogeneration import xosc

    scenario = xosc.Scenario.parse(ET.fromstring(text))
    found = {}
    for group in scenario.storyboard.stories[0].acts[0].maneuvergroup:
        (entity,) = group.actors.actors
        (action,) = group.maneuvers[0].events[0].action
        line = action.action.trajectory.shapes
        assert action.action.timeref.get_attributes() == {
            "domainAbsoluteRelative": "absolute",
            "scale": "1.0",
            "offset": "0.0",
        }
        vertices = []
        for time, at in zip(line.time, line.positions, strict=True):
            vertices.append([time, at.x, at.y, np.degrees(at.h)])
        found[entity.entity] = np.array(vertices)

    return found


def middles_m(track, ahead_m):
    """From reference points back to the middles of the footprints, (n, 2)."""
    yaw_rad = np.radians(track[:, 3])
    ahead = np.stack([np.cos(yaw_rad), np.sin(yaw_rad)], axis=1)
    return track[:, 1:3] - ahead_m * ahead


def initial(root, entity):
    """What a body does at first."""
    return next(one for one in root.iter("Private") if one.get("entityRef") == entity)


def init_position(root, entity):
    """Where a body begins: east, north, up, yaw. [m, rad]"""
    private = initial(root, entity)
    place = private.find("PrivateAction/TeleportAction/Position/WorldPosition")
    return np.array([float(place.get(key)) for key in ("x", "y", "z", "h")])


def init_speed_mps(root, entity):
    """How fast a body begins."""
    private = initial(root, entity)
    (target,) = private.iter("AbsoluteTargetSpeed")
    return float(target.get("value"))


def box_of(root, entity):
    """Element and bounding box of a body."""
    objects = {one.get("name"): one for one in root.iter("ScenarioObject")}
    body = objects[entity][0]
    center = body.find("BoundingBox/Center")
    size = body.find("BoundingBox/Dimensions")
    box = {}
    for key in ("x", "y", "z"):
        box[key] = float(center.get(key))
    for key in ("length", "width", "height"):
        box[key] = float(size.get(key))

    return body, box


@pytest.fixture(scope="module")
def schema():
    """The standard's schema, as the library brings it."""
    import xmlschema

    files = importlib.metadata.files("scenariogeneration")
    by_name = {file.name: file for file in files}
    path = by_name["OpenSCENARIO_1_3_1.xsd"].locate()
    return xmlschema.XMLSchema(str(path))


@pytest.mark.long
@needs_library
@pytest.mark.parametrize(
    ("case", "weather"),
    [
        *((case, "day") for case in (*CASES, *MET, *JUNCTION_2026)),
        *(("CPNCO-50", weather) for weather in WEATHERS[1:]),
    ],
)
def test_the_schema_accepts_every_kind_of_run(schema, some_runs, case, weather):
    """By another library than the export asks about whole files: this one takes long
    per vertex.
    """
    end = cut_run(some_runs[case, weather], slice(-6, None))
    root = ET.fromstring(export_of(end))
    schema.validate(root)


@needs_library
@pytest.mark.parametrize("case", EVERY_CASE)
def test_trajectories_read_back_are_the_frames_to_a_millimetre(
    some_runs, written, case
):
    run = some_runs[case, "day"]
    tracks = read_trajectories(written(case))

    assert set(tracks) == {"vut", "vru"}

    vru = run.encounter.vru
    ahead_m = {"vut": rear_axle_m(run.encounter.vut), "vru": 0.0}
    if is_vehicle(vru):
        ahead_m["vru"] = rear_axle_m(vru)

    for name, position_m, yaw_deg in (
        ("vut", run.vut_position_m, run.vut_yaw_deg),
        ("vru", run.vru_position_m, run.vru_yaw_deg),
    ):
        # Further vertices of turns are on the way, too.
        times_s = tracks[name][:, 0] + run.time_s[0]
        apart_s = np.abs(times_s[:, None] - run.time_s)
        is_frame = apart_s.min(axis=1) < 1e-6
        track = tracks[name][is_frame]

        elapsed_s = run.time_s - run.time_s[0]
        assert_allclose(
            track[:, 0],
            elapsed_s,
            rtol=0.0,
            atol=1e-6,
        )
        assert_allclose(
            middles_m(track, ahead_m[name]),
            position_m,
            rtol=0.0,
            atol=1e-3,
        )

        turned_deg = (track[:, 3] - yaw_deg + 180.0) % 360.0 - 180.0
        jumps_deg = np.abs(np.diff(track[:, 3]))
        assert_allclose(turned_deg, 0.0, atol=1e-3)
        assert (jumps_deg < 90.0).all()


@needs_library
@pytest.mark.parametrize("case", ["CPNA-25", "CPTAfs-50", "CBLA-50"])
def test_a_run_whose_last_frame_is_before_the_impact_still_ends_at_the_impact(
    some_runs, written, case
):
    """Trajectories go on to the impact at time 0, whichever frames there are."""
    whole = some_runs[case, "day"]
    early = cut_run(whole, slice(-1))
    assert export_of(early) == written(case)


@needs_library
@pytest.mark.parametrize("case", EVERY_CASE)
def test_bodies_start_where_their_trajectories_do_and_as_fast(some_runs, written, case):
    """Init actions and first vertices agree."""
    run = some_runs[case, "day"]
    text = written(case)
    root = ET.fromstring(text)
    tracks = read_trajectories(text)

    for name, motion in (
        ("vut", run.encounter.vut_motion),
        ("vru", run.encounter.vru_motion),
    ):
        x_m, y_m, z_m, yaw_rad = init_position(root, name)
        _, first_x_m, first_y_m, first_yaw_deg = tracks[name][0]
        assert x_m == first_x_m
        assert y_m == first_y_m
        assert z_m == 0.0
        assert np.degrees(yaw_rad) == pytest.approx(first_yaw_deg)

        step_s = 1.0e-4
        times_s = run.time_s[0] + np.array([0.0, step_s])
        (step_m,) = np.diff(motion.distance_m(times_s))
        slope_mps = step_m / step_s
        assert init_speed_mps(root, name) == pytest.approx(slope_mps, abs=2e-3)

    speed_mps = round(run.vut_speed_kmh / 3.6, 3)
    assert init_speed_mps(root, "vut") in (0.0, speed_mps)


@needs_library
@pytest.mark.parametrize("case", EVERY_CASE)
def test_boxes_stand_on_the_road_around_the_middle_that_the_run_gives(
    some_runs, written, case
):
    """Vehicles refer to their rear axle, people to their middle."""
    run = some_runs[case, "day"]
    root = ET.fromstring(written(case))
    bodies = {"vut": run.encounter.vut, "vru": run.encounter.vru} | {
        f"obstruction-{index}": placed.actor
        for index, placed in enumerate(run.obstruction, 1)
    }

    assert [o.get("name") for o in root.iter("ScenarioObject")] == list(bodies)

    for name, actor in bodies.items():
        body, box = box_of(root, name)
        if is_vehicle(actor):
            middle_m = -rear_axle_m(actor)
        else:
            middle_m = 0.0
        assert box == pytest.approx(
            {
                "x": middle_m,
                "y": 0.0,
                "z": actor.height_m / 2.0,
                "length": actor.length_m,
                "width": actor.width_m,
                "height": actor.height_m,
            }
        )

        if is_vehicle(actor):
            front = body.find("Axles/FrontAxle")
            rear = body.find("Axles/RearAxle")
            assert float(rear.get("positionX")) == 0.0

            # Wheels are within the body, and touch the road.
            rear_end_m = middle_m - actor.length_m / 2.0
            front_end_m = middle_m + actor.length_m / 2.0
            radius_m = float(front.get("wheelDiameter")) / 2.0
            ahead_m = float(front.get("positionX"))
            up_m = float(front.get("positionZ"))

            assert rear_end_m <= -radius_m + 1e-9
            assert ahead_m + radius_m <= front_end_m + 1e-9
            assert up_m == pytest.approx(radius_m)


@needs_library
def test_parked_bodies_stand_where_the_run_has_them(some_runs, written):
    """To a millimetre, as bodies that move."""
    n_seen = 0
    for case in (*CASES, *JUNCTION_2026):
        run = some_runs[case, "day"]
        root = ET.fromstring(written(case))
        for index, placed in enumerate(run.obstruction, 1):
            name = f"obstruction-{index}"
            x_m, y_m, _, yaw_rad = init_position(root, name)
            yaw_deg = np.degrees(yaw_rad)
            _, box = box_of(root, name)
            track = np.array([[0.0, x_m, y_m, yaw_deg]])
            (middle_m,) = middles_m(track, -box["x"])

            assert_allclose(
                middle_m,
                placed.pose.position_m[:2],
                atol=1e-3,
                rtol=0.0,
            )
            assert yaw_deg == pytest.approx(placed.pose.yaw_deg, abs=1e-3)

            n_seen += 1
    assert n_seen >= 8


@needs_library
@pytest.mark.parametrize(
    ("case", "element", "category"),
    [
        ("CPNA-25", "Pedestrian", "pedestrian"),
        ("CPNCO-50", "Pedestrian", "pedestrian"),
        ("CBLA-50", "Vehicle", "bicycle"),
        ("MEET-MOTORCYCLE", "Vehicle", "motorbike"),
        ("MEET-CAR", "Vehicle", "car"),
    ],
)
def test_road_users_have_the_standards_kinds_and_riders_are_named(
    written, case, element, category
):
    """A rider is no entity of its own, but a note of the vehicle."""
    root = ET.fromstring(written(case))
    body, _ = box_of(root, "vru")

    assert body.tag == element
    assert body.get(f"{element.lower()}Category") == category

    notes = [p.get("value") for p in body.iter("Property") if p.get("name") == "note"]
    names_rider = any("rider" in note for note in notes)
    has_rider = category in ("bicycle", "motorbike")

    assert names_rider == has_rider


@needs_library
def test_a_wall_is_an_object_that_is_no_vehicle(some_runs):
    """It has no axles to refer to."""
    run = some_runs["CPNCO-50", "day"]
    corners = np.zeros((3, 3))
    wall = replace(
        run.encounter.vut,
        name="wall 20 x 0.25 x 2.2 m",
        class_name="wall",
        length_m=20.0,
        width_m=0.25,
        height_m=2.2,
        shapes=(Shape(vertices_m=corners, triangles=np.array([[0, 1, 2]])),),
        wheelbase_m=0.0,
        front_axle_ahead_m=0.0,
    )
    placed = replace(run.obstruction[0], actor=wall)
    walled = replace(run, obstruction=(placed,))
    root = ET.fromstring(export_of(walled))
    body, box = box_of(root, "obstruction-1")
    place = init_position(root, "obstruction-1")

    assert body.tag == "MiscObject"
    assert box["x"] == 0.0
    assert box["z"] == 1.1
    assert box["length"] == 20.0
    assert_allclose(place[:2], placed.pose.position_m[:2], atol=1e-6)


@needs_library
def test_every_body_of_the_catalogue_and_every_weather_is_described(some_runs):
    """Export checks its own file against the schema."""
    run = cut_run(some_runs["CPNCO-50", "day"], slice(-6, None))
    (placed, *_) = run.obstruction
    everybody = tuple(replace(placed, actor=actor) for actor in load_actors().values())

    for weather in WEATHERS:
        crowded = replace(run, obstruction=everybody, weather=weather)
        assert export_of(crowded)


@needs_library
def test_weather_sets_sun_rain_road_and_lights(written):
    """Lights are on at night and in fog."""
    sky = {}
    for weather in WEATHERS:
        root = ET.fromstring(written("CPNA-25", weather))
        (found,) = root.iter("Weather")
        rain = found.find("Precipitation")
        elevation = float(found.find("Sun").get("elevation"))
        intensity = float(rain.get("precipitationIntensity"))
        range_m = float(found.find("Fog").get("visualRange"))
        road = next(root.iter("RoadCondition"))
        sky[weather] = (
            elevation > 0.0,
            rain.get("precipitationType"),
            intensity > 0.0,
            range_m < 1000.0,  # WMO-No. 8: less is fog
            road.get("wetness"),
            [light.get("vehicleLightType") for light in root.iter("VehicleLight")],
        )

    assert sky == {
        "day": (True, "dry", False, False, "dry", []),
        "night": (False, "dry", False, False, "dry", ["lowBeam"]),
        "rain": (True, "rain", True, False, "wetWithPuddles", []),
        "fog": (True, "dry", False, True, "moist", ["lowBeam"]),
    }


@needs_library
def test_the_file_says_what_the_run_is_and_when_it_would_have_to_brake(some_runs):
    """Times count from the beginning of the file, not to the impact."""
    run = some_runs["CPNCO-50", "night"]
    roads = "maps/Town05.xodr"
    text = to_openscenario(run, road_network=roads)
    root = ET.fromstring(text)
    file = root.find("RoadNetwork/LogicFile")

    assert file.get("filepath") == roads

    header = root.find("FileHeader")
    assert header.get("revMajor") == "1"
    assert header.get("revMinor") == "3"
    assert names_and_values(header, "Property") == {
        "run": run.id,
        "case": "CPNCO-50",
        "source": "protocol-4.5.1",
        "approach": run.approach,
        "position": "0",
        "weather": "night",
        "vut_speed_kmh": "40",
        "vru_speed_kmh": "5",
        "is_avoidable_by_braking": "true",
    }

    declared = names_and_values(root, "ParameterDeclaration")
    times_s = {name: float(value) for name, value in declared.items()}
    expected_s = {
        "impact_time_s": -run.time_s[0],
        "last_brake_time_s": run.last_brake_time_s - run.time_s[0],
    }

    assert times_s == pytest.approx(expected_s, abs=1e-6)

    # The file ends with the impact.
    stop = root.find("Storyboard/StopTrigger")
    (condition,) = stop.iter("SimulationTimeCondition")

    assert condition.get("rule") == "greaterThan"
    assert float(condition.get("value")) == times_s["impact_time_s"]


@needs_library
def test_a_run_that_no_braking_avoids_has_no_last_brake_time(some_runs):
    """The file says that braking does not avoid it."""
    run = replace(some_runs["CPNA-25", "day"], last_brake_time_s=-np.inf)
    root = ET.fromstring(export_of(run))
    declared = names_and_values(root, "ParameterDeclaration")
    said = names_and_values(root, "Property")

    assert list(declared) == ["impact_time_s"]
    assert said["is_avoidable_by_braking"] == "false"


@needs_library
def test_the_same_run_gives_the_same_text_whatever_the_library_wrote_before(
    some_runs, written
):
    """The library keeps the version of the format in a global state."""
    from scenariogeneration import xosc

    run = some_runs["CPNA-25", "night"]
    first = written("CPNA-25", "night")
    xosc.VersionBase().setVersion(minor=0)
    try:
        assert export_of(run) == first
    finally:
        xosc.VersionBase().setVersion(minor=3)

    for part in ET.fromstring(first).iter():
        assert "-0.0" not in part.attrib.values()


@needs_library
def test_headings_do_not_jump_by_a_full_turn(some_runs, written):
    """Another program may turn the body once round between two frames."""
    run = some_runs["CPTAfs-50", "day"]
    yaw_deg = np.array(run.vut_yaw_deg)
    yaw_deg[len(yaw_deg) // 2 :] -= 360.0
    again = export_of(replace(run, vut_yaw_deg=yaw_deg))

    assert again == written("CPTAfs-50")


@needs_library
def test_words_of_a_case_are_escaped(some_runs):
    """The file stays XML, and the words come back as they were."""
    run = some_runs["CPNA-25", "day"]
    title = 'adult <"fast"> & far'
    roads = "a & b.xodr"
    titled = replace(run, case=replace(run.case, title=title))
    text = to_openscenario(titled, road_network=roads)
    root = ET.fromstring(text)
    header = root.find("FileHeader")
    file = root.find("RoadNetwork/LogicFile")

    assert header.get("description") == f"{run.id}: {title}"
    assert file.get("filepath") == roads


@needs_library
@pytest.mark.parametrize(
    ("break_it", "where", "reason"),
    [
        (
            lambda text: text.partition("<Entities>")[0],
            "OpenSCENARIO",
            "no element found",
        ),
        (
            lambda text: text.replace('vehicleCategory="car"', ""),
            "OpenSCENARIO: /OpenSCENARIO/Entities/ScenarioObject[1]/Vehicle",
            "vehicleCategory",
        ),
        (
            lambda text: text.replace(
                'followingMode="position"', 'followingMode="almost"'
            ),
            "TrajectoryFollowingMode",
            "almost",
        ),
    ],
)
def test_a_file_that_the_schema_rejects_is_named_with_place_and_reason(
    written, break_it, where, reason
):
    text = written("CPNA-25")
    validate_openscenario(text)

    with pytest.raises(InputError) as caught:
        validate_openscenario(break_it(text))

    assert where in caught.value.where
    assert reason in str(caught.value)
    assert caught.value.expected == "XML that OpenSCENARIO_1_3_1.xsd accepts"


@needs_library
def test_what_cannot_be_exported_is_refused(some_runs):
    run = some_runs["CPNA-25", "day"]
    with pytest.raises(InputError, match="road_network: got ''"):
        to_openscenario(run, road_network="")

    told = "weather: got 'hail'; expected one of day, fog, night, rain"
    with pytest.raises(InputError, match=told):
        export_of(replace(run, weather="hail"))

    for changes, reason in (
        ({"wheelbase_m": 0.0}, "actor vut.wheelbase_m: got 0.0; expected > 0 metres"),
        (
            {"name": "x", "class_name": "tram"},
            "class_name: got 'tram'; expected one of",
        ),
    ):
        vut = replace(run.encounter.vut, **changes)
        odd = replace(run.encounter, vut=vut)
        with pytest.raises(InputError) as caught:
            export_of(replace(run, encounter=odd))
        assert reason in str(caught.value)


def test_without_the_library_the_extra_is_named(some_runs, monkeypatch):
    """The way to install it is part of the line."""
    monkeypatch.setitem(sys.modules, "scenariogeneration.xosc", None)
    load_xosc.cache_clear()
    try:
        told = r"pip install place-rsus\[openscenario\]"
        with pytest.raises(MissingExtraError, match=told):
            export_of(some_runs["CPNA-25", "day"])
    finally:
        load_xosc.cache_clear()
