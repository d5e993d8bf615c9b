"""A crossing drawn as lanelets: four arms, a way in and out of each, and straight
through.
"""

WIDTH_M = 3.0
HALF_M = 8.0
REACH_M = 60.0  # of a lane; half the junction; to the ends of the roads


def turned(
    points: list[tuple[float, float]], quarter: int
) -> list[tuple[float, float]]:
    """Points turned by some quarters."""
    for _ in range(quarter):
        points = [(-y, x) for x, y in points]
    return points


def crossing(*, keeps_left: bool = False) -> dict[str, tuple[list, list]]:
    """Left and right bound of each lanelet, by name: four arms, ways in, out and
    through.
    """
    # a way in on the west arm lies south of the axis, or north
    if keeps_left:
        side = 1.0
    else:
        side = -1.0
    lanes = {}
    for quarter in range(4):
        for name, x, is_in in (
            ("in", -REACH_M, True),
            ("out", -HALF_M, False),
        ):
            if is_in:
                lane = side
            else:
                lane = -side
            axis = 0.0
            edge = lane * WIDTH_M
            if is_in:
                ends = (x, -HALF_M)
            else:
                ends = (x, -REACH_M)
            inner, outer = ([(end, y) for end in ends] for y in (axis, edge))
            is_outer_left = (edge > 0.0) == is_in
            if is_outer_left:
                bounds = (outer, inner)
            else:
                bounds = (inner, outer)
            lanes[f"{name}{quarter}"] = tuple(
                turned(bound, quarter) for bound in bounds
            )
        inner, outer = (
            [
                (-HALF_M, y),
                (HALF_M, y),
            ]
            for y in (0.0, side * WIDTH_M)
        )
        if side > 0.0:
            bounds = (outer, inner)
        else:
            bounds = (inner, outer)
        lanes[f"through{quarter}"] = tuple(turned(bound, quarter) for bound in bounds)

    return lanes


def lanelet2(lanes: dict, tags: dict[str, str] | None = None, more: str = "") -> str:
    """The map as OpenStreetMap XML, each bound a way of its own, in local metres."""
    nodes = []
    ways = []
    relations = []
    for number, (name, bounds) in enumerate(lanes.items(), 1):
        members = ""
        for at, (role, bound) in enumerate(zip(("left", "right"), bounds, strict=True)):
            refs = ""
            for x, y in bound:
                nodes.append(
                    f"<node id='{len(nodes) + 1}' lat='50' lon='8'>"
                    f"<tag k='local_x' v='{x}'/><tag k='local_y' v='{y}'/></node>"
                )
                refs += f"<nd ref='{len(nodes)}'/>"
            ways.append(f"<way id='{10 * number + at}'>{refs}</way>")
            members += f"<member type='way' ref='{10 * number + at}' role='{role}'/>"

        if name.startswith("zebra"):
            subtype = "crosswalk"
        else:
            subtype = "road"
        known = {"type": "lanelet", "subtype": subtype} | (tags or {})
        told = "".join(f"<tag k='{key}' v='{value}'/>" for key, value in known.items())
        relations.append(f"<relation id='{number}'>{members}{told}</relation>")

    return f"<osm version='0.6'>{''.join(nodes + ways + relations)}{more}</osm>"


def commonroad(lanes: dict) -> str:
    """Lanes as a file of CommonRoad."""

    def bound(points: list[tuple[float, float]]) -> str:
        return "".join(f"<point><x>{x}</x><y>{y}</y></point>" for x, y in points)

    told = "".join(
        f"<lanelet id='{number}'><leftBound>{bound(left)}</leftBound>"
        f"<rightBound>{bound(right)}</rightBound><laneletType>urban</laneletType></lanelet>"
        for number, (left, right) in enumerate(lanes.values(), 1)
    )
    return f"<commonRoad commonRoadVersion='2020a'>{told}</commonRoad>"
