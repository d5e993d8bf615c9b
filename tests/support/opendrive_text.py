"""Small OpenDRIVE files made by hand, as text."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from geometry.junction import build_junction
from geometry.maps.opendrive import read_opendrive
from geometry.maps.source_map import MapJunction, SourceMap
from geometry.scene import Lane, Scene

LINE = "<line/>"


def document(*parts: str, header: str = "", root: str = "OpenDRIVE") -> str:
    """A file of some roads."""
    return (
        f'<?xml version="1.0"?><{root}><header revMajor="1" revMinor="7"'
        f' name="made">{header}</header>{"".join(parts)}</{root.split()[0]}>'
    )


def geometry(
    shape: str = LINE,
    *,
    s: float = 0.0,
    x: float = 0.0,
    y: float = 0.0,
    hdg: float = 0.0,
    length: float = 100.0,
) -> str:
    """A piece of a road's middle line. [m, rad]"""
    return (
        f'<geometry s="{s}" x="{x}" y="{y}" hdg="{hdg}"'
        f' length="{length}">{shape}</geometry>'
    )


def cubic(tag: str, start: float, *coefficients: float) -> str:
    """A polynomial of up to four coefficients."""
    a, b, c, d = (*coefficients, 0.0, 0.0, 0.0, 0.0)[:4]
    if tag in ("width", "border"):
        key = "sOffset"
    else:
        key = "s"
    return f'<{tag} {key}="{start}" a="{a}" b="{b}" c="{c}" d="{d}"/>'


def lane(
    number: int,
    kind: str = "driving",
    *,
    width: str | float = 3.5,
    before: int | None = None,
    after: int | None = None,
    extra: str = "",
) -> str:
    """A lane with its width."""
    links = "".join(
        f'<{tag} id="{other}"/>'
        for tag, other in (
            ("predecessor", before),
            ("successor", after),
        )
        if other is not None
    )
    if isinstance(width, str):
        widths = width
    else:
        widths = cubic("width", 0.0, width)
    return (
        f'<lane id="{number}" type="{kind}" {extra}><link>{links}</link>{widths}</lane>'
    )


def section(
    *, s: float = 0.0, left: Sequence[str] = (), right: Sequence[str] = ()
) -> str:
    """Lanes to the left and right of a road's middle."""
    return (
        f'<laneSection s="{s}"><left>{"".join(left)}</left><center><lane id="0"'
        f' type="none"/></center><right>{"".join(right)}</right></laneSection>'
    )


TWO_LANES = section(left=[lane(1)], right=[lane(-1)])


def road(
    name: str = "1",
    *,
    plan: str | None = None,
    length: float = 100.0,
    junction: str = "-1",
    rule: str = "",
    link: str = "",
    offset: str = "",
    elevation: str = "",
    lateral: str = "",
    sections: str = TWO_LANES,
    objects: str = "",
    signals: str = "",
    street: str = "",
) -> str:
    """A road with its lanes."""
    if plan is None:
        plan = geometry(length=length)
    if rule:
        rule = f'rule="{rule}"'
    else:
        rule = ""
    return (
        f'<road id="{name}" name="{street}" length="{length}" junction="{junction}"'
        f" {rule}>"
        f"<link>{link}</link><planView>{plan}</planView>"
        f"<elevationProfile>{elevation}</elevationProfile><lateralProfile>{lateral}</lateralProfile>"
        f"<lanes>{offset}{sections}</lanes><objects>{objects}</objects>"
        f"<signals>{signals}</signals></road>"
    )


def to_road(side: str, other: str, contact: str) -> str:
    """A link to a road."""
    return f'<{side} elementType="road" elementId="{other}" contactPoint="{contact}"/>'


def to_junction(side: str, junction: str) -> str:
    """A link to a junction."""
    return f'<{side} elementType="junction" elementId="{junction}"/>'


def crossing(*, rule: str = "RHT", half_m: float = 10.0, kind: str = "default") -> str:
    """Two streets that cross at the origin: four roads of 50 m, straight connecting
    roads only.
    """
    # Where the arms lie, degrees.
    turns = {
        "1": 0.0,
        "2": 90.0,
        "3": 180.0,
        "4": 270.0,
    }
    roads = []
    links = []
    for name, angle in turns.items():
        unit = {
            0.0: (1, 0),
            90.0: (0, 1),
            180.0: (-1, 0),
            270.0: (0, -1),
        }[angle]
        roads.append(
            road(
                name,
                plan=geometry(
                    x=half_m * unit[0],
                    y=half_m * unit[1],
                    hdg=angle * 3.141592653589793 / 180.0,
                    length=50.0,
                ),
                length=50.0,
                rule=rule,
                link=to_junction("predecessor", "9"),
                street=f"{'East' if name in '13' else 'North'} Street",
            )
        )

    for name, start, end, hdg, x, y in (
        ("11", "3", "1", 0.0, -half_m, 0.0),
        ("12", "4", "2", 1.5707963267948966, 0.0, -half_m),
    ):
        roads.append(
            road(
                name,
                plan=geometry(
                    x=x,
                    y=y,
                    hdg=hdg,
                    length=2.0 * half_m,
                ),
                length=2.0 * half_m,
                junction="9",
                rule=rule,
                link=to_road("predecessor", start, "start")
                + to_road("successor", end, "start"),
            )
        )
        links.append(f'<connection incomingRoad="{start}" connectingRoad="{name}"/>')
        links.append(f'<connection incomingRoad="{end}" connectingRoad="{name}"/>')

    return (
        "".join(roads)
        + f'<junction id="9" name="" type="{kind}">{"".join(links)}</junction>'
    )


def read_text(folder: Path, text: str) -> SourceMap:
    """The map that a text is read as."""
    path = folder / "made.xodr"
    path.write_text(text)
    return read_opendrive(path)


def arms_of(source: SourceMap, junction: MapJunction) -> dict[str, tuple[int, int]]:
    """Lanes in and out by arm, as the scene's junction finds them."""
    scene = Scene(
        name="made",
        vertices_m=np.zeros((0, 3)),
        triangles=np.zeros((0, 3)),
        triangle_instance=np.zeros(0),
        instances=(),
        sites=(),
        outline_m=junction.outline_m,
        lanes=tuple(
            Lane(
                id=one.id,
                kind=one.kind,
                width_m=one.width_m,
                centreline_m=one.centreline_m[:, :2],
            )
            for one in source.lanes
            if one.kind in ("driving", "parking")
        ),
        crs="",
        keeps_left=source.keeps_left,
    )
    arms = build_junction(scene).arms
    return {
        name: (len(arm.entry_lanes), len(arm.exit_lanes)) for name, arm in arms.items()
    }
