import json
from dataclasses import asdict, replace

import msgspec
import pytest
from msgspec import UNSET
from partial_pages import pictures_of, render_section, tables_of

from experiments.export.json import to_json_text
from experiments.figures.axes import to_png
from experiments.parts.sensitivity import (
    WORDS,
    phrase,
    plot_sensitivity,
    sensitivity_section,
    sensitivity_table,
    value_text,
)
from experiments.results.record import to_plain
from placement.explain.sensitivity import RANGES, Sensitivity, Varied, VariedAssumption, Worth


def summarise(assumptions):
    return Sensitivity(planned=PLANNED, assumptions=tuple(assumptions))


def outcome(apr, margin_s, one_failed=0.5):
    return Worth(apr=apr, apr_one_failed=one_failed, smallest_margin_s=margin_s)


PLANNED = outcome(0.9, 0.5)


def sensitivity(name, *varied, planned_value=0.0, left_out=""):
    return VariedAssumption(
        name=name,
        reason="<so> it is",
        is_ours=True,
        planned_value=planned_value,
        varied=varied,
        left_out=left_out,
    )


def varied(value, found, *lost, unmoved=()):
    return Varied(**asdict(found), value=value, lost_runs=lost, unmoved=unmoved)


@pytest.fixture
def summary():
    return summarise(
        [
            sensitivity(
                "latency_s",
                varied(0.0, outcome(0.9, 0.525)),
                varied(0.5, outcome(0.9, 0.025)),
                planned_value=0.025,
            ),
            sensitivity("packet_loss", varied(0.2, outcome(0.85, None), "A/north/20")),
            sensitivity(
                "deceleration_mps2",
                varied(5.0, outcome(0.6, 0.7), "A/north/20", "B/north/30"),
                varied(9.0, outcome(1.0, 0.4)),
                planned_value=7.72,
            ),
            sensitivity("height_m", varied(0.25, outcome(0.9, 0.5), unmoved=("U<1>",))),
            sensitivity("min_iou", planned_value=None, left_out="no such limit"),
        ]
    )


def test_the_summary_is_plain_and_has_every_number(summary):
    summary = to_plain(summary)
    assert json.loads(json.dumps(summary)) == summary
    assert summary["planned"] == {"apr": 0.9, "apr_one_failed": 0.5, "smallest_margin_s": 0.5}
    brakes = summary["assumptions"][2]
    assert [value["apr"] for value in brakes["varied"]] == [0.6, 1.0]
    assert brakes["varied"][0]["lost_runs"] == ["A/north/20", "B/north/30"]


def test_tracks_that_are_never_lost_are_told_in_words():
    found = summarise(
        [
            sensitivity(
                "track_memory_s",
                varied(0.5, outcome(0.7, 0.5), "A/north/20"),
                varied(None, outcome(0.95, 0.5)),
                planned_value=1.0,
            ),
        ]
    )
    rows = sensitivity_table(found).rows
    assert [row[1:4] for row in rows[1:]] == [
        ["1 s", "0.5 s", "70.0 %"],
        ["1 s", "for ever", "95.0 %"],
    ]
    endless = summarise(
        [sensitivity("track_memory_s", varied(1.0, outcome(0.7, 0.5)), planned_value=None)]
    )
    assert sensitivity_table(endless).rows[1][1:3] == ["for ever", "1 s"]
    plain = json.loads(to_json_text(found))  # as a result holds it
    (again,) = msgspec.convert(plain, Sensitivity).assumptions
    assert [value.value for value in again.varied] == [0.5, None]


def test_where_nothing_was_varied_there_is_no_figure():
    nothing = summarise([sensitivity("min_iou", left_out="no")])
    assert pictures_of(sensitivity_section(nothing)) == []


def test_the_table_has_the_plan_and_a_row_for_each_value(summary):
    table = sensitivity_table(summary)
    assert len({len(row) for row in table.rows} | {len(table.columns)}) == 1
    assert table.rows[0][3:6] == ["90.0 %", "50.0 %", "0.50"]
    rows = [row for row in table.rows if row[0] == "deceleration"]
    assert rows[0] == [
        "deceleration", "7.72 m/s\N{SUPERSCRIPT TWO}", "5 m/s\N{SUPERSCRIPT TWO}",
        "60.0 %", "50.0 %", "0.70", "2",
    ]  # fmt: skip
    (lost,) = (row for row in table.rows if row[0] == "messages lost")
    assert lost[5] == "by chance"
    (left_out,) = (row for row in table.rows if row[0] == WORDS["min_iou"].title)
    assert left_out[2] == "no such limit"


def bars(axes):
    return {
        patch.get_gid(): (patch.get_x(), patch.get_x() + patch.get_width())
        for container in axes.containers
        for patch in container.patches
    }


def test_bars_reach_from_the_plan_to_the_worst_and_the_best(summary):
    axes = plot_sensitivity(summary)
    found = bars(axes)
    assert found["deceleration_mps2 worse"] == pytest.approx((60.0, 90.0))
    assert found["deceleration_mps2 better"] == pytest.approx((90.0, 100.0))
    assert found["packet_loss worse"] == pytest.approx((85.0, 90.0))
    assert not [name for name in found if name.startswith(("latency", "height"))]
    # The widest on top; told apart without colour.
    labels = [label.get_text() for label in axes.get_yticklabels()]
    assert labels[-1] == "deceleration"
    assert WORDS["min_iou"].title not in labels
    hatches = {patch.get_hatch() for group in axes.containers for patch in group.patches}
    assert len(hatches) == 2
    assert to_png(axes).startswith(b"\x89PNG")


def test_the_section_shows_all_and_escapes_names(summary):
    part = sensitivity_section(summary)
    assert len(pictures_of(part)) == 1
    assert all(len(picture.alt) > 40 for picture in pictures_of(part))
    page = render_section(part)
    assert page.count("<img") == page.count('alt="Bars of the') == 1
    assert "U&lt;1&gt;" in page
    assert "&lt;so&gt; it is" in page
    assert "A/north/20, B/north/30" in page
    assert sensitivity_section(UNSET) is None


def test_where_nothing_is_avoided_the_figures_still_stand():
    nothing = replace(PLANNED, apr=0.0, smallest_margin_s=None)
    yaw = sensitivity("yaw_deg", varied(2.0, nothing), varied(4.0, outcome(0.1, 0.2)))
    summary = replace(summarise([yaw]), planned=nothing)
    page = sensitivity_section(summary)
    assert len(pictures_of(page)) == 1
    assert tables_of(page)[0].rows[0][5] == "\N{EN DASH}"


def test_every_assumption_has_words():
    assert set(WORDS) == set(RANGES)
    for name in RANGES:
        assert value_text(name, 1.0) in phrase(name, 1.0)
    assert value_text("height_m", -0.25) == "\N{MINUS SIGN}25 cm"
    assert value_text("yaw_deg", 2.0) == "+2\N{DEGREE SIGN}"
