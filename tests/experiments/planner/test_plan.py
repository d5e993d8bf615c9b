"""Plans: what changes them, steps back and forth, and files of them."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from pyproj import Transformer

from experiments.planner.changes import Stock, change_state
from experiments.planner.numbers import cost_record, state_record
from experiments.planner.plan import (
    MAX_STEPS,
    MAX_UNITS,
    MAX_VARIANTS,
    History,
    Variant,
    add_variant,
    begin_history,
)
from experiments.planner.plan_files import check_plan, layout_text, plan_text, read_plan
from experiments.planner.poles import lay_poles, with_poles
from experiments.planner.requests import (
    AddUnit,
    AddVariant,
    ChangeUnit,
    PutPole,
    RemovePole,
    RemoveUnit,
    RemoveVariant,
    RenameVariant,
    SelectVariant,
)
from experiments.planner.tiles import read_tile_server, tile_frame
from geometry.catalogue import load_cameras
from geometry.errors import InputError
from geometry.lidar import load_lidars
from geometry.study_scene import load_study_scene
from placement.layout import layout_records, load_carlancap_layout, load_layout

SCENE = load_study_scene()
SITES = {site.id: site for site in SCENE.sites}
CAMERA = "carla-ncap-rgb"
STOCK = Stock(scene=SCENE, models={**load_cameras(), **load_lidars()})
EMPTY = begin_history(()).state


def changed(*changes, state=EMPTY):
    """A state after some changes."""
    for change in changes:
        state = change_state(state, change, STOCK)
    return state


ONE = changed(AddUnit(site="corner-ne", sensor=CAMERA))


def test_a_new_unit_hangs_at_the_pole_and_looks_at_the_middle():
    (unit,) = ONE.variant.units
    site = SCENE.sites[0]

    assert unit.site_id == site.id == "corner-ne"
    assert (unit.pose.position_m[:2] == site.position_m[:2]).all()
    assert site.height_range_m[0] <= unit.pose.position_m[2] <= site.height_range_m[1]
    assert -180.0 < unit.pose.yaw_deg < -90.0  # from the north-east to the south-west


def test_a_unit_is_turned_tilted_raised_moved_and_exchanged():
    state = changed(
        ChangeUnit(
            unit="U1",
            yaw_deg=190.0,
            pitch_deg=-33.25,
            height_m=5.5,
        ),
        ChangeUnit(unit="U1", site="corner-sw"),
        state=ONE,
    )
    (unit,) = state.variant.units

    assert unit.pose.position_m[2] == 5.5
    assert unit.site_id == "corner-sw"

    site = SITES["corner-sw"]
    assert (unit.pose.position_m[:2] == site.position_m[:2]).all()

    state = changed(ChangeUnit(unit="U1", sensor="carla-ncap-lidar"), state=state)
    assert state.variant.units[0].sensor.name == "carla-ncap-lidar"
    assert changed(RemoveUnit(unit="U1"), state=state).variant.units == ()


def target_m(unit):
    """Where the axis of a unit meets the ground."""
    pose = unit.pose
    reach_m = pose.position_m[2] / math.tan(math.radians(-pose.pitch_deg))
    yaw = math.radians(pose.yaw_deg)
    return pose.position_m[:2] + reach_m * np.array([math.cos(yaw), math.sin(yaw)])


@pytest.mark.parametrize("pitch_deg", [-60.0, -20.0, -7.0])
def test_a_unit_that_is_moved_to_another_pole_looks_where_it_looked(pitch_deg):
    before = changed(ChangeUnit(unit="U1", pitch_deg=pitch_deg), state=ONE)
    for site in ("corner-sw", "signal-n"):
        after = changed(ChangeUnit(unit="U1", site=site), state=before)
        (one,) = before.variant.units
        (other,) = after.variant.units
        assert_allclose(target_m(other), target_m(one), atol=1e-3)
    level = changed(ChangeUnit(unit="U1", pitch_deg=0.0), state=ONE)
    (unit,) = changed(
        ChangeUnit(unit="U1", site="corner-sw"), state=level
    ).variant.units

    assert unit.pose.pitch_deg == 0.0


def test_what_scans_all_round_is_level_however_it_comes():
    (unit,) = changed(
        ChangeUnit(unit="U1", sensor="ouster-os1-128"), state=ONE
    ).variant.units
    assert unit.pose.pitch_deg == 0.0

    state = changed(AddUnit(site="corner-sw", sensor="ouster-os1-128"), state=ONE)
    assert state.variant.units[1].pose.pitch_deg == 0.0

    state = changed(ChangeUnit(unit="U2", sensor=CAMERA), state=state)
    assert state.variant.units[1].pose.pitch_deg == ONE.variant.units[0].pose.pitch_deg


def test_a_copy_has_height_and_lens_as_far_as_pole_and_model_have_them():
    site = SITES["corner-sw"]
    low_m, high_m = site.height_range_m
    for height_m, hung_m in (
        (6.25, 6.25),
        (99.0, high_m),
        (0.0, low_m),
    ):
        add = AddUnit(
            site="corner-sw",
            sensor="varifocal-1080p",
            height_m=height_m,
            fov_deg=40.0,
        )
        (unit,) = changed(add).variant.units

        assert unit.pose.position_m[2] - site.position_m[2] == pytest.approx(hung_m)
        assert unit.sensor.horizontal_fov_deg == 40.0

    for asked, said in (
        ({"fov_deg": 5.0}, "lens: got 5.0"),
        ({"height_m": math.nan}, "height: got nan"),
        ({"sensor": "carla-ncap-lidar", "fov_deg": 40.0}, "only cameras have lenses"),
    ):
        with pytest.raises(InputError, match=said):
            changed(
                AddUnit(**{"site": "corner-sw", "sensor": "varifocal-1080p", **asked})
            )


def test_no_way_leads_to_more_units_than_the_limit():
    unit = ONE.variant.units[0]
    many = [replace(unit, id=f"U{index}", site_id="") for index in range(MAX_UNITS + 1)]
    full = ONE.with_units(many[:-1])

    with pytest.raises(InputError, match="units: got 1,001; expected at most 1,000"):
        changed(AddUnit(site="corner-ne", sensor=CAMERA), state=full)
    with pytest.raises(InputError, match="units: got 1,001"):
        Variant(name="many", units=tuple(many))

    record = json.dumps({"layout": [{}] * (MAX_UNITS + 1)}).encode()
    with pytest.raises(
        InputError, match=r"x\.json: units: got 1,001; expected at most 1,000"
    ):
        read_plan(record, "x.json")

    plan = b'{"schema": "place-rsus/plan/1", "variants": [' + record + b"]}"
    with pytest.raises(InputError, match=r"x\.json: variants\[0\]: units: got 1,001"):
        read_plan(plan, "x.json")
    with pytest.raises(InputError, match="variants: got 13; expected at most 12"):
        begin_history([Variant(name="x")] * (MAX_VARIANTS + 1))


def test_variants_from_files_are_told_apart():
    state = begin_history([Variant(name="layout")] * 2).state
    assert [each.name for each in state.variants] == ["layout", "layout (2)"]

    for source in ("north", "south", "south"):
        state = add_variant(state, Variant(name="layout"), source=source)
    names = [each.name for each in state.variants[2:]]
    assert names == ["north: layout", "south: layout", "south: layout (2)"]

    (unnamed,) = read_plan(
        json.dumps({"layout": layout_records(load_carlancap_layout())}).encode(),
        "../a/north.json",
    ).variants
    assert unnamed.name == "north"


def test_a_plan_of_another_scene_is_refused():
    text = plan_text(ONE, replace(SCENE, name="elsewhere")).encode()
    with pytest.raises(
        InputError, match="got one made for elsewhere; expected one of town05"
    ):
        check_plan(read_plan(text, "plan.json"), SCENE)
    check_plan(read_plan(plan_text(ONE, SCENE).encode(), "plan.json"), SCENE)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            AddUnit(site="nowhere", sensor=CAMERA),
            "site: got 'nowhere'; expected a site of town05",
        ),
        (AddUnit(site="corner-ne", sensor="x"), "sensor: got 'x'; expected one of"),
        (
            ChangeUnit(unit="U9", yaw_deg=0.0),
            "unit: got 'U9'; expected one that is mounted there",
        ),
        (
            ChangeUnit(unit="U1", height_m=99.0),
            r"height: got 99.0; expected 4 \.\. 8.5 m, the ran",
        ),
        (
            ChangeUnit(unit="U1", pitch_deg=91.0),
            r"tilt: got 91.0; expected -90 \.\. 90 degrees",
        ),
        (
            ChangeUnit(unit="U1", yaw_deg=float("nan")),
            "direction: got nan; expected a finite",
        ),
        (
            ChangeUnit(unit="U1", fov_deg=50.0),
            "lens: got 50.0; expected .* a fixed lens",
        ),
        (SelectVariant(index=1), "variant: got 1; expected 0 to 0"),
        (RenameVariant(name=" "), "name: got ''; expected 1 to 80 letters"),
        (
            RemoveVariant(),
            "variant: got 'Variant 1'; expected another one: the last one stays",
        ),
    ],
)
def test_what_cannot_be_done_is_told(change, message):
    with pytest.raises(InputError, match=message):
        changed(change, state=ONE)


def test_a_pole_carries_two_units_and_no_third():
    add = AddUnit(site="corner-ne", sensor=CAMERA)
    two = changed(add, state=ONE)

    assert [unit.id for unit in two.variant.units] == ["U1", "U2"]
    with pytest.raises(
        InputError, match="site corner-ne: got one unit more than the 2 there"
    ):
        changed(add, state=two)

    elsewhere = changed(AddUnit(site="corner-sw", sensor=CAMERA), state=two)
    with pytest.raises(InputError, match="site corner-ne"):
        changed(ChangeUnit(unit="U3", site="corner-ne"), state=elsewhere)


def test_variants_are_apart():
    state = changed(
        AddVariant(), RemoveUnit(unit="U1"), RenameVariant(name="without"), state=ONE
    )
    assert [(each.name, len(each.units)) for each in state.variants] == [
        ("Variant 1", 1),
        ("without", 0),
    ]
    assert (
        changed(SelectVariant(index=0), state=state).variant.units == ONE.variant.units
    )
    assert changed(RemoveVariant(), state=state).variants[0].name == "Variant 1"
    with pytest.raises(InputError, match="name: got 'Variant 1'"):
        changed(RenameVariant(name="Variant 1"), state=state)
    with pytest.raises(InputError, match="variants"):
        changed(*[AddVariant()] * MAX_VARIANTS, state=ONE)


@given(st.lists(st.sampled_from(["go", "undo", "redo"]), max_size=60))
def test_undo_and_redo_walk_through_what_was(steps):
    history = begin_history(())
    past = []
    future = []
    now = history.state
    number = 0
    for step in steps:
        if step == "go":
            number += 1
            past = [*past, now]
            future = []
            now = changed(RenameVariant(name=f"{number}"))
            history = history.went_on(now)
        elif step == "undo":
            history = history.undone()
            if past:
                future = [now, *future]
                now = past[-1]
                past = past[:-1]
        else:
            history = history.redone()
            if future:
                past = [*past, now]
                now = future[0]
                future = future[1:]
        assert history.state is now
        assert history.can_undo == bool(past)
        assert history.can_redo == bool(future)


def test_a_drag_is_one_step():
    history = begin_history(()).went_on(ONE)
    for yaw in range(5):
        turned = changed(ChangeUnit(unit="U1", yaw_deg=float(yaw)), state=history.state)
        history = history.went_on(turned, gesture="drag 1")
    assert history.undone().state is ONE

    other = history.went_on(ONE, gesture="drag 2")
    assert other.undone().state is history.state

    for _ in range(3):
        other = other.went_on(ONE, gesture="drag 2")
    given_up = other.reverted("drag 2")

    assert given_up.state == history.state
    assert not given_up.can_redo
    assert given_up.reverted("drag 2") is given_up


def test_the_oldest_steps_are_forgotten():
    history = begin_history(())
    for _ in range(MAX_STEPS + 5):
        history = history.went_on(ONE)
    assert len(history.states) == MAX_STEPS


def test_a_layout_is_saved_as_the_command_line_reads_it(tmp_path):
    study = load_carlancap_layout()
    (tmp_path / "layout.json").write_text(
        layout_text(ONE.with_units(study.units), SCENE)
    )
    back = load_layout(tmp_path / "layout.json")

    assert layout_records(back) == layout_records(study)
    assert back.scene_name == SCENE.name


def test_existing_units_are_told_from_new_ones_and_come_back_with_the_plan():
    state = changed(AddUnit(site="corner-sw", sensor=CAMERA), state=ONE)
    state = replace(state, existing=state.variant.units[:1])
    first, second = state_record(History(states=(state,)), SCENE)["units"]

    assert first["label"] == "U1 (existing)"
    assert second["label"] == "U2"
    assert first["title"].endswith(" (existing)")

    to_buy = cost_record(state.variant.units[1:], SCENE)
    assert cost_record(state.variant.units, SCENE, existing=["U1"]) == to_buy | {
        "kept": "1 sensor exists and is not paid for."
    }

    for text in (plan_text(state, SCENE), layout_text(state, SCENE)):
        (back,) = read_plan(text.encode(), "plan.json").existing
        assert back.id == "U1"
    # Turned it is the unit that exists; at another pole it is a new one.
    turned = changed(ChangeUnit(unit="U1", yaw_deg=10.0), state=state)
    assert turned.existing_ids(turned.variant.units) == {"U1"}

    moved = changed(ChangeUnit(unit="U1", site="corner-nw"), state=state)
    assert moved.existing_ids(moved.variant.units) == frozenset()


def test_a_plan_comes_back_with_all_its_variants():
    state = changed(
        AddVariant(name="more"), AddUnit(site="corner-sw", sensor=CAMERA), state=ONE
    )
    state = changed(AddVariant(name="none"), RemoveUnit(unit="U1"), state=state)
    state = changed(RemoveUnit(unit="U2"), state=state)
    back = read_plan(plan_text(state, SCENE).encode(), "plan.json").variants

    assert [each.name for each in back] == ["Variant 1", "more", "none"]

    for one, other in zip(back, state.variants, strict=True):
        if one.units:
            assert layout_records(one.layout(SCENE)) == layout_records(
                other.layout(SCENE)
            )
        else:
            assert other.units == ()
    (alone,) = read_plan(layout_text(ONE, SCENE).encode(), "layout.json").variants
    assert layout_records(alone.layout(SCENE)) == layout_records(
        ONE.variant.layout(SCENE)
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (b"{", "x.json: got "),
        (b"\xff", "x.json: got "),
        (b"[" * 100_000, "x.json: got "),
        (b"[]", "x.json: got no list 'layout'"),
        (
            b'{"schema": "place-rsus/plan/1", "variants": []}',
            "x.json: variants: got none",
        ),
        (b'{"schema": "place-rsus/plan/1", "variants": [1]}', r"variants\[0\]: got 1"),
        (
            json.dumps(
                {"schema": "place-rsus/plan/1", "variants": [{"layout": [{}]}]}
            ).encode(),
            r"variants\[0\]: layout\[0\].id: got nothing",
        ),
    ],
)
def test_what_is_no_plan_is_told(text, message):
    with pytest.raises(InputError, match=message):
        read_plan(text, "x.json")


# ---------- poles of one's own


def beside(site_id, east_m, north_m):
    """A place beside a site: east, north. [m]"""
    east, north, _ = SITES[site_id].position_m
    return float(east + east_m), float(north + north_m)


def on_pole(state, *changes):
    """Changes one by one, each among the poles that are there by then."""
    for change in changes:
        stock = replace(STOCK, scene=with_poles(SCENE, state.poles))
        state = change_state(state, change, stock)
    return state


def test_an_own_pole_is_as_most_are_and_moves_with_what_hangs_on_it():
    east, north = beside("lamp-n1", 0, 2)
    added = AddUnit(site="own-1", sensor=CAMERA)
    state = on_pole(EMPTY, PutPole(east_m=east, north_m=north), added, AddVariant())
    (pole,) = state.poles

    assert pole.id == "own-1"
    assert pole.kind == "lamp post"
    assert pole.capacity_units == 2
    assert pole.height_range_m.tolist() == [4.0, 8.5]

    moved = on_pole(state, PutPole(east_m=east, north_m=north + 2.0, site="own-1"))
    for before, after in zip(state.variants, moved.variants, strict=True):
        step_m = after.units[0].pose.position_m - before.units[0].pose.position_m
        # To whole centimetres.
        assert step_m == pytest.approx([0.0, 2.0, 0.0], abs=0.02)
        assert after.units[0].pose.yaw_deg == before.units[0].pose.yaw_deg
    take_down = RemovePole(site="own-1")

    with pytest.raises(InputError, match="own-1, which carries U1 of Variant 1"):
        on_pole(moved, take_down)

    bare = on_pole(
        moved, RemoveUnit(unit="U1"), SelectVariant(index=0), RemoveUnit(unit="U1")
    )
    assert on_pole(bare, take_down).poles == ()


@pytest.mark.parametrize(
    ("place_m", "said"),
    [
        (SCENE.outline_m.mean(axis=0), "a place on the carriageway"),
        ((5000.0, 0.0), "a place farther away"),
        ((math.nan, 0.0), "a finite number"),
    ],
)
def test_a_pole_stands_beside_the_road_not_far_away(place_m, said):
    east, north = place_m
    with pytest.raises(InputError, match=said):
        on_pole(EMPTY, PutPole(east_m=float(east), north_m=float(north)))


def test_a_pole_stands_in_no_building():
    for index, instance in enumerate(SCENE.instances):
        if instance.class_name == "building":
            triangles = SCENE.triangles[SCENE.triangle_instance == index]
            corners_m = SCENE.vertices_m[triangles].reshape(-1, 3)
            east, north, _ = corners_m.mean(axis=0).tolist()
            with pytest.raises(
                InputError, match=f"a place inside building {instance.id}"
            ):
                on_pole(EMPTY, PutPole(east_m=east, north_m=north))


def test_a_pole_of_the_scene_is_not_moved():
    with pytest.raises(InputError, match="pole: got 'corner-ne'"):
        on_pole(EMPTY, PutPole(east_m=0.0, north_m=0.0, site="corner-ne"))


def test_files_have_own_poles_and_every_command_reads_what_hangs_there(tmp_path):
    east, north = beside("lamp-n1", 0, 2)
    added = AddUnit(site="own-1", sensor=CAMERA)
    state = on_pole(EMPTY, PutPole(east_m=east, north_m=north), added)
    for write in (layout_text, plan_text):
        text = write(state, SCENE)
        opened = read_plan(text.encode(), "file.json")
        check_plan(opened, SCENE)
        again = lay_poles(begin_history(opened.variants).state, opened.poles, SCENE)

        assert [pole.id for pole in again.poles] == ["own-1"]
        assert (again.poles[0].position_m == state.poles[0].position_m).all()
        assert again.variant.units[0].site_id == "own-1"
    path = tmp_path / "layout.json"
    path.write_text(layout_text(state, SCENE))
    (unit,) = load_layout(path).units

    assert unit.site_id == ""
    assert (unit.pose.position_m == state.variant.units[0].pose.position_m).all()

    broken = layout_text(state, SCENE).replace('"x_m"', '"x"', 3)
    with pytest.raises(InputError):
        read_plan(broken.encode(), "file.json")


# ---------- tiles of a server


@pytest.mark.parametrize(
    "crs",
    [
        SCENE.crs,
        # UTM, whose north is not that of the map, with its zero in Munich.
        "+proj=tmerc +lat_0=0 +lon_0=9 +k=0.9996 +x_0=-191000 +y_0=-5335000"
        " +ellps=GRS80 +units=m +no_defs",
        "+proj=tmerc +lat_0=-33.9 +lon_0=151.2 +k=1 +datum=WGS84 +units=m +no_defs",
    ],
)
def test_tiles_and_places_of_the_plan_lead_to_each_other_as_by_pyproj(crs):
    scene = replace(SCENE, crs=crs)
    frame = tile_frame(scene)
    away_m = np.random.default_rng(1).uniform(-1400.0, 1400.0, (200, 2))
    places_m = scene.outline_m.mean(axis=0) + away_m
    to_mercator = Transformer.from_crs(crs, "EPSG:3857", always_xy=True)
    whole_m = 2.0 * np.pi * 6378137.0
    east, north = np.array(to_mercator.transform(*places_m.T)) / whole_m
    tiles = (np.column_stack([east + 0.5, 0.5 - north]) - frame["middle"]) / frame[
        "size"
    ]
    plan = (100.0 * places_m - frame["centre"]) / frame["reach"]

    def fitted(given, fit):
        u, v = given.T
        powers = [
            1 + 0 * u,
            u,
            v,
            u * u,
            u * v,
            v * v,
            u**3,
            u * u * v,
            u * v * v,
            v**3,
        ]
        return np.stack(powers, 1) @ np.array(fit)

    assert_allclose(fitted(tiles, frame["toPlan"]), plan, atol=1e-3 / 1500.0)
    assert_allclose(fitted(plan, frame["toTiles"]), tiles, atol=1e-3 / 1500.0)


def test_a_scene_of_no_known_place_has_no_tiles():
    assert tile_frame(replace(SCENE, crs="")) is None


@pytest.mark.parametrize(
    ("template", "origin"),
    [
        ("https://tiles.example/{z}/{x}/{y}.png", "https://tiles.example"),
        ("http://127.0.0.1:8080/a/{z}/{y}/{x}?key=1", "http://127.0.0.1:8080"),
    ],
)
def test_the_page_may_ask_the_named_server_alone(template, origin):
    server = read_tile_server(template, "")
    assert server.origin == origin
    assert server.attribution == origin.split("/")[2].split(":")[0]


@pytest.mark.parametrize(
    "template",
    [
        "tiles.example/{z}/{x}/{y}.png",
        "ftp://tiles.example/{z}/{x}/{y}.png",
        "https://tiles.example/{z}/{x}.png",
        "https://tiles.example/{z}/{x}/{y}/{y}.png",
        "https://{s}.tiles.example/{z}/{x}/{y}.png",
        "https://tiles.example/{s}/{z}/{x}/{y}.png",
        "https://tiles.example:99999/{z}/{x}/{y}.png",
        "https://me@tiles.example/{z}/{x}/{y}.png",
        "https://tiles.example; script-src *;/{z}/{x}/{y}.png",
        "https://tiles.example *.evil/{z}/{x}/{y}.png",
        "https://tiles.example/{z}/{x}/{y}.png\n",
        "https:///{z}/{x}/{y}.png",
    ],
)
def test_an_address_that_is_none_of_tiles_is_refused(template):
    with pytest.raises(
        InputError, match=r"--tiles: got .*; expected an address such as https://"
    ):
        read_tile_server(template, "")
