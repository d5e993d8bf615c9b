"""The server without a browser: who is let in, what is answered, and that numbers
agree.
"""

import asyncio
import base64
import io
import json
import shlex
import shutil
import threading
import time
import zipfile
from dataclasses import replace
from itertools import count
from pathlib import Path

import numpy as np
import pytest
from command_results import output
from json_files import as_json, read_json
from PIL import Image
from plan_sessions import InThread, few_poses, small_session, small_work  # noqa: F401
from private_garden import write_garden
from small_results import lay_runs_of

pytest.importorskip("starlette", reason="place-rsus[plan] is not installed")
pytest.importorskip("httpx2", reason="starlette's test client needs httpx2")

from starlette.testclient import TestClient
from starlette.websockets import WebSocketDisconnect

from experiments.jobs.evaluation import run_evaluation
from experiments.parts.camera_views import draw_view
from experiments.parts.units import build_private_ground_record
from experiments.planner import server
from experiments.planner.server import build_app
from experiments.planner.session import Session
from experiments.planner.tiles import read_tile_server
from experiments.planner.worker import Cancelled, DiedError
from experiments.planner.workspace import Workspace
from experiments.progress import StageProgress
from experiments.results.numbers import percent
from geometry.scene_files import save_scene
from geometry.sensors import project_points
from geometry.study_scene import load_study_scene
from placement.compute import Compute
from placement.layout import load_carlancap_layout, load_layout
from placement.private_ground import load_private_ground
from placement.question import Question
from scenarios.runs import build_frame_axis
from scenarios.weights import weight_per_run

TOKEN = "a-token"
HOST = "127.0.0.1:8000"
ORIGIN = {"origin": f"http://{HOST}"}
UNITS = load_carlancap_layout().units
ADD = {"do": "add", "site": "corner-ne", "sensor": "carla-ncap-rgb"}


@pytest.fixture
def open_client(tmp_path, small_setting, few_poses):  # noqa: F811
    """A client of a session with some units, and the line to it."""
    clients = []

    def make(units=(), *, setting=small_setting, **given):
        session = small_session(tmp_path, setting, units=units, **given)
        app = build_app(session, token=TOKEN, hosts=frozenset({HOST}))
        client = TestClient(app, base_url=f"http://{HOST}")
        client.__enter__()
        clients.append(client)
        return client

    yield make
    for client in clients:
        client.__exit__(None, None, None)


class Line:
    """Messages both ways; what comes is sorted by its type."""

    def __init__(self, socket):
        self.socket = socket
        self.last = {}
        self.seen = []

    def until(self, is_it, *, most=4000):
        for _ in range(most):
            message = json.loads(self.socket.receive_text())
            self.last[message["type"]] = message
            self.seen.append(message)
            if is_it(message):
                return message
        raise AssertionError("it never came")

    def next(self, kind, *present, **values):
        """The next message of a type that has these fields, or these values of them."""

        def is_it(message):
            return (
                message["type"] == kind
                and all(message[name] for name in present)
                and values.items() <= message.items()
            )

        return self.until(is_it)

    def state(self):
        return self.next("state")

    def numbers(self, *sources):
        def is_it(message):
            return (
                message["type"] == "numbers"
                and message["source"] in sources
                and message["revision"] == self.last["state"]["revision"]
            )

        return self.until(is_it)

    def send(self, **message):
        self.socket.send_text(json.dumps(message))


@pytest.fixture
def join():
    """Joins a client's session as a page does: its line, once it has said its state."""

    def joined(client):
        socket = client.websocket_connect(f"ws://{HOST}/{TOKEN}/live", headers=ORIGIN)
        line = Line(socket.__enter__())
        opened.append(socket)
        line.state()
        return line

    opened = []
    yield joined
    for socket in opened:
        socket.__exit__(None, None, None)


def send_file(client, name, content):
    """Open a file as the page does."""
    headers = ORIGIN | {"x-file-name": name}
    return client.post(f"/{TOKEN}/open", content=content, headers=headers)


def scene_archive(folder, scene):
    """A scene as the bytes of a .zip file."""
    folder.mkdir()
    save_scene(folder, scene)
    return Path(shutil.make_archive(str(folder), "zip", folder)).read_bytes()


def take_junction(client, name=b""):
    """Import the junction that was chosen on a map."""
    return client.post(f"/{TOKEN}/import", content=name, headers=ORIGIN)


def saved_plan(client):
    return client.get(f"/{TOKEN}/plan.json").content


def evaluated(client, folder):
    """Page's layout as the command evaluates it."""
    path = folder / "mine.json"
    path.write_text(client.get(f"/{TOKEN}/layout.json").text)
    return run_evaluation(
        Question(),
        layout=load_layout(path),
        out=None,
        compute=Compute(workers=2),
        command="",
        progress=StageProgress(),
    )


# ---------- who is let in


@pytest.mark.parametrize(
    ("path", "headers", "said"),
    [
        ("/", {}, "no such page"),
        ("/another/", {}, "no such page"),
        ("/a-token-and-more/", {}, "no such page"),
        (f"/{TOKEN}/", {"host": "evil.example:8000"}, "another host"),
        (f"/{TOKEN}/", {"host": "127.0.0.1:8001"}, "another host"),
        (f"/{TOKEN}/", {"origin": "http://evil.example"}, "another origin"),
        (f"/{TOKEN}/", {"origin": "null"}, "another origin"),
    ],
)
def test_who_has_not_the_address_is_not_let_in(open_client, path, headers, said):
    response = open_client().get(path, headers=headers)
    assert response.status_code == 403
    assert said in response.text
    assert "mine" not in response.text


@pytest.mark.parametrize(
    "headers", [{}, {"origin": "http://evil.example"}, {"origin": "null"}]
)
def test_a_line_is_open_to_this_page_alone(open_client, headers):
    client = open_client()
    with (
        pytest.raises(WebSocketDisconnect),
        client.websocket_connect(f"ws://{HOST}/{TOKEN}/live", headers=headers),
    ):
        pass


def test_nothing_is_taken_from_another_page(open_client):
    client = open_client()
    for headers in ({}, {"origin": "http://evil.example"}):
        response = client.post(f"/{TOKEN}/open", content=b"{}", headers=headers)
        assert response.status_code == 403


def test_the_page_asks_for_nothing_from_elsewhere(open_client):
    client = open_client()
    page = client.get(f"/{TOKEN}/")
    assert page.status_code == 200

    policy = page.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert page.headers["referrer-policy"] == "no-referrer"
    assert page.headers["cache-control"] == "no-store"

    for name in server.page_files():
        content = client.get(f"/{TOKEN}/files/{name}")
        assert content.status_code == 200

        text = content.text.replace("http://www.w3.org/2000/svg", "")
        assert "http://" not in text
        assert "https://" not in text
    assert "<script>" not in page.text


@pytest.mark.parametrize(
    "name", ["..%2f..%2fpyproject.toml", "tasks.py", "watch.html.j2", "x"]
)
def test_no_path_of_a_browser_is_opened(open_client, name):
    assert open_client().get(f"/{TOKEN}/files/{name}").status_code == 404


def test_hosts_that_are_answered():
    assert server.allowed_hosts("127.0.0.1", 5) == {"127.0.0.1:5", "localhost:5"}
    assert server.allowed_hosts("planner.example", 5) == {"planner.example:5"}
    assert server.allowed_hosts("0.0.0.0", 5) is None


# ---------- planning


LENSES = {
    "brown-conrady": (
        480,
        "k1 = -0.12, p1 = 0.001",
        90.0,
        "fov_range_deg = [50.0, 100.0]",
    ),
    "fisheye": (600, "k1 = -0.02, k2 = 0.003", 190.0, "roll_deg = 3.0"),
}


@pytest.mark.long
@pytest.mark.parametrize("model", LENSES)
def test_a_camera_with_a_lens_is_planned_seen_and_judged(
    open_client, join, few_runs, tmp_path, monkeypatch, model
):
    runs = tuple(run for run in few_runs.runs if run.case.name == "CBLA")
    setting = replace(
        few_runs, runs=runs, axis=build_frame_axis(runs, weight_per_run(runs))
    )
    lay_runs_of(monkeypatch, setting)
    height_px, terms, fov_deg, more = LENSES[model]
    path = tmp_path / "own.toml"
    path.write_text(
        f"[cameras.bent]\nwidth_px = {4 * height_px // 3}\nheight_px = {height_px}\n"
        f"horizontal_fov_deg = {fov_deg}\n"
        "frame_rate_hz = 10.0\nnear_m = 0.5\nprice_eur = 900.0\n"
        f'lens = {{model = "{model}", {terms}}}\n{more}\n'
    )
    client = open_client(setting=setting, asked={"sensors": str(path)})
    line = join(client)
    line.send(do="add", site="corner-ne", sensor="bent")
    (unit,) = line.state()["units"]

    assert unit["fovDeg"] == fov_deg

    line.send(
        do="change",
        unit="U1",
        yaw_deg=-140.0,
        pitch_deg=-20.0,
    )
    view = line.until(lambda told: told["type"] == "view" and told["reachM"] > 5.0)
    assert view["view"].startswith("M")

    exact = line.numbers("evaluator")
    result = evaluated(client, tmp_path)

    assert exact["record"] == as_json(result.evaluation)
    assert result.evaluation.rsu_all.all > 0.0

    run_id = setting.axis.run_ids[0]
    picture = client.get(
        f"/{TOKEN}/picture", params={"run": run_id, "unit": "U1", "frame": "-5"}
    )

    assert picture.content[:2] == b"\xff\xd8"
    assert client.get(f"/{TOKEN}/sheet.pdf").content.startswith(b"%PDF")


def test_what_cannot_be_done_is_told_to_who_asked_and_changes_nothing(
    open_client, join
):
    line = join(open_client())
    before = line.last["state"]["revision"]
    for message, said in (
        (ADD | {"site": "x"}, "site: got 'x'"),
        ({"do": "remove", "unit": "U1"}, "unit: got 'U1'"),
        ({"do": "fly"}, "message: got"),
        (ADD | {"path": "/"}, "message"),
        ({"do": "take", "number": 3}, "proposal: got 3"),
        ({"do": "sensors", "names": ["/etc/passwd"]}, "sensors: got '/etc/passwd'"),
    ):
        line.send(**message)
        problem = line.next("problem")
        assert said in problem["text"]
    line.socket.send_text("x" * 70_000)

    assert "message: got 70000 bytes" in line.next("problem")["text"]

    line.send(do="rename-variant", name="still there")
    assert line.state()["revision"] == before + 1


def test_bytes_in_place_of_text_end_one_line_alone(open_client, join):
    client = open_client()
    one = join(client)
    other = join(client)
    one.socket.send_bytes(b"\x00\xff")
    other.send(**ADD)

    assert [unit["id"] for unit in other.state()["units"]] == ["U1"]


def test_two_browsers_look_at_one_desk(open_client, join):
    client = open_client()
    one = join(client)
    other = join(client)
    one.send(**ADD)

    assert [unit["id"] for unit in other.state()["units"]] == ["U1"]

    other.send(do="undo")
    one.state()
    assert one.next("state")["units"] == []


def test_nothing_hangs_and_no_number_is_told(open_client, join):
    line = join(open_client())
    numbers = line.next("numbers")

    assert numbers["source"] == "none"
    assert "apr" not in numbers


def test_pixel_density_is_told_when_asked_for(open_client, join):
    line = join(open_client(UNITS[:2]))
    line.send(do="coverage", is_shown=True)
    found = line.next("coverage")

    assert list(found["shares"])[-2:] == ["coarser", "unseen"]


def test_position_errors_are_told_when_asked_for(open_client, join):
    line = join(open_client(UNITS[:2]))
    line.send(do="errors", is_shown=True)
    found = line.next("errors")

    assert list(found["shares"])[-2:] == ["more", "unseen"]

    known, by_eye = (
        np.frombuffer(base64.b64decode(one), np.uint8) for one in found["errors"]
    )
    assert len(known) == len(base64.b64decode(found["road"]))

    seen = known < 255
    assert seen.any()
    assert (known[seen] <= by_eye[seen]).all()

    line.send(do="errors", is_shown=False)


@pytest.mark.long
def test_the_optimiser_proposes_and_is_taken_over_or_dropped(
    open_client, join, tmp_path
):
    line = join(open_client(UNITS[:1]))
    line.send(do="ask", request="next")
    told = line.next("proposals", "proposals")
    (proposal,) = told["proposals"]

    assert proposal["isProven"]
    assert len(proposal["drawn"]) == 2
    assert proposal["words"].startswith(
        f"On the detection table: APR {proposal['onTable']}"
    )

    line.send(do="take", number=proposal["number"])
    assert len(line.state()["units"]) == 2

    line.send(do="undo")
    assert len(line.state()["units"]) == 1

    line.send(do="ask", request="re-aim")
    told = line.next("proposals", "proposals")
    number = told["proposals"][0]["number"]
    line.send(do="take", number=number, as_variant=True)
    state = line.state()

    assert [each["name"] for each in state["variants"]] == [
        "mine",
        "All re-aimed, poles kept",
    ]
    assert state["current"] == 1

    line.send(do="ask", request="complete", units=1)
    notice = line.next("notice")
    assert (
        notice["text"]
        == "units in all: got 1; expected more than the 1 that are mounted already"
    )


# ---------- files


def test_plans_and_layouts_are_saved_and_opened_again(open_client, join):
    client = open_client(UNITS[:2])
    line = join(client)
    line.send(do="add-variant", name="other")
    line.state()
    plan = saved_plan(client)
    layout = client.get(f"/{TOKEN}/layout.json").content
    for content, name in (
        (plan, "a plan.json"),
        (layout, "mine.json"),
    ):
        response = send_file(client, name, content)
        assert response.status_code == 200, response.text
        line.state()
    names = [each["name"] for each in line.last["state"]["variants"]]

    assert names == ["mine", "other", "a plan: mine", "a plan: other", "mine: other"]


def test_a_summary_that_is_opened_brings_the_question_of_its_layout(open_client, join):
    client = open_client(UNITS[:1])
    line = join(client)
    layout = json.loads(client.get(f"/{TOKEN}/layout.json").content)
    question = {
        "cars": "see",
        "weather": "night",
        "latency": 0.1,
        "budget": 1,
    }
    summary = layout | {"asked": {"question": question}}
    response = send_file(client, "summary.json", json.dumps(summary).encode())

    assert response.status_code == 200, response.text

    line.next("question")
    now = line.last["question"]["now"]

    assert now["cars"] == "see"
    assert now["weather"] == "night"
    assert "--latency 0.1" in line.last["question"]["command"]

    variants = [each["name"] for each in line.last["state"]["variants"]]
    summary["asked"]["question"] = {"cars": "0.5"}
    refused = send_file(client, "summary.json", json.dumps(summary).encode())

    assert refused.status_code == 400
    assert "the page shows each run once" in refused.json()["problem"]
    assert [each["name"] for each in line.last["state"]["variants"]] == variants


def test_sheet_and_report_are_told_what_an_opened_summary_says_exists(
    open_client, join, monkeypatch
):
    client = open_client(UNITS[:2])
    line = join(client)
    summary = json.loads(client.get(f"/{TOKEN}/layout.json").content)
    names = [unit["id"] for unit in summary["layout"]]
    summary["existing"] = names[:1]
    response = send_file(client, "summary.json", json.dumps(summary).encode())

    assert response.status_code == 200, response.text

    labels = [unit["label"] for unit in line.state()["units"]]
    assert labels == [f"{names[0]} (existing)", names[1]]

    asked = []

    async def call(session, method, *args, is_long):
        asked.append((method, args[-1]))
        return b""

    monkeypatch.setattr(Session, "call", call)
    client.get(f"/{TOKEN}/sheet.pdf")
    client.get(f"/{TOKEN}/report.zip")

    assert asked == [
        ("sheet", {names[0]}),
        ("report", {names[0]}),
    ]

    summary["existing"] = "U1"
    refused = send_file(client, "summary.json", json.dumps(summary).encode())
    assert "summary.json: existing" in refused.json()["problem"]


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("x.json", b"{", "x.json: got "),
        ("x.json", b'{"layout": []}', "got no unit"),
        ("x.exe", b"MZ", "file: got 'x.exe'; expected a name that ends in .json, .osm"),
        ("x.osm", b"<osm", "expected"),
        ("x.zip", b"PK", "expected"),
        ("../../x.xodr", b"<x/>", "expected"),
    ],
)
def test_files_that_are_none_are_told_as_on_the_command_line(
    open_client, tmp_path, name, content, said
):
    client = open_client()
    response = send_file(client, name, content)

    assert response.status_code == 400
    assert said in response.json()["problem"]
    assert str(tmp_path) not in response.json()["problem"]
    assert not list(tmp_path.glob("received*"))


def test_what_is_too_large_is_refused_and_not_kept(open_client, tmp_path, monkeypatch):
    monkeypatch.setattr(server, "MAX_PLAN_BYTES", 1000)
    client = open_client()
    response = send_file(client, "x.json", b"x" * 1001)

    assert "more than 1,000 bytes" in response.json()["problem"]
    assert not list(tmp_path.glob("received*"))


# ---------- an image below the plan

PNG = b"\x89PNG\r\n\x1a\n" + b"pixels"
POINTS = {
    "width_px": 200,
    "height_px": 100,
    "points": [
        {
            "x_px": 0.0,
            "y_px": 0.0,
            "east_m": -20.0,
            "north_m": 10.0,
        },
        {
            "x_px": 200.0,
            "y_px": 0.0,
            "east_m": 20.0,
            "north_m": 10.0,
        },
    ],
}


def lay(client, content=PNG, points=POINTS):
    """Lay an image below the plan."""
    return client.post(
        f"/{TOKEN}/background",
        content=content,
        headers=ORIGIN | {"x-points": json.dumps(points)},
    )


def test_an_image_is_kept_in_the_plan_and_comes_back_with_it(
    open_client, join, tmp_path
):
    client = open_client()
    line = join(client)
    assert lay(client).status_code == 200

    message = line.next("background", "address")
    assert message["points"] == [
        [0.0, 0.0, -20.0, 10.0],
        [200.0, 0.0, 20.0, 10.0],
    ]

    image = client.get(f"/{TOKEN}/{message['address']}")
    assert image.content == PNG
    assert image.headers["content-type"] == "image/png"
    assert "default-src 'none'" in image.headers["content-security-policy"]

    plan = saved_plan(client)
    assert lay(client, b"").status_code == 200
    assert client.get(f"/{TOKEN}/background").status_code == 404
    assert "background" not in json.loads(saved_plan(client))

    send_file(client, "p.json", plan)
    assert client.get(f"/{TOKEN}/background").content == PNG

    again = saved_plan(client)
    assert json.loads(again)["background"] == json.loads(plan)["background"]
    assert not list(tmp_path.glob("received*"))


@pytest.mark.parametrize(
    ("content", "points", "said"),
    [
        (b"<svg onload='x'/>", POINTS, "image: got another format; expected PNG, JPEG"),
        (PNG, {}, "image: points: got"),
        (PNG, POINTS | {"path": "/etc/passwd"}, "image: points: got"),
        (PNG, POINTS | {"width_px": 0}, "got 0 by 100 pixels"),
        (
            PNG,
            POINTS | {"points": [POINTS["points"][0]] * 2},
            "got points 0.0 px and 0.00 m",
        ),
        (
            PNG,
            POINTS | {"points": [POINTS["points"][0] | {"x_px": 1e300}] * 2},
            "numbers up to",
        ),
    ],
)
def test_what_is_no_image_or_lies_nowhere_is_told(open_client, content, points, said):
    client = open_client()
    response = lay(client, content, points)

    assert response.status_code == 400
    assert said in response.json()["problem"]
    assert client.get(f"/{TOKEN}/background").status_code == 404


@pytest.mark.parametrize("image", ["%", "AAAA", 3])
def test_a_plan_whose_image_is_damaged_is_refused(open_client, image):
    client = open_client()
    lay(client)
    plan = json.loads(saved_plan(client))
    plan["background"]["image"] = image
    response = send_file(client, "p.json", json.dumps(plan).encode())

    assert response.status_code == 400
    assert "p.json: background: got" in response.json()["problem"]


def test_capacity_and_price_of_poles_are_those_of_the_question(open_client, join):
    asked = {"site_capacity": 1, "site_cost_eur": 250.0}
    line = join(open_client(UNITS[:1], asked=asked))
    sites = line.last["scene"]["sites"]

    assert {(site["capacity"], site["price"]) for site in sites} == {(1, "250 EUR")}
    assert line.last["state"]["cost"]["sites"] == "250 EUR"

    sensor = line.last["scene"]["grid"][0]
    line.send(do="add", site=UNITS[0].site_id, sensor=sensor)
    assert "expected at most 1" in line.next("problem")["text"]


def test_a_sensor_dragged_from_a_pole_is_one_step(open_client, join):
    line = join(open_client())
    line.send(**ADD, gesture="drag 1")
    (unit,) = line.state()["units"]
    for yaw_deg in (10.0, 20.0):
        line.send(
            do="change",
            unit=unit["id"],
            yaw_deg=yaw_deg,
            gesture="drag 1",
        )
        assert line.state()["units"][0]["yawDeg"] == yaw_deg
    line.send(do="undo")

    assert line.state()["units"] == []


# ---------- private areas


@pytest.fixture
def garden(tmp_path):
    """Private ground beside the junction."""
    return write_garden(tmp_path, (-146.4, 7.6, -130.4, 17.6))


@pytest.mark.long
def test_private_areas_in_view_are_those_that_evaluate_tells(open_client, join, garden):
    units = UNITS[:2]
    client = open_client(units, asked={"no_look": str(garden), "no_look_share": 0.5})
    line = join(client)
    numbers = line.numbers("table")
    scene = load_study_scene()
    ground = load_private_ground(garden, scene)
    told = build_private_ground_record(units, scene, ground).units
    expected = sorted(
        ((share["garden"], unit) for unit, share in told.items() if share["garden"]),
        reverse=True,
    )
    (area,) = numbers["private"]

    assert area["area"] == "garden"
    assert [(one["unit"], one["share"], one["isTooMuch"]) for one in area["seen"]] == [
        (unit, percent(share), share > 0.5) for share, unit in expected
    ]

    places = client.get(f"/{TOKEN}/private", params={"unit": expected[0][1]}).json()
    assert len(places) == round(expected[0][0] * len(ground.points_m))
    assert client.get(f"/{TOKEN}/private", params={"unit": "nobody"}).status_code == 400
    assert line.last["scene"]["private"][0]["path"].startswith("M")
    assert line.numbers("evaluator")["private"] == numbers["private"]


@pytest.mark.long
def test_private_areas_are_kept_when_another_scene_is_opened(open_client, join, garden):
    client = open_client(asked={"no_look": str(garden)})
    line = join(client)
    archive = scene_archive(garden.parent / "same", load_study_scene())
    line.last.clear()
    response = send_file(client, "same.zip", archive)

    assert response.json()["isScene"], response.text
    assert take_junction(client).status_code == 200

    scene = line.next("scene")
    assert [area["name"] for area in scene["private"]] == ["garden"]


@pytest.mark.long
def test_an_evaluator_that_dies_is_told_and_asked_once_more(tmp_path, small_setting):
    class Dies(InThread):
        deaths = 0

        async def call(self, method, *args, **kwargs):
            if method == "evaluate" and Dies.deaths == 0:
                Dies.deaths += 1
                raise DiedError("the process that did it was ended from outside")
            return await super().call(method, *args, **kwargs)

    async def work():
        session = small_session(
            tmp_path,
            small_setting,
            units=UNITS[:1],
            make_worker=lambda work: Dies(work, small_setting),
        )
        told = []
        is_known = asyncio.Event()

        def listen(message):
            told.append(message)
            if message.get("source") == "evaluator":
                is_known.set()

        session.start()
        session.join(listen)
        await asyncio.wait_for(is_known.wait(), 120)
        session.stop_processes()
        return [message["text"] for message in told if message["type"] == "notice"]

    notices = asyncio.run(work())

    assert notices == ["the process that did it was ended from outside; trying again"]


@pytest.mark.long
def test_numbers_of_the_table_never_follow_those_of_the_evaluator(
    tmp_path, small_setting
):
    async def work():
        session = small_session(tmp_path, small_setting, units=UNITS[:1])
        sources = []
        calls = count(1)
        is_judged = threading.Event()
        is_done = asyncio.Event()

        def listen(message):
            if message["type"] != "numbers":
                return
            sources.append(message["source"])
            if len(sources) == 1:
                session.counting.changed.set()  # as when another browser comes
            elif len(sources) == 2:
                is_judged.set()
            else:
                is_done.set()

        def private(units):
            # The table's numbers wait for this until the evaluator is done.
            if next(calls) == 2:
                assert is_judged.wait(100)
            return {}

        session.shown.workspace.private_areas = private
        session.browsers.listeners.add(listen)
        session.start()
        await asyncio.wait_for(is_done.wait(), 120)
        session.stop_processes()
        return sources

    assert asyncio.run(work()) == ["table", "evaluator", "evaluator"]


# ---------- maps


@pytest.mark.long
def test_a_plan_is_not_lost_when_another_scene_is_opened(open_client, join, tmp_path):
    path = tmp_path / "kept.json"
    client = open_client(UNITS[:1], save=path)
    line = join(client)
    line.send(do="change", unit="RSU0", yaw_deg=11.0)
    line.state()
    other_scene = replace(load_study_scene(), name="other")
    send_file(client, "other.zip", scene_archive(tmp_path / "other", other_scene))
    take_junction(client)
    line.next("scene", name="other")

    assert line.state()["units"] == []

    notice = line.next("notice")["text"]
    assert notice.startswith("The plan at town05 is in")

    kept = read_json(path)
    assert kept["variants"][0]["layout"][0]["yaw_deg"] == 11.0

    line.send(**ADD)
    line.state()
    line.send(do="undo")
    line.state()
    line.send(do="undo")  # beyond what was done here: back to the scene before
    line.next("scene", name="town05")
    state = line.state()

    assert [unit["yawDeg"] for unit in state["units"]] == [11.0]
    assert state["canRedo"]

    line.send(do="redo")
    line.next("scene", name="other")
    line.send(do="redo")
    while not line.state()["units"]:
        pass
    line.numbers("table", "evaluator")
    other = tmp_path / "kept-2.json"
    for _ in range(100):
        if other.exists():
            break
        time.sleep(0.1)

    assert read_json(other)["scene"] == "other"
    assert read_json(path) == kept


def test_a_count_of_many_units_ends_when_nobody_waits_for_it(tmp_path, small_setting):
    place = Workspace(small_work(tmp_path), small_setting)
    (unit,) = UNITS[:1]
    asked = []

    def detected(units):
        asked.append(len(units))
        if len(asked) == 2:
            place.is_over.set()
        return np.zeros((len(units), small_setting.axis.n_frames), dtype=bool)

    place.live.detected = detected

    with pytest.raises(Cancelled):
        place.numbers_by_table([replace(unit, id=f"U{index}") for index in range(1000)])
    assert len(asked) == 2


def test_views_are_told_for_every_unit_and_follow_what_is_turned(open_client, join):
    line = join(open_client(UNITS[:2]))

    def view_of(unit):
        return line.next("view", unit=unit)

    before = {unit: view_of(unit) for unit in ("RSU0", "RSU1")}

    assert all(
        view["view"].startswith("M") and view["reachM"] > 20 for view in before.values()
    )

    line.send(do="change", unit="RSU1", yaw_deg=0.0)
    assert view_of("RSU1")["view"] != before["RSU1"]["view"]


@pytest.mark.long
def test_a_camera_that_is_aimed_is_seen_with_the_road_user_of_a_run(
    open_client, small_setting
):
    unit = UNITS[7]
    client = open_client([unit])
    run = small_setting.runs[0]
    for frame in (0, len(run.time_s) - 1):
        values = {
            "unit": unit.id,
            "run": run.id,
            "frame": frame,
            "width": 320,
        }
        found = client.get(f"/{TOKEN}/seen", params=values).json()

        assert found["run"] == run.id
        assert found["frame"] == frame
        assert found["size"] == [320, 180]
        assert found["timeS"] == run.time_s[frame]

        image = Image.open(io.BytesIO(base64.b64decode(found["image"])))
        assert image.format == "JPEG"
        assert image.size == (320, 180)

        waist_m = np.array([[*run.vru_position_m[frame], 0.9]])
        ((x_px, y_px, *_),) = project_points(waist_m, unit.pose, unit.sensor)
        at = x_px / unit.sensor.width_px, y_px / unit.sensor.height_px
        is_inside = 0.0 < at[0] < 1.0 and 0.0 < at[1] < 1.0
        assert is_inside == (found["box"] is not None)

        if is_inside:
            left, top, right, bottom = found["box"]
            assert left - 0.01 < at[0] < right + 0.01
            assert top - 0.01 < at[1] < bottom + 0.01
    nearest = client.get(
        f"/{TOKEN}/seen", params={"unit": unit.id, "width": 160}
    ).json()
    _, expected, time_s = draw_view(unit_of_width(unit, 160), small_setting)

    assert nearest["run"] == expected.id
    assert nearest["timeS"] == time_s

    for values, said in (
        ({"unit": "nobody"}, "unit: got 'nobody'"),
        ({"unit": unit.id, "run": "x"}, "run: got 'x'"),
        ({"unit": unit.id, "run": run.id, "frame": "999"}, "frame: got 999"),
        ({"unit": unit.id, "width": "wide"}, "width: got 'wide'"),
    ):
        response = client.get(f"/{TOKEN}/seen", params=values)
        assert response.status_code == (400 if values.get("width") == "wide" else 200)
        assert said in response.json()["problem"]


def unit_of_width(unit, width_px):
    """A camera whose picture is as wide, with the same shape."""
    height_px = round(unit.sensor.height_px * width_px / unit.sensor.width_px)
    return replace(
        unit, sensor=replace(unit.sensor, width_px=width_px, height_px=height_px)
    )


@pytest.mark.long
def test_another_question_is_judged_with_the_same_layout_and_undo_leads_back(
    open_client, join, run, tmp_path
):
    units = UNITS[6:8]
    client = open_client(units)
    line = join(client)
    by_day = line.numbers("evaluator")

    assert line.last["question"]["now"]["weather"] == "day"

    line.send(do="question", weather="night", cars="see")
    # Before the runs of the first are laid.
    line.send(do="question", detector="response")
    line.next("doing", who="setting")
    line.next("question")
    now = line.last["question"]["now"]

    assert now["weather"] == "night"
    assert now["cars"] == "see"
    assert now["detector"] == "response"
    assert now["cases"] == "CPNC-50"
    assert [unit["id"] for unit in line.state()["units"]] == [unit.id for unit in units]

    by_night = line.numbers("evaluator")
    assert by_night["record"] != by_day["record"]

    layout = tmp_path / "layout.json"
    layout.write_bytes(client.get(f"/{TOKEN}/layout.json").content)
    words = shlex.split(line.last["question"]["command"])

    assert words[:4] == ["place-rsus", "evaluate", "--layout", "layout.json"]

    out = output(run("evaluate --layout", str(layout), *words[4:], "--json"))
    assert json.loads(out)["evaluation"] == by_night["record"]

    line.send(do="question", weather="fog")
    line.next("doing", who="setting")
    line.send(do="undo")  # it is not waited for any longer
    line.next("question")

    assert line.last["question"]["now"]["weather"] == "day"

    line.state()
    assert line.numbers("evaluator")["record"] == by_day["record"]

    told = [
        m["stage"] for m in line.seen if m["type"] == "doing" and m["who"] == "setting"
    ]
    if told[-1]:
        line.next("doing", who="setting", stage="")
    assert line.last["question"]["now"]["weather"] == "day"


@pytest.mark.long
def test_the_optimiser_may_use_a_pole_of_ones_own(open_client, join, small_setting):
    lamp = next(site for site in small_setting.scene.sites if site.id == "lamp-n1")
    line = join(open_client(UNITS[6:7]))
    east = float(lamp.position_m[0])
    north = float(lamp.position_m[1]) + 2.0
    line.send(do="pole", east_m=east, north_m=north)
    (pole,) = line.state()["poles"]

    assert pole["id"] == "own-1"
    assert pole["isOwn"]

    line.send(do="ask", request="why-not", site="own-1")
    answer = line.until(lambda m: m["type"] == "proposals" and len(m["proposals"]) == 2)
    one_more = answer["proposals"][0]

    assert one_more["title"] == "One more unit at own-1"

    line.send(do="take", number=one_more["number"])
    assert [unit["site"] for unit in line.state()["units"]][1:] == ["own-1"]
    assert line.numbers("evaluator")["apr"]  # what hangs there is judged

    line.send(do="remove-pole", site="own-1")
    problem = line.next("problem")
    assert "own-1, which carries" in problem["text"]


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"weather": "snow"}, "weather: got 'snow'"),
        ({"weather": ""}, "weather: got"),
        ({"detector": "/etc/passwd.toml"}, "detector: got"),
        ({"weights": "unfallatlas:/etc/passwd"}, "weights: got"),
        (
            {"cases": "/etc/own.toml"},
            "cases: got '/etc/own.toml'; expected sets and names",
        ),
        ({"cases": "CPXX"}, "cases: got 'CPXX'"),
        ({"cars": "0.5"}, "cars: got '0.5'; expected blind or see"),
        ({"vam_rate": 1.5}, "vam_rate: got 1.5"),
    ],
)
def test_a_question_that_cannot_be_is_refused_at_once(open_client, join, changes, said):
    line = join(open_client(UNITS[:1]))
    line.send(do="question", **changes)
    problem = line.next("problem")

    assert problem["text"].replace("question: ", "").startswith(said)
    assert not any(
        message["type"] == "doing" and message["who"] == "setting"
        for message in line.seen
    )


def test_of_pictures_that_wait_only_the_newest_is_drawn(
    tmp_path, small_setting, monkeypatch
):
    unit = UNITS[7]
    session = small_session(tmp_path, small_setting, units=[unit])
    drawn = []

    def draw(unit, setting, *, width_px, **asked):
        drawn.append(width_px)
        return {}

    monkeypatch.setattr("experiments.planner.views.live_picture", draw)

    async def ask_at_once():
        asked = [
            session.views.camera_picture(unit.id, run_id="", frame=0, width_px=width)
            for width in (100, 200, 300, 400)
        ]
        return await asyncio.gather(*asked, return_exceptions=True)

    answers = asyncio.run(ask_at_once())

    assert drawn == [100, 400]
    assert [type(answer) for answer in answers] == [dict, Cancelled, Cancelled, dict]


# Quickly: tests/experiments/cli/test_sheet.py, report/test_page.py
@pytest.mark.long
@pytest.mark.usefixtures("with_blank_pictures")
def test_report_and_sheet_are_those_of_the_command_line(
    open_client, few_runs, monkeypatch
):
    client = open_client(UNITS[:1])
    sheet = client.get(f"/{TOKEN}/sheet.pdf")
    assert sheet.content.startswith(b"%PDF")

    from experiments.jobs import placement

    monkeypatch.setattr(placement, "write_report", lambda *given, **options: None)
    report = client.get(f"/{TOKEN}/report.zip")
    with zipfile.ZipFile(io.BytesIO(report.content)) as archive:
        summary = json.loads(archive.read("summary.json"))

    assert summary["name"] == "mine"
    assert summary["runs"] == few_runs.axis.n_runs


def test_nothing_hangs_and_there_is_no_layout_to_save(open_client):
    response = open_client().get(f"/{TOKEN}/layout.json")
    assert response.status_code == 400
    assert "no unit" in response.json()["problem"]


def test_the_page_asks_its_own_server_and_that_of_tiles_alone(open_client):
    client = open_client(
        tiles=read_tile_server("https://tiles.example/{z}/{x}/{y}.png", "")
    )
    policy = client.get(f"/{TOKEN}/").headers["content-security-policy"]

    assert "img-src 'self' data: blob: https://tiles.example;" in policy
    assert policy.count("http") == 1

    other = client.get(f"/{TOKEN}/files/page.js").headers["content-security-policy"]
    assert "http" not in other
