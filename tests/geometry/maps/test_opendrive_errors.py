"""What is refused, in which words; and that nothing else comes out, whatever is in a
file.
"""

import pytest
from opendrive_text import (
    crossing,
    cubic,
    document,
    geometry,
    lane,
    read_text,
    road,
    section,
    to_junction,
)

from geometry.errors import InputError
from geometry.maps.opendrive import read_opendrive

_SHAPES = (
    geometry(length=20.0)
    + geometry('<arc curvature="0.01"/>', s=20.0, x=20.0, length=20.0)
    + geometry(
        '<spiral curvStart="0.01" curvEnd="-0.02"/>',
        s=40.0,
        x=40.0,
        y=2.0,
        length=20.0,
    )
    + geometry(
        '<poly3 a="0" b="0" c="0.01" d="0"/>',
        s=60.0,
        x=60.0,
        y=2.0,
        length=20.0,
    )
    + geometry(
        '<paramPoly3 aU="0" bU="20" cU="0" dU="0" aV="0" bV="0" cV="1" dV="0"'
        ' pRange="normalized"/>',
        s=80.0,
        x=80.0,
        y=2.0,
        length=20.0,
    )
)
_OBJECTS = (
    '<object id="1" type="building" s="50" t="20" length="9" width="5" height="4"'
    ' hdg="0.2"/><object id="2" type="tree" s="10" t="8" height="6" radius="2"><repeat'
    ' s="10" length="40" distance="10" tStart="8" tEnd="9" heightStart="5"'
    ' heightEnd="6"/></object><object id="3" type="barrier" s="0" t="7"><repeat s="0"'
    ' length="60" distance="0" tStart="7" tEnd="8" widthStart="0.3" widthEnd="0.3"'
    ' heightStart="1" heightEnd="1"/></object><object id="4" type="crosswalk" s="90"'
    ' t="0"><outline closed="true"><cornerRoad s="88" t="-4"/><cornerRoad s="92"'
    ' t="-4"/><cornerRoad s="92" t="4"/><cornerRoad s="88"'
    ' t="4"/></outline></object><object id="5" type="building" s="70"'
    ' t="-20"><outlines><outline outer="true"><cornerLocal u="0" v="0" z="0"'
    ' height="4"/><cornerLocal u="8" v="0" z="0" height="5"/><cornerLocal u="8" v="6"'
    ' z="0" height="6"/></outline></outlines></object><object id="6"'
    ' type="parkingSpace" s="30" t="-6" length="5" width="2"/><object id="7"'
    ' type="streetLamp" s="30" t="-9" height="6"/>'
)
_SIGNALS = (
    '<signal id="1" name="a" dynamic="yes" type="1000001" s="95" t="-6" zOffset="3"'
    ' height="1"/><signal id="2" name="b" dynamic="no" type="206" s="95" t="6"'
    ' zOffset="2" height="1"><positionInertial x="9" y="9" z="2" hdg="0"/></signal>'
)
_WHOLE = document(
    road(
        "1",
        plan=_SHAPES,
        link=to_junction("successor", "9"),
        offset=cubic("laneOffset", 0.0, 0.1, 0.01),
        elevation=cubic("elevation", 0.0, 1.0, 0.01),
        lateral=cubic("superelevation", 0.0, 0.01),
        sections=section(
            left=[lane(1, after=1)], right=[lane(-1, after=-1), lane(-2, "sidewalk")]
        )
        + section(
            s=50.0,
            left=[lane(1, width=cubic("border", 0.0, 4.0))],
            right=[lane(-1)],
        ),
        objects=_OBJECTS,
        signals=_SIGNALS,
    ),
    crossing()
    .replace('id="1"', 'id="21"', 1)
    .replace('elementId="1"', 'elementId="21"'),
    header=(
        "<geoReference>+proj=utm +zone=32 +datum=WGS84</geoReference>"
        '<offset x="500000" y="5400000" z="3" hdg="0.1"/>'
    ),
)


def _refused(tmp_path, text):
    """What is told of a text."""
    with pytest.raises(InputError) as caught:
        read_text(tmp_path, text)
    return str(caught.value)


def _plan(*pieces, length=100.0):
    """A document of one road with a plan view."""
    return document(road("5", plan="".join(pieces), length=length))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (document(root="net"), "made.xodr: got a document <net>; expected <OpenDRIVE>"),
        (document(), "made.xodr: got no road; expected a document with roads"),
        (
            document('<road length="3"/>'),
            "made.xodr: road.id: got nothing; expected an id",
        ),
        (
            document('<road id="5"/>'),
            "made.xodr: road 5.length: got nothing; expected a number",
        ),
        (
            document(road("5", length=0.0)),
            "made.xodr: road 5.length: got 0.0; expected metres, > 0, at most 100000",
        ),
        (
            document(road("5", length=100001.0)),
            "made.xodr: road 5.length: got 100001.0; "
            "expected metres, > 0, at most 100000",
        ),
        (
            document(road("5", rule="LEFT")),
            "made.xodr: road 5.rule: got 'LEFT'; expected RHT or LHT",
        ),
        (
            document(road("5"), road("5")),
            "made.xodr: road 5.id: got '5'; expected every id once",
        ),
        (
            _plan(geometry(length=50), geometry(s=50, length="nan")),
            "made.xodr: road 5 geometry[1].length: got nan; "
            "expected a finite number, at most 1e+12 in size",
        ),
        (
            _plan(geometry(y=2e8)),
            "made.xodr: road 5 geometry[0].y: got 200000000.0; "
            "expected at most 1e+08 m",
        ),
        (
            _plan(geometry(length=-3.0)),
            "made.xodr: road 5 geometry[0].length: got -3.0; "
            "expected metres, at least 0",
        ),
        (
            _plan(geometry(length=0.0)),
            "made.xodr: road 5 planView: got no geometry; "
            "expected pieces of a length above 0",
        ),
        (
            _plan(geometry("<circle/>")),
            "made.xodr: road 5 geometry[0]: got circle; "
            "expected one of line, arc, spiral, poly3, paramPoly3",
        ),
        (
            _plan(geometry(), geometry(s=150.0)),
            "made.xodr: road 5 geometry[1].s: got 150.0; "
            "expected 0 .. 100, the road's length",
        ),
        (
            _plan(geometry(s=20.0)),
            "made.xodr: road 5 geometry[0].s: got 20.0; "
            "expected 0: a road begins there",
        ),
        (
            _plan(geometry("<arc/>")),
            "made.xodr: road 5 geometry[0] arc.curvature: got nothing; "
            "expected a number",
        ),
        (
            _plan(geometry('<paramPoly3 pRange="metres"/>')),
            "made.xodr: road 5 geometry[0] paramPoly3.pRange: got 'metres'; "
            "expected normalized or arcLength",
        ),
        (
            document(road("5", sections="")),
            "made.xodr: road 5 lanes: got no laneSection; expected at least one",
        ),
        (
            document(road("5", sections='<laneSection s="0"><center/></laneSection>')),
            "made.xodr: road 5 laneSection[0] center: got no lane; "
            "expected a lane section's lane 0",
        ),
        (
            document(road("5", sections=section(s=120.0))),
            "made.xodr: road 5 laneSection[0].s: got 120.0; "
            "expected 0 .. 100, the road's length",
        ),
        (
            document(road("5", sections=section(left=[lane(1), lane(1)]))),
            "made.xodr: road 5 laneSection[0] left lane[1].id: got 1; "
            "expected positive on the left, every one once",
        ),
        (
            document(road("5", sections=section(left=[lane(1, width=90000)]))),
            "made.xodr: road 5: edge of a lane: got 90000.0; "
            "expected at most 10000 m off",
        ),
        (
            document(
                road(
                    "5",
                    objects='<object id="3" type="tree" s="5" t="1">'
                    '<repeat s="0" length="90" distance="0.001"/></object>',
                )
            ),
            "made.xodr: road 5 object 3 repeat[0].distance: got 0.001; "
            "expected at most 20,000 copies",
        ),
        (
            document(road("5"), '<junction id="1"/><junction id="1"/>'),
            "made.xodr junction[1].id: got '1'; expected every id once",
        ),
        (
            document(road("5"), header='<offset x="nan?"/>'),
            "made.xodr: header offset.x: got 'nan?'; expected a number",
        ),
    ],
)
def test_each_wrong_file_is_refused_in_one_line_that_names_the_element(
    tmp_path, text, message
):
    assert _refused(tmp_path, text) == message


def test_a_curve_that_winds_up_is_refused(tmp_path):
    assert (
        _refused(tmp_path, _plan(geometry('<arc curvature="-1e6"/>')))
        == "made.xodr: road 5 geometry[0]: got a curve that turns by 1e+08 rad; "
        "expected at most 200 rad"
    )


def test_widths_that_nobody_can_follow_are_refused(tmp_path):
    wild = cubic("width", 0.0, 1.0, 0.0, 1e8, -1e6)
    sections = section(right=[lane(-1, width=wild)])
    text = document(road("5", sections=sections))
    message = _refused(tmp_path, text.replace('c="100000000.0"', 'c="-1e-12"'))

    assert message.startswith("made.xodr: road 5: edge of a lane: got ")


def test_too_many_points_altogether_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("geometry.maps.opendrive.MAX_POINTS", 100)
    message = _refused(tmp_path, document(road("5"), road("6")))
    assert (
        message == "made.xodr: road 6: got more than 100 points up to here; "
        "expected a smaller file: cut it out first"
    )


def test_too_many_objects_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("geometry.maps.opendrive.objects._MAX_PLACES", 3)
    message = _refused(tmp_path, _WHOLE)
    assert (
        message == "made.xodr: road 1 object 2: got more than 3 objects up to here; "
        "expected a smaller file: cut it out first"
    )


@pytest.mark.parametrize(
    "text",
    [
        "",
        "road",
        _WHOLE[:-200],
        (
            '<!DOCTYPE x [<!ENTITY a "aaaa"><!ENTITY b'
            ' "&a;&a;">]><OpenDRIVE>&b;</OpenDRIVE>'
        ),
    ],
)
def test_what_is_no_xml_or_a_bomb_is_refused(tmp_path, text):
    assert "made.xodr: got " in _refused(tmp_path, text)


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(InputError, match="a readable file"):
        read_opendrive(tmp_path / "none.xodr")


def test_the_whole_file_is_read(tmp_path):
    source = read_text(tmp_path, _WHOLE)
    assert len(source.junctions) == 1
    assert len(source.things) == 8
    assert {pole.kind for pole in source.poles} == {
        "lamp post",
        "traffic light",
        "sign",
    }
    assert len(source.crosswalks_m) == 1
    assert source.crs == "+proj=utm +zone=32 +datum=WGS84"
