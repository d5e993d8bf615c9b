"""Detections as numpy finds them, array by array: the oracle of the loops in ``projecting``.

Nothing is left out: every point of every body is projected into every camera, whether or not it is
in the field of view. Sums are made in the same order, so that boxes are the same to the last bit
but for points that only rounding puts outside the convex hull.
"""

from dataclasses import dataclass

import numpy as np

from geometry.image_boxes import clip_boxes
from geometry.lidar import LidarModel
from geometry.poses import body_rotation, camera_rotation
from placement.detectors import Evidence
from placement.visibility import sensing as compiled

MIN_DEPTH_M = np.float32(0.01)


@dataclass
class NumpySensing:
    """As :class:`placement.visibility.sensing.Sensing`, which it is made of."""

    sensing: compiled.Sensing

    def evidence(self, candidate) -> Evidence:
        """Evidence of a camera for every entry, at full contrast."""
        made, camera, pose = self.sensing, candidate.sensor, candidate.pose
        sight = made.sight
        eye = made.eye_m.astype(np.float32)
        x, y, z = np.moveaxis(made.world.views.points_m[sight.view_index] - eye, -1, 0)
        r = camera_rotation(pose.yaw_deg, pose.pitch_deg).astype(np.float32)
        right, down, depth = (x * r[0, i] + y * r[1, i] + z * r[2, i] for i in range(3))
        per_depth = np.float32(camera.focal_length_px) / np.maximum(depth, MIN_DEPTH_M)
        width, height = np.float32(camera.width_px), np.float32(camera.height_px)
        half_width, half_height = np.float32(0.5) * width, np.float32(0.5) * height
        columns = right * per_depth + half_width
        rows = down * per_depth + half_height
        nothing = np.zeros(columns.shape, dtype=bool)
        whole = boxes(columns, rows, nothing)
        # Of a body that the image cuts off, only the points inside the image count.
        limits = np.array([width, height] * 2)
        is_cut = (whole < 0.0).any(axis=1) | (whole > limits).any(axis=1)
        is_cut |= (depth <= MIN_DEPTH_M).any(axis=1)
        is_outside = is_cut[:, None] & (
            (depth <= MIN_DEPTH_M)
            | (np.abs(columns - half_width) > half_width)
            | (np.abs(rows - half_height) > half_height)
        )
        # The visible part of a body that nothing else hides has the body's own box.
        hidden = ~sight.is_visible & ~sight.is_whole[:, None]
        inside = clip_boxes(whole, width_px=camera.width_px, height_px=camera.height_px)
        return Evidence(
            visible_px=boxes(columns, rows, hidden | is_outside),
            amodal_px=boxes(columns, rows, is_outside),
            contrast=np.ones(len(whole)),
            visible_share=sight.visible_share,
            inside_share=areas(inside) / np.maximum(areas(whole), 1.0e-9),
            aspect_deg=made.aspect_deg,
            vru_class=made.vru_class,
            draw_index=np.arange(len(whole)),
        )

    def detected(self, candidate):
        """Whether each entry is detected in each weather, (n_weathers, n)."""
        made = self.sensing
        if isinstance(candidate.sensor, LidarModel):
            rotation = body_rotation(candidate.pose.yaw_deg, candidate.pose.pitch_deg)
            return compiled._count(
                made, np.arange(len(made.distance_m)), rotation, candidate.sensor
            )
        evidence = self.evidence(candidate)
        found = []
        for contrast in made.contrast:
            fields = {name: getattr(evidence, name) for name in evidence.__dataclass_fields__}
            found.append(made.detector.is_expected(Evidence(**fields | {"contrast": contrast})))
        return np.array(found)


def boxes(columns, rows, hidden):
    """Boxes around the points of each entry that are not hidden, (n, 4); zeros where all are."""
    found = np.empty((len(columns), 4))
    for axis, values in enumerate((columns, rows)):
        found[:, axis] = np.where(hidden, np.inf, values).min(axis=1)
        found[:, axis + 2] = np.where(hidden, -np.inf, values).max(axis=1)
    found[found[:, 0] > found[:, 2]] = 0.0
    return found


def areas(boxes_px):
    return (boxes_px[:, 2:] - boxes_px[:, :2]).prod(axis=1)
