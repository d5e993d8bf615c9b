"""The same answers by other, slower ways: nothing here calls the code under test."""

import math

import numpy as np

from geometry.footprints import footprint_corners, footprint_separation


def rectangle_polygon(centre, yaw_deg, length_m, width_m):
    """Corners of a rectangle, counter-clockwise, as plain tuples."""
    yaw = math.radians(yaw_deg)
    c = math.cos(yaw)
    s = math.sin(yaw)
    return [
        (centre[0] + x * c - y * s, centre[1] + x * s + y * c)
        for x, y in (
            (length_m / 2, width_m / 2),
            (-length_m / 2, width_m / 2),
            (-length_m / 2, -width_m / 2),
            (length_m / 2, -width_m / 2),
        )
    ]


def polygon_area(polygon):
    """Shoelace formula; positive for counter-clockwise corners."""
    return 0.5 * sum(
        a[0] * b[1] - b[0] * a[1]
        for a, b in zip(polygon, polygon[1:] + polygon[:1], strict=True)
    )


def overlap_area(polygon_a, polygon_b):
    """Area that two convex polygons share: Sutherland and Hodgman's clipping, edge by
    edge.
    """
    rest = list(polygon_a)
    for (ax, ay), (bx, by) in zip(
        polygon_b, polygon_b[1:] + polygon_b[:1], strict=True
    ):
        side = [(bx - ax) * (y - ay) - (by - ay) * (x - ax) for x, y in rest]
        kept = []
        for index, here in enumerate(rest):
            before = rest[index - 1]
            d_here = side[index]
            d_before = side[index - 1]
            if (d_here >= 0.0) != (d_before >= 0.0):
                share = d_before / (d_before - d_here)
                kept.append(
                    (
                        before[0] + share * (here[0] - before[0]),
                        before[1] + share * (here[1] - before[1]),
                    )
                )
            if d_here >= 0.0:
                kept.append(here)

        rest = kept
        if not rest:
            return 0.0

    return polygon_area(rest)


def polygon_distance(polygon_a, polygon_b):
    """Distance of two polygons that do not overlap: every corner to every side."""

    def to_side(p, a, b):
        px = p[0] - a[0]
        py = p[1] - a[1]
        sx = b[0] - a[0]
        sy = b[1] - a[1]
        share = min(1.0, max(0.0, (px * sx + py * sy) / (sx * sx + sy * sy)))
        return math.hypot(px - share * sx, py - share * sy)

    return min(
        to_side(corner, here[index - 1], here[index])
        for corners, here in (
            (polygon_a, polygon_b),
            (polygon_b, polygon_a),
        )
        for corner in corners
        for index in range(4)
    )


def simulated_contact(encounter, onset_s, *, deceleration_mps2, time_step_s=5.0e-4):
    """Whether the bodies overlap, by stepping both forward from the onset until the VUT
    stands.
    """
    vut = encounter.vut
    vru = encounter.vru

    def at_onset(motion):
        yaw = math.radians(motion.path.yaw_deg)
        driven = motion.speed_mps * max(0.0, onset_s - motion.start_time_s)
        ahead = (math.cos(yaw), math.sin(yaw))
        start = motion.path.start_m
        return [start[0] + driven * ahead[0], start[1] + driven * ahead[1]], ahead

    vut_at, vut_ahead = at_onset(encounter.vut_motion)
    vru_at, vru_ahead = at_onset(encounter.vru_motion)
    speed = encounter.vut_motion.speed_mps
    time = onset_s
    reach = 0.5 * (
        math.hypot(vut.length_m, vut.width_m) + math.hypot(vru.length_m, vru.width_m)
    )

    while speed > 0.0:
        next_speed = max(0.0, speed - deceleration_mps2 * time_step_s)
        step_s = (speed - next_speed) / deceleration_mps2
        vru_step_m = encounter.vru_motion.speed_mps * step_s
        if time < encounter.vru_motion.start_time_s:
            vru_step_m = 0.0
        for axis in (0, 1):
            vut_at[axis] += vut_ahead[axis] * 0.5 * (speed + next_speed) * step_s
            vru_at[axis] += vru_ahead[axis] * vru_step_m
        speed = next_speed
        time = time + step_s
        if math.dist(vut_at, vru_at) > reach:
            continue
        overlap = overlap_area(
            rectangle_polygon(
                vut_at, encounter.vut_motion.path.yaw_deg, vut.length_m, vut.width_m
            ),
            rectangle_polygon(
                vru_at, encounter.vru_motion.path.yaw_deg, vru.length_m, vru.width_m
            ),
        )
        if overlap > 1.0e-9:
            return True

    return False


def stop_tau_s(v, a):
    """Latest onset before the impact for a body in the way: the VUT stops short."""
    return v / (2.0 * a)


def crossing_tau_s(v, a, clear_s):
    """The same for one that has left the VUT's path `clear_s` after the unbraked
    impact.

    The front covers the distance v tau to the line of impact. It may stop short, or it
    may reach the line after the VRU is gone: v t - a t^2 / 2 = v tau at t = tau +
    clear_s.
    """
    t = math.sqrt(2.0 * v * clear_s / a)
    if t <= v / a:
        return t - clear_s
    return stop_tau_s(v, a)


def slab_hits(origins, vectors, low, high):
    """Rays against an axis-aligned box: share of the vector at entry and at exit.

    Kay and Kajiya's slabs. The ray's line meets the box where entry <= exit.
    """
    with np.errstate(divide="ignore"):
        a = (low - origins) / vectors
        b = (high - origins) / vectors
    return np.minimum(a, b).max(axis=1), np.maximum(a, b).min(axis=1)


def simulated_track_s(detected, time_s, *, until_s, memory_s, n):
    """Frame by frame: when the track was confirmed that is alive at a time; infinite if
    none is.
    """
    confirmed_s = math.inf
    last_s = -math.inf
    n_in_a_row = 0
    for is_seen, now_s in zip(detected, time_s, strict=True):
        if now_s > until_s + 1e-9:
            break
        if now_s - last_s > memory_s + 1e-9:
            confirmed_s = math.inf  # the track is lost
        if is_seen:
            n_in_a_row = n_in_a_row + 1
        else:
            n_in_a_row = 0
        if is_seen:
            last_s = now_s
            if n_in_a_row >= n and confirmed_s == math.inf:
                confirmed_s = now_s
        # A frame in which nothing is seen changes nothing: the age is asked for when it
        # matters.
    if until_s - last_s > memory_s + 1e-9:
        return math.inf
    return confirmed_s


def naive_confirmed(detected, n):
    """Confirmation frame by frame, with a counter."""
    counter = 0
    confirmed = []
    for seen in detected:
        if seen:
            counter = counter + 1
        else:
            counter = 0
        confirmed.append(counter >= n)

    return confirmed


def separation_m(encounter, time_s):
    """Separation of the footprints at times if nobody brakes, from their corners."""
    corners = []
    for body, motion in (
        (encounter.vut, encounter.vut_motion),
        (encounter.vru, encounter.vru_motion),
    ):
        position, yaw = motion.path.at(motion.distance_m(time_s))
        corners.append(
            footprint_corners(
                position, yaw, length_m=body.length_m, width_m=body.width_m
            )
        )

    return footprint_separation(*corners)


def distance_to_chain_m(points_m, chain_m):
    """Distance of points (n, 2) to the nearest side of an open chain of points,
    (n,).
    """
    starts = chain_m[:-1]
    sides = np.diff(chain_m, axis=0)
    offset = points_m[:, None] - starts
    share = np.clip((offset * sides).sum(axis=-1) / (sides**2).sum(axis=-1), 0.0, 1.0)
    return np.hypot(*np.moveaxis(offset - share[..., None] * sides, -1, 0)).min(axis=1)
