"""Variants of the study, each changed in one thing."""

import numpy as np
import pytest

from experiments.study.reproduction import OWN_CASES, build_variants, move_walls
from geometry.study_scene import load_study_scene
from placement.detectors.geometric import GeometricDetector


@pytest.fixture(scope="module")
def variants():
    """All variants by their names."""
    return {variant.name: variant for variant in build_variants()}


def _wall_vertices(scene):
    """Indices of the corners of a scene's walls."""
    kinds = np.array([thing.class_name for thing in scene.instances])
    walls = np.flatnonzero(kinds == "wall")
    is_wall = np.isin(scene.triangle_instance, walls)
    return np.unique(scene.triangles[is_wall])


def _nearest_m(places_m, point_m):
    """Least distance of places from a point on the ground."""
    distances_m = np.linalg.norm(places_m[:, :2] - point_m, axis=1)
    return distances_m.min()


def test_walls_move_towards_the_middle_and_nothing_else_does():
    """By half a metre along both axes; moved back, they are where they were."""
    scene = load_study_scene()
    moved = move_walls(scene, 0.5)
    walls = _wall_vertices(scene)
    shift = moved.vertices_m - scene.vertices_m
    aside = shift[:, :2]
    up = shift[:, 2]

    assert len(walls) > 0
    assert np.abs(aside[walls]) == pytest.approx(0.5)
    assert (up == 0.0).all()

    every = np.arange(len(shift))
    rest = np.setdiff1d(every, walls)

    assert (shift[rest] == 0.0).all()

    # The end of each wall at its corner comes nearer to the middle of the junction.
    middle = scene.outline_m.mean(axis=0)
    moved_corners = moved.vertices_m[walls]
    corners = scene.vertices_m[walls]
    near_m = _nearest_m(moved_corners, middle)
    far_m = _nearest_m(corners, middle)

    assert near_m < far_m

    back = move_walls(moved, -0.5)
    assert back.vertices_m == pytest.approx(scene.vertices_m)


@pytest.mark.long
def test_every_variant_changes_one_thing_of_the_studys_own_cases(variants):
    """The runs stay the same; bodies beside them, detector or cameras change."""
    base = variants["as it is"]
    own_cases = set(OWN_CASES.split(","))

    assert set(base.setting.axis.cases) == own_cases

    for variant in variants.values():
        assert variant.setting.axis.run_ids == base.setting.axis.run_ids
        assert len(variant.layout.units) == 12

    two = variants["two parked cars instead of eight"].setting
    none = variants["no parked cars"].setting
    n_parked = [len(run.obstruction) for run in two.runs]

    assert max(n_parked) == 2

    for run in none.runs:
        assert not run.obstruction

    for name, height_px in (
        ("smallest box 30 px", 30.0),
        ("smallest box 50 px", 50.0),
    ):
        setting = variants[name].setting
        detector = setting.detector
        assert isinstance(detector, GeometricDetector)
        assert detector.min_box_height_px == height_px

    narrow = variants["field of view 90 deg, not 110"]
    fields_deg = {unit.sensor.horizontal_fov_deg for unit in narrow.layout.units}

    assert narrow.setting.vut_camera.horizontal_fov_deg == 90.0
    assert fields_deg == {90.0}


@pytest.mark.long
def test_the_parked_row_moves_to_the_right_of_the_vut(variants):
    """By half a metre more."""
    base = variants["as it is"].setting
    moved = variants["parked row 1 m beside the VUT, not 0.5 m"].setting

    for old, new in zip(base.runs, moved.runs, strict=True):
        # To the right of where the VUT comes from.
        yaw = np.radians(old.vut_yaw_deg[0])
        right = np.array([np.sin(yaw), -np.cos(yaw)])
        for before, after in zip(old.obstruction, new.obstruction, strict=True):
            old_m = before.pose.position_m
            new_m = after.pose.position_m
            shift_m = new_m - old_m
            assert shift_m[:2] == pytest.approx(0.5 * right)
