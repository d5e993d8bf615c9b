"""VRU awareness messages."""

import json
import math

import numpy as np
import pytest
from export_layouts import map_scene, placeless_scene
from pyproj import Geod

from experiments.export.cpm import RELEASES
from experiments.export.uper import from_bytes, split, tell_load, to_bytes, to_vam_uper
from experiments.export.vam import RoadUser, build_message, build_messages, to_vam
from experiments.export.watched import export_layout, find_run
from geometry.errors import InputError
from geometry.study_scene import load_study_scene
from placement.layout import load_carlancap_layout

pytest.importorskip("asn1tools", reason="the extra v2x is not installed")

SCENE = load_study_scene()
STATION_TYPE = {"on foot": 1, "bicycle": 2, "motorcycle": 4}
PROFILE = {
    "on foot": {"pedestrian": ("ordinary-pedestrian", 1)},
    "bicycle": {"bicyclistAndLightVruVehicle": ("bicyclist", 1)},
    "motorcycle": {"motorcyclist": ("motorcycle", 2)},
}


def random_user(rng):
    return RoadUser(
        kind=rng.choice(list(STATION_TYPE)),
        longitude_deg=float(rng.uniform(-180.0, 180.0)),
        latitude_deg=float(rng.uniform(-90.0, 90.0)),
        altitude_cm=int(rng.integers(-100_000, 800_002)),
        heading_deg=float(rng.uniform(-180.0, 360.0)),
        speed_mps=float(rng.choice([0.0, rng.uniform(0.0, 15.0), rng.uniform(0.0, 163.81)])),
        acceleration_mps2=float(rng.uniform(-18.0, 18.0)),
    )


def test_a_thousand_road_users_are_read_back_to_the_resolution():
    rng = np.random.default_rng(0)
    for number in range(1000):
        user, release = random_user(rng), RELEASES[number % 2]
        time_ms, has_profile = int(rng.integers(0, 200_000)), bool(rng.integers(2))
        message = build_message(user, time_ms=time_ms, has_profile=has_profile, release=release)
        found = from_bytes("VAM", to_bytes("VAM", message, release), release)
        assert found == message
        assert found["header"] == {"protocolVersion": 3, "messageId": 16, "stationId": 1}
        vam = found["vam"]
        assert vam["generationDeltaTime"] == time_ms % 2**16
        basic = vam["vamParameters"]["basicContainer"]
        assert basic["stationType"] == STATION_TYPE[user.kind]
        place = basic["referencePosition"]
        assert place["latitude"] / 1e7 == pytest.approx(user.latitude_deg, abs=0.5001e-7)
        assert place["longitude"] / 1e7 == pytest.approx(user.longitude_deg, abs=0.5001e-7)
        assert place["altitude"]["altitudeValue"] == user.altitude_cm
        fast = vam["vamParameters"]["vruHighFrequencyContainer"]
        off_deg = (fast["heading"]["value"] / 10.0 - user.heading_deg + 180.0) % 360.0 - 180.0
        assert abs(off_deg) < 0.0501
        assert fast["heading"]["value"] < 3600  # which "shall not be used"
        # n stands for more than n - 1 and at most n of them.
        assert -1e-6 < fast["speed"]["speedValue"] - 100.0 * user.speed_mps < 1.0
        tenths = fast["longitudinalAcceleration"]["longitudinalAccelerationValue"]
        limited = min(max(user.acceleration_mps2, -16.0), 16.0)
        assert -1e-6 < tenths - 10.0 * limited < 1.0
        slow = vam["vamParameters"].get("vruLowFrequencyContainer")
        assert (slow is not None) == has_profile
        if slow is not None:
            ((name, profiles),) = PROFILE[user.kind].items()
            assert slow["profileAndSubprofile"] == {name: profiles[RELEASES.index(release)]}


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"kind": "car"}, "vam: got a road user by car; expected one of: on foot, bicycle, motor"),
        ({"speed_mps": 163.82}, "vam: speed_mps: got 163.82; expected 0 to 163.81"),
        ({"speed_mps": -0.1}, "vam: speed_mps: got -0.1; expected 0 to 163.81"),
        ({"speed_mps": math.nan}, "vam: speed_mps: got nan"),
        ({"latitude_deg": 90.1}, "vam: latitude_deg: got 90.1; expected -90 to 90"),
        ({"longitude_deg": math.inf}, "vam: longitude_deg: got inf; expected -180 to 180"),
        ({"heading_deg": 361.0}, "vam: heading_deg: got 361.0; expected -360 to 360"),
    ],
)
def test_what_a_message_cannot_carry_is_refused(changed, told):
    given = {
        "kind": "on foot", "longitude_deg": 8.0, "latitude_deg": 49.0, "altitude_cm": 800001,
        "heading_deg": 0.0, "speed_mps": 1.0, "acceleration_mps2": 0.0,
    }  # fmt: skip
    with pytest.raises(InputError) as error:
        build_message(RoadUser(**given | changed), time_ms=0, has_profile=True)
    assert str(error.value).startswith(told)


@pytest.mark.parametrize("run_id", ["CPNC-50/east/40", "CBLA/east/25", "CPTAfs-50/north/20"])
@pytest.mark.parametrize("scene", [SCENE, map_scene()])
def test_messages_tell_where_the_run_has_its_road_user(run_id, scene):
    """Places, speeds and headings from the run's frames by the ellipsoid, at ten a second."""
    run = find_run(run_id, scene)
    messages = build_messages(run, scene, vam_rate=10.0)
    assert [time_ms for time_ms, _ in messages] == [100 * n for n in range(len(messages))]
    assert len(messages) == len(run.time_s)
    parts = [one["vam"]["vamParameters"] for _, one in messages]
    places = [part["basicContainer"]["referencePosition"] for part in parts]
    lon, lat = (np.array([one[f"{axis}itude"] for one in places]) / 1e7 for axis in ("long", "lat"))
    _, _, ways_m = Geod(ellps="WGS84").inv(lon[:-1], lat[:-1], lon[1:], lat[1:])
    steps_m = np.linalg.norm(np.diff(run.vru_position_m, axis=0), axis=1)
    np.testing.assert_allclose(ways_m, steps_m, atol=0.02)
    fast = [part["vruHighFrequencyContainer"] for part in parts]
    speeds = np.array([one["speed"]["speedValue"] for one in fast]) / 100.0
    np.testing.assert_allclose(
        speeds[1:-1], ways_m[1:] / 0.1, atol=0.4
    )  # 2 cm in 0.1 s, and starts
    headings = np.array([one["heading"]["value"] for one in fast]) / 10.0
    whole = Geod(ellps="WGS84").inv(lon[0], lat[0], lon[-1], lat[-1])[0]
    if np.ptp(run.vru_yaw_deg) < 1e-9:
        np.testing.assert_allclose((headings - whole + 180.0) % 360.0 - 180.0, 0.0, atol=0.2)
    profiles = ["vruLowFrequencyContainer" in part for part in parts]
    assert np.flatnonzero(profiles).tolist() == list(range(0, len(parts), 20))


def test_without_a_rate_the_standards_rules_decide():
    """A cyclist on a straight way at one speed: a message as soon as 4 m are exceeded."""
    run = find_run("CBLA/east/25", SCENE)
    speed_mps = run.case.vru_speed_kmh / 3.6
    frames = math.floor(4.0 / (0.1 * speed_mps)) + 1
    times = [time_ms for time_ms, _ in build_messages(run, SCENE)]
    assert times == list(range(0, 100 * len(run.time_s), 100 * frames))


def test_files_hold_the_messages_and_tell_their_load():
    run = find_run("CBLA/east/25", SCENE)
    for release in RELEASES:
        content = to_vam_uper(run, SCENE, vam_rate=5.0, release=release)
        found = [(time_ms, from_bytes("VAM", data, release)) for time_ms, data in split(content)]
        assert found == build_messages(run, SCENE, vam_rate=5.0, release=release)
        document = json.loads(to_vam(run, SCENE, vam_rate=5.0, release=release))
        assert document["run"] == run.id
        assert [(one["time_ms"], one["message"]) for one in document["messages"]] == found
    sizes = [len(data) for _, data in split(content)]
    rate = sum(sizes) / (split(content)[-1][0] / 1000.0)
    assert f"{len(sizes)} messages of {min(sizes)} to {max(sizes)} bytes" in tell_load(content)
    assert f"together {100.0 * 8e-6 * rate / 6.0:.2f} %" in tell_load(content)


# Of ETSI's modules (TS 103 300-3 V2.2.1) in asn1tools 0.169.0.
ENDS = {"2.1.1": "04", "2.4.1": "02"}  # a profile of 3 bits, of 4
GOLDEN = "0310000000010064400696cdbc0380743007ffffff08eddd0f8001c27e022ff26f30"


@pytest.mark.parametrize("release", RELEASES)
def test_a_message_by_hand(release):
    user = RoadUser(
        kind="on foot", longitude_deg=8.0, latitude_deg=49.0, altitude_cm=800001,
        heading_deg=90.0, speed_mps=1.39, acceleration_mps2=-0.5,
    )  # fmt: skip
    message = build_message(user, time_ms=100, has_profile=True, release=release)
    assert to_bytes("VAM", message, release).hex() == GOLDEN + ENDS[release]


def test_the_format_asks_for_a_run_and_takes_no_layout(run, tmp_path):
    cases = [
        ({"layout": None}, r"^--run: got ''; expected a run: vam shows nothing else$"),
        (
            {"layout": load_carlancap_layout(), "run_id": "CPNC-50/east/40"},
            r"^--layout: got 'carlancap-12'; expected none: vam has no units$",
        ),
        (
            {"layout": None, "run_id": "CPNC-50/east/40", "options": {"vam_rate": 11.0}},
            r"^--vam-rate: got 11.0; expected 0.2 to 10 messages per second$",
        ),
        ({"layout": None, "run_id": "CCFtap/north/10x30"}, "a road user by car"),
    ]
    for given, told in cases:
        with pytest.raises(InputError, match=told):
            export_layout(format_name="vam", **given)
    with pytest.raises(InputError, match=r"^--vam-rate: .*csv has no such option"):
        export_layout(load_carlancap_layout(), "csv", options={"vam_rate": 1.0})
    with pytest.raises(InputError, match="a scene without crs"):
        build_messages(find_run("CBLA/east/25", SCENE), placeless_scene())
    out = tmp_path / "vam.bin"
    given = ("--run", "CPNC-50/east/40", "--format", "vam-uper", "--vam-rate", "1", "--out", out)
    code, _, err = run("export", *given)
    n_messages = math.floor(-find_run("CPNC-50/east/40", SCENE).time_s[0]) + 1
    assert (code, len(split(out.read_bytes()))) == (0, n_messages)
    assert err.startswith(f"{n_messages} messages of ")
