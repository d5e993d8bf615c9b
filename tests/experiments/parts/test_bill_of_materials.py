"""The bill: sensors and sites with their prices, in tables and as a file."""

import csv
import io
from dataclasses import replace

import pytest
from partial_pages import render_section

from experiments.parts.bill_of_materials import (
    bill_of_materials_csv,
    bill_section,
    bill_sentences,
    bill_tables,
    build_bill,
)
from geometry.lidar import load_lidars
from geometry.notes import Note
from geometry.poses import Pose
from geometry.study_scene import load_study_scene
from placement.candidates import CandidatePose
from placement.layout import Layout
from placement.wishes import load_prices


@pytest.fixture(scope="module")
def scene():
    """The study's junction; the first site costs 800 EUR, the others have no price."""
    study = load_study_scene()
    first, *others = study.sites
    return replace(study, sites=(replace(first, cost_eur=800.0), *others))


@pytest.fixture
def build(camera, scene):
    """A layout of units, each said as "site index" or "" and its model."""
    models = {
        "camera": camera,
        "lidar": load_lidars()["carla-ncap-lidar"],
        "own": replace(camera, name="=own<b>", price_eur=0.0),
    }

    def build_layout(*units):
        return Layout(
            name="mine",
            units=tuple(
                CandidatePose(
                    id=f"U{number}",
                    site_id="" if index is None else scene.sites[index].id,
                    pose=Pose(position_m=[0.0, 0.0, 6.0], yaw_deg=0.0),
                    sensor=models[model],
                )
                for number, (index, model) in enumerate(units)
            ),
        )

    return build_layout


def test_sensors_are_counted_by_model_and_sites_are_paid_once(build, scene):
    layout = build((0, "camera"), (0, "lidar"), (1, "camera"))
    kind = scene.sites[1].kind
    assumed_eur = load_prices().cost_eur(scene.sites[1])
    bill = build_bill(layout, scene)
    camera, lidar = bill.sensors

    assert camera.kind == "camera"
    assert camera.count == 2
    assert camera.price_eur == 1500.0
    assert camera.sum_eur == 3000.0
    assert lidar.kind == "LiDAR"
    assert lidar.count == 1
    assert lidar.sum_eur == 4000.0
    assert [(site.name, site.n_units, site.sum_eur) for site in bill.sites] == [
        (scene.sites[0].id, 2, 800.0),
        (scene.sites[1].id, 1, assumed_eur),
    ]
    assert [site.price_source for site in bill.sites] == ["told", "assumption"]
    assert bill.sites_eur == 800.0 + assumed_eur
    assert bill_sentences(bill) == [
        f"All lines together: {7800 + assumed_eur:,.0f} EUR."
    ]
    assert bill.assumed[0].startswith(
        f"No price is known for 1 site of the kind {kind}:"
    )

    sensors, sites = bill_tables(bill)
    assert sensors.rows[-1] == ["all", "", "3", "", "7,000"]
    assert sites.rows[-1] == ["all", "", "3", f"{800 + assumed_eur:,.0f}", ""]
    assert {len(row) for row in sensors.rows} == {len(sensors.columns)}
    assert {len(row) for row in sites.rows} == {len(sites.columns)}


def test_what_is_unknown_is_never_zero(build, scene):
    bill = build_bill(build((None, "own")), scene)
    assert bill_sentences(bill) == ["No price is known."]
    assert bill.sites_eur is None

    sensors, sites = bill_tables(bill)
    assert sensors.rows[0][3:] == ["unknown"] * 2
    assert [row[3] for row in sites.rows] == ["unknown"] * 2

    rows = list(csv.DictReader(io.StringIO(bill_of_materials_csv(bill))))
    assert all(row["price_eur"] == row["sum_eur"] == "" for row in rows)


def test_a_price_for_every_site_that_was_asked_for_is_known_also_where_it_is_zero(
    build, scene
):
    layout = build((0, "camera"), (1, "camera"), (None, "camera"), (None, "camera"))
    for cost_eur in (0.0, 250.0):
        bill = build_bill(layout, scene, site_cost_eur=cost_eur)
        assert [site.sum_eur for site in bill.sites] == [
            cost_eur,
            cost_eur,
            2.0 * cost_eur,
        ]

        whole = f"{6000.0 + 4.0 * cost_eur:,.0f} EUR"
        assert bill_sentences(bill) == [f"All lines together: {whole}."]


def test_what_hangs_there_already_is_not_paid_for(build, scene):
    layout = build((0, "camera"), (0, "camera"), (1, "camera"))
    bill = build_bill(layout, scene, kept_ids=("U0",), site_cost_eur=100.0)
    (camera,) = bill.sensors

    assert camera.n_units == 3
    assert camera.count == 2
    assert camera.sum_eur == 3000.0
    assert [site.sum_eur for site in bill.sites] == [0.0, 100.0]

    sensors, sites = bill_tables(bill)
    assert sensors.columns[2:4] == ["units", "to buy"]
    assert sites.rows[0][3] == "already there"


def test_the_file_has_the_same_items(build, scene):
    bill = build_bill(build((0, "own"), (0, "camera"), (None, "camera")), scene)
    rows = list(csv.DictReader(io.StringIO(bill_of_materials_csv(bill))))
    assert [
        (row["part"], row["name"], row["units"], row["sum_eur"]) for row in rows
    ] == [
        ("sensor", "'=own<b>", "1", ""),
        ("sensor", "carla-ncap-rgb", "2", "3000"),
        ("site", scene.sites[0].id, "2", "800"),
        ("site", "no site of the scene", "1", ""),
    ]


def test_the_part_renders_escaped_and_says_what_is_not_in_it(build, scene):
    part = bill_section(build_bill(build((0, "own")), scene))
    page = render_section(part)

    assert "<b>" not in page
    assert "=own&lt;b&gt;" in page
    assert "calibration (about 10,000 EUR, assumed)" in page
    assert "Also not included:" in page


def test_assumed_sites_are_marked_in_table_and_file(build, scene):
    note = Note(
        what="2 masts",
        why="none in the map",
        kind="sites",
        site_ids=(scene.sites[1].id,),
    )
    bill = build_bill(
        build((0, "camera"), (1, "camera")), replace(scene, notes=(note,))
    )

    assert [item.assumed for item in bill.sites] == ["", "none in the map"]
    assert bill_tables(bill)[1].rows[1][0] == f"{scene.sites[1].id} (assumed)"

    rows = list(csv.DictReader(io.StringIO(bill_of_materials_csv(bill))))
    assert [row["assumed"] for row in rows if row["part"] == "site"] == [
        "",
        "none in the map",
    ]
