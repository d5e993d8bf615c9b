"""Recordings of the server that stands in for CARLA, compared with the runs that it drove."""

import carla_server
import numpy as np
import pytest

from geometry.sensors import project_points
from geometry.study_scene import load_study_scene
from placement.layout import Layout, load_carlancap_layout
from placement.recordings.read import read_recording

SCENE = load_study_scene()
STUDY = load_carlancap_layout()
TWO = Layout(name="two", units=(STUDY.units[0], STUDY.units[7]), scene_name=STUDY.scene_name)
RUNS = {"walker.pedestrian.0005": "CPNC-50/east/40", "walker.pedestrian.0048": "CPNCO-50/east/20",
        "vehicle.diamondback.century": "CBTAfs-100/north/20"}  # fmt: skip


def box_of_body(run, blueprint, frame, unit):
    """Box of the blueprint's box where the run has the road user, by this project's own rules."""
    _, half, _ = carla_server.BOXES[blueprint]
    corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (0, 2)]) * half
    yaw = np.radians(run.vru_yaw_deg[frame])
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    world_m = corners @ turn.T + np.append(run.vru_position_m[frame], 0.0)
    columns, rows, _ = project_points(world_m, unit.pose, unit.sensor).T
    low, high = np.zeros(2), [unit.sensor.width_px, unit.sensor.height_px]
    return np.concatenate(
        [np.clip([side(columns), side(rows)], low, high) for side in (np.min, np.max)]
    )


def compare(out, run, blueprint, layout=TWO):
    """The recording, read back, with what the run and our projection say."""
    found = read_recording(out)
    assert (found.units, found.has_vut) == (("0", "1"), True)
    assert found.skipped == {}
    (drive,) = found.drives
    assert drive.n_frames == len(run.time_s)
    assert drive.n_missing == 0
    assert drive.vut_speed_mps == pytest.approx(run.vut_speed_kmh / 3.6)
    assert drive.vru_speed_mps == pytest.approx(run.case.vru_speed_kmh / 3.6)
    assert drive.vru_class == ("bicycle" if "vehicle" in blueprint else "pedestrian")
    apart_m = np.linalg.norm(run.vut_position_m - run.vru_position_m, axis=1)
    # CARLA's origins: a walker's is as high as its middle, others are centimetres off.
    assert (np.abs(drive.distance_m - apart_m) < 0.45).all()
    n_labels = n_found = 0
    for number, unit in enumerate(layout.units):
        for key, labels in found.labels[str(number)].items():
            ours = box_of_body(run, blueprint, key.number, unit)
            for label in labels:
                n_labels += 1
                assert np.isfinite(ours).all()
                if (np.array(label.box_px) - ours)[2:].min() > -1.01:  # nothing in front of it
                    np.testing.assert_allclose(label.box_px, ours, atol=1.01)  # whole pixels
        for key, detections in found.detections[str(number)].items():
            (label,) = found.labels[str(number)][key]
            for detection in detections:
                n_found += 1
                ours = box_of_body(run, blueprint, key.number, unit)
                np.testing.assert_allclose(detection.box_px, ours, atol=0.02)
                assert label.box_px[3] - label.box_px[1] >= 40.0
    assert n_labels > 20
    assert n_found > 10
    return found
