"""Variants of the study, each changed in one thing."""

import numpy as np
import pytest

from experiments.study.reproduction import OWN_CASES, build_variants, move_walls
from geometry.study_scene import load_study_scene
from placement.detectors.geometric import GeometricDetector


@pytest.fixture(scope="module")
def variants():
    return {variant.name: variant for variant in build_variants()}


def _wall_vertices(scene):
    """Indices of the corners of a scene's walls."""
    walls = [i for i, thing in enumerate(scene.instances) if thing.class_name == "wall"]
    return np.unique(scene.triangles[np.isin(scene.triangle_instance, walls)])


def test_walls_move_towards_the_middle_and_nothing_else_does():
    scene = load_study_scene()
    moved = move_walls(scene, 0.5)
    walls = _wall_vertices(scene)
    shift = moved.vertices_m - scene.vertices_m

    assert np.abs(shift[walls, :2]) == pytest.approx(0.5)
    assert (shift[:, 2] == 0.0).all()

    rest = np.setdiff1d(np.arange(len(shift)), walls)
    assert (shift[rest] == 0.0).all()

    # The end of each wall at its corner comes nearer to the middle of the junction.
    middle = scene.outline_m.mean(axis=0)
    near, far = (
        np.linalg.norm(s.vertices_m[walls, :2] - middle, axis=1).min()
        for s in (moved, scene)
    )

    assert near < far

    back = move_walls(moved, -0.5)
    assert back.vertices_m == pytest.approx(scene.vertices_m)


@pytest.mark.long
def test_every_variant_changes_one_thing_of_the_studys_own_cases(variants):
    base = variants["as it is"]
    assert set(base.setting.axis.cases) == set(OWN_CASES.split(","))

    for variant in variants.values():
        assert variant.setting.axis.run_ids == base.setting.axis.run_ids
        assert len(variant.layout.units) == 12

    two = variants["two parked cars instead of eight"].setting.runs
    assert max(len(run.obstruction) for run in two) == 2
    assert not any(run.obstruction for run in variants["no parked cars"].setting.runs)

    for name, height_px in (
        ("smallest box 30 px", 30.0),
        ("smallest box 50 px", 50.0),
    ):
        detector = variants[name].setting.detector
        assert isinstance(detector, GeometricDetector)
        assert detector.min_box_height_px == height_px

    narrow = variants["field of view 90 deg, not 110"]

    assert narrow.setting.vut_camera.horizontal_fov_deg == 90.0
    assert {unit.sensor.horizontal_fov_deg for unit in narrow.layout.units} == {90.0}


@pytest.mark.long
def test_the_parked_row_moves_to_the_right_of_the_vut(variants):
    moved = variants["parked row 1 m beside the VUT, not 0.5 m"].setting.runs
    for old, new in zip(variants["as it is"].setting.runs, moved, strict=True):
        yaw = np.radians(old.vut_yaw_deg[0])
        right = np.array([np.sin(yaw), -np.cos(yaw)])
        for before, after in zip(old.obstruction, new.obstruction, strict=True):
            shift = (after.pose.position_m - before.pose.position_m)[:2]
            assert shift == pytest.approx(0.5 * right)
