"""Weights of runs: by run, by case, by tables, by points, by accident types."""

import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refused_with

from geometry.errors import InputError, MissingExtraError
from geometry.registry import load_entry
from scenarios import weight_tables, weights
from scenarios.cases import select_cases
from scenarios.runs import Refusal
from scenarios.weight_tables import load_crash_types
from scenarios.weights import (
    default_weights,
    weigh,
    weight_per_case,
    weight_per_run,
    weight_share,
)


class Driven(SimpleNamespace):
    """A run that may be a key."""

    __hash__ = object.__hash__


def run(case, approach="north", weather="day", speed_kmh=20, position="0"):
    """What weights look at of a run."""
    return Driven(
        id=f"{case}/{approach}/{speed_kmh}/{weather}",
        case=SimpleNamespace(family=case.partition("-")[0], name=case),
        approach=approach,
        position=position,
        weather=weather,
    )


DRIVEN = (
    run("CPNA-25"),
    run("CPNA-25", speed_kmh=30),
    run("CPNA-25", "south"),
    run("CBNA"),
    run("CPNA-25", "south", "night"),
)


@pytest.fixture
def table(tmp_path):
    """A function that writes a file of weights."""

    def write(text, encoding="utf-8"):
        path = tmp_path / "exposure.csv"
        path.write_text(text, encoding=encoding)
        return str(path)

    return write


def test_every_run_counts_the_same_and_all_sum_to_one(runs):
    weight = weight_per_run(runs)
    assert weight.shape == (len(runs),)
    assert len(np.unique(weight)) == 1
    assert weight.sum() == pytest.approx(1.0, abs=1e-12)


PLACES = st.tuples(
    st.sampled_from(["CBNA", "CPLA-50", "CBLA"]),
    st.sampled_from(["north", "south"]),
    st.sampled_from(["day", "night"]),
    st.sampled_from([20, 30]),
    st.sampled_from(["0", "-15", "+0", "+15"]),
)


LEVELS = [lambda r: r.case.name, lambda r: r.approach, lambda r: r.position]


@given(st.lists(PLACES, min_size=1, max_size=20))
def test_weights_by_case_are_those_of_sharing_out_level_by_level(places):
    runs = [run(*place) for place in places]
    expected = dict.fromkeys(range(len(runs)), 0.0)

    def share_out(members, amount, levels):
        if not levels:
            for index in members:
                expected[index] = amount / len(members)
            return
        groups = {}
        for index in members:
            name = levels[0](runs[index])
            groups.setdefault(name, []).append(index)

        for group in groups.values():
            share_out(group, amount / len(groups), levels[1:])

    share_out(list(expected), 1.0, LEVELS)
    assert weight_per_case(runs) == pytest.approx(list(expected.values()))


def refused(name, approach, *speeds_kmh, position="0", is_possible=True):
    """What is not driven of a case."""
    return Refusal(
        case=run(name).case,
        approach=approach,
        position=position,
        speeds_kmh=speeds_kmh,
        reason="",
        is_possible=is_possible,
    )


def test_the_only_turn_that_a_map_allows_weighs_no_more_than_one_of_four():
    arms = ("north", "east", "south", "west")
    driven = [run("CBNA", arm) for arm in arms]
    driven.append(run("CBTAno-50", "north"))
    missing = [refused("CBTAno-50", arm, 10.0, is_possible=False) for arm in arms[1:]]

    assert weigh(driven, "case", refused=missing) == pytest.approx([1 / 5] * 5)
    assert weight_per_case(driven)[-1] == pytest.approx(1 / 2)


def test_what_has_no_room_takes_its_share_away_and_what_no_map_shows_does_not():
    runs = [run("CBNA", speed_kmh=20), run("CBNA", position="-15"), run("CBLA")]
    whole = weight_per_case(runs)

    assert whole == pytest.approx([1 / 4, 1 / 4, 1 / 2])

    off_the_map = refused("CBNA", "north", 20.0, position="-45", is_possible=False)
    elsewhere = refused("CPLA-50", "north", 20.0)
    weight = weight_per_case(runs, refused=[off_the_map, elsewhere])

    assert weight == pytest.approx(whole)

    no_room = refused("CBNA", "north", 30.0, 40.0, 50.0)  # one of four speeds is left
    by_room = np.array([1 / 16, 1 / 4, 1 / 2])
    weight = weight_per_case(runs, refused=[no_room])

    assert weight == pytest.approx(by_room / by_room.sum())

    twice = [*runs, run("CBNA", weather="night", speed_kmh=20)]
    shared = weight_per_case(twice, refused=[no_room])

    assert shared[[0, 3]].sum() == pytest.approx(weight[0])


@pytest.mark.parametrize(
    ("cases", "word"),
    [
        ("study", "run"),
        ("default", "case"),
        ("CBNA", "case"),
        ("study,CBNA", "case"),
    ],
)
def test_the_runs_of_the_study_count_the_same_and_else_the_cases_do(cases, word):
    assert default_weights(cases) == word


@pytest.mark.parametrize("how", ["speed", "", "no/such.csv"])
def test_unknown_words_list_the_known_ones(how):
    with refused_with(
        f"weights: got {how!r}; expected run, case, fhwa-crash-types,"
        " euroncap-rating-2026, unfallatlas:FILE, stats19:FILE, or a CSV file that"
        " exists"
    ):
        weigh(DRIVEN, how)


def test_share_of_runs_without_weight_is_unknown():
    assert np.isnan(weight_share([True], [0.0]))


# CSV


def test_a_row_shares_its_weight_among_the_runs_that_it_names(table):
    path = table("case,approach,weight\nCPNA-25,north,3\nCBNA,*,1\n")
    assert weigh(DRIVEN, path) == pytest.approx([3 / 8, 3 / 8, 0.0, 1 / 4, 0.0])


def test_a_weather_can_be_named_and_columns_may_come_in_any_order(table):
    path = table(
        "weight;weather;case;approach\n1;night;CPNA-25;\n3;day;CPNA-25;south\n"
    )
    assert weigh(DRIVEN, path) == pytest.approx([0.0, 0.0, 3 / 4, 0.0, 1 / 4])


def test_a_position_can_be_named(table):
    runs = [run("CPLA-50", position=position) for position in ("0", "0", "-15", "+15")]
    head = "case,approach,position,weight\n"
    path = table(f"{head}CPLA-50,north,0,2\nCPLA-50,*,-15,1\nCPLA-50,,+15,1\n")

    assert weigh(runs, path) == pytest.approx([1 / 4] * 4)

    path = table(f"{head}CPLA-50,,'-15.0,1\nCPLA-50,,15,2\nCPLA-50,,'0,1\n")
    assert weigh(runs, path) == pytest.approx([1 / 8, 1 / 8, 1 / 4, 1 / 2])

    path = table(f"{head}CPLA-50,north,*,2\n")
    assert weigh(runs, path) == pytest.approx([1 / 4] * 4)

    path = table(f"{head}CPLA-50,north,+30,2\n")
    with refused_with(
        f"{path}: line 2: got 'CPLA-50', 'north', '+30'; expected an approach,"
        " position and weather in which CPLA-50 is driven: north at 0 by day, north"
        " at -15 by day, north at +15 by day"
    ):
        weigh(runs, path)


def test_a_byte_order_mark_and_empty_lines_do_not_matter(table):
    path = table("case,approach,weight\n\nCBNA,north,2\n\n", encoding="utf-8-sig")
    assert weigh(DRIVEN, path).tolist() == [0.0, 0.0, 0.0, 1.0, 0.0]


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("case,approach,weight", "got no rows; expected one row per case and approach"),
        (
            "case,approach; CBNA,north",
            "line 1: got case, approach; expected case, approach",
        ),
        (
            "case,approach,weight,age",
            "line 1: got case, approach, weight, age; expected",
        ),
        ("case,approach,weight; CBNA,north", "line 2: got 2 columns; expected 3"),
        (
            "case,approach,weight; CBNA,north,-1",
            "line 2: weight: got '-1'; expected a number, at least 0",
        ),
        (
            "case,approach,weight; CBNA,north,nan",
            "line 2: weight: got 'nan'; expected a num",
        ),
        (
            "case,approach,weight; CBNA,north,1e999",
            "line 2: weight: got '1e999'; expected",
        ),
        (
            "case,approach,weight; CBNA,north,much",
            "line 2: weight: got 'much'; expected",
        ),
        (
            "case,approach,weight; CBLA,north,1",
            (
                "line 2: got 'CBLA', 'north'; expected a case that is driven: "
                "CPNA-25, CBNA"
            ),
        ),
        (
            "case,approach,weight; ; CBNA,up,1",
            (
                "line 3: got 'CBNA', 'up'; expected an approach, position and "
                "weather in which CBNA is driven: north at 0 by day"
            ),
        ),
        (
            "case,approach,position,weight; CBNA,north,far,1",
            (
                "line 2: position: got '+far'; expected 0, or metres before it "
                "such as -15, or"
            ),
        ),
        (
            "case,approach,weight; CPNA-25,*,1; CPNA-25,south,1",
            (
                "line 3: got 'CPNA-25', 'south'; expected runs that line 2 does "
                "not name already"
            ),
        ),
        (
            "case,approach,weight; CBNA,north,0",
            "weight: got 0 in all rows; expected one weight more than 0",
        ),
        (
            'case,approach,weight; "CBNA,north,1',
            "line 2: got unexpected end of data; expected a CSV",
        ),
    ],
)
def test_tables_say_what_is_wrong_and_where(table, rows, message):
    path = table(rows.replace("; ", "\n") + "\n")
    with pytest.raises(InputError) as caught:
        weigh(DRIVEN, path)
    assert str(caught.value).startswith(f"{path}: {message}")


def test_an_empty_file_says_which_columns_are_missing(table):
    told = "an empty file; expected columns case, approach, weight, and position"
    with pytest.raises(InputError, match=told):
        weigh(DRIVEN, table(""))


def test_a_folder_and_binary_data_are_no_tables(table, tmp_path):
    with pytest.raises(InputError, match="expected a readable file"):
        weigh(DRIVEN, str(tmp_path))
    with pytest.raises(InputError, match="expected a CSV file in UTF-8 or Win"):
        weigh(DRIVEN, (table("\u00e4\0", encoding="latin-1")))


# Euro NCAP's points


@pytest.fixture
def scores():
    """Points of the package, by the names of its scores."""
    model = pytest.importorskip("euroncap_rating_2026.crash_avoidance.data_model")
    points = {}
    for name, parts in model.TOTAL_SCORES.items():
        points[name] = sum(part or 0.0 for part in parts.values())

    return points


@pytest.mark.long
def test_points_are_those_of_the_package_shared_by_the_runs_of_a_case_and_weather(
    scores,
):
    weight = weigh(DRIVEN, "euroncap-rating-2026")
    day = scores["CPNA day"]
    night = scores["CPNA night"]
    cyclist = scores["CBNA"]
    expected = np.array([day / 3, day / 3, day / 3, cyclist, night])

    assert weight == pytest.approx(expected / expected.sum())
    # As the package splits the pedestrian's points by light: robustness is looked at by
    # day only.
    assert weight[:3].sum() / weight[4] == pytest.approx(11.0 / 9.0)


def test_every_score_of_the_mapping_is_one_of_the_package(scores):
    points = weight_tables.load_points()
    assert set(points.values()) <= set(scores.values())

    frontal = [name for name in scores if "SfS" not in name and "ELK" not in name]
    # Reversing, forward creep, dooring.
    left_out = {"CPMRCm", "CPMRCs", "CPMFC", "CBDA"}

    assert len(points) == len(set(frontal) - left_out)


def test_cars_and_motorcyclists_have_their_points_whatever_side_year_and_impact(scores):
    names = ("CMCscp-far", "CMCscp-near", "CCRs-FCW-2026-m25", "CCFtap")
    driven = [run(name) for name in names]
    weight = weigh(driven, "euroncap-rating-2026")
    half = scores["CMCscp"] / 2.0
    expected = np.array([half, half, scores["CCRs"], scores["CCFtap"]])

    assert scores["CMCscp"] == 7.5
    assert weight == pytest.approx(expected / expected.sum())


def test_near_and_far_turns_share_their_points(scores):
    driven = (run("CPTAfs-50"), run("CPTAns-50"), run("CPTAfo-50"), run("CPNC-50"))
    weight = weigh(driven, "euroncap-rating-2026")

    assert weight[0] == weight[1] == pytest.approx(0.5 * weight[2])

    ratio = scores["CPNCO day"] / scores["CPTAfo & CPTAno"]
    assert weight[3] / weight[2] == pytest.approx(ratio)


def test_runs_without_points_alone_cannot_be_weighed(scores):
    with refused_with(
        "weights: got 'euroncap-rating-2026'; expected a run that has points in"
        " 2026; driven: CPNA-25 (rain)"
    ):
        weigh((run("CPNA-25", weather="rain"),), "euroncap-rating-2026")


def test_a_missing_package_names_the_extra(monkeypatch):
    monkeypatch.setitem(
        sys.modules, "euroncap_rating_2026.crash_avoidance.data_model", None
    )
    weight_tables.load_points.cache_clear()
    with pytest.raises(MissingExtraError, match=r"pip install place-rsus\[rating\]"):
        weigh(DRIVEN, "euroncap-rating-2026")


def test_accident_types_weigh_by_manoeuvre_and_distance_from_the_junction():
    """FHWA-RD-95-163: see scenarios/data/crash_types.toml."""
    on_foot = 92.0
    by_bicycle = 67.0
    crossing = on_foot * (0.072 + 0.051 + 0.101) / 2
    beyond = on_foot * (0.133 + 0.131) / 2
    shares = {
        run("CPTAfs-50"): on_foot * 0.098 / 2,
        run("CPTAno-50"): on_foot * 0.098 / 2,
        run("CPNC-50"): crossing / 2,
        run("CPNC-50", position="+15"): crossing / 2,
        run("CPNCO-50", position="-15"): crossing,
        run("CPNC-50", position="-30"): beyond,
        run("CPNCO-50", "south", position="+45"): beyond,
        run("CPLA-50", position="-45"): on_foot * 0.079,
        run("CBNA"): by_bicycle * 0.57 * (0.377 + 0.291),
        run("CBLA"): by_bicycle * 0.36 * 0.242,
        run("CBTAfs-100"): by_bicycle * 0.36 * 0.344,
    }
    weight = weigh(tuple(shares), "fhwa-crash-types")
    expected = np.array(list(shares.values()))

    assert weight.sum() == pytest.approx(1.0)
    # Shares are rounded.
    assert weight == pytest.approx(expected / expected.sum(), rel=5e-3)

    alone = weigh((run("CPNC-50", position="-30"), run("CPNC-50")), "fhwa-crash-types")
    assert alone == pytest.approx([0.264 / 0.488, 0.224 / 0.488])


def test_accident_types_ask_for_a_case_that_they_have():
    with refused_with(
        "weights: got 'fhwa-crash-types'; expected a run of a type it has; driven: CPRA"
    ):
        weigh((run("CPRA"),), "fhwa-crash-types")


def test_every_case_of_the_default_set_stands_for_a_type():
    known = {name for kind in load_crash_types().types for name in kind.cases}
    for case in select_cases("default").cases:
        assert case.name.rpartition("-")[0] in known or case.name in known, case.name


def test_a_function_weighs_runs(runs):
    is_east = np.array([run.approach == "east" for run in runs])
    weight = weights.weight_by_function(
        runs, lambda run: 1.0 + 2.0 * (run.approach == "east")
    )

    assert weight.sum() == pytest.approx(1.0)
    assert weight[is_east] == pytest.approx(3.0 * weight[~is_east].min())
    with pytest.raises(InputError, match=r": got -1.0; expected a finite number >= 0"):
        weights.weight_by_function(runs, lambda run: -1.0)

    told = "weights: got 0 for all runs; expected one weight more"
    with pytest.raises(InputError, match=told):
        weights.weight_by_function(runs, lambda run: 0.0)


@pytest.mark.parametrize("name", weights.SCHEMES)
def test_every_scheme_of_weights_loads(name):
    scheme = load_entry(weights.SCHEMES[name])(f"{name}:collision.csv")
    assert callable(scheme.check)
    assert callable(scheme.weigh)
    assert all(isinstance(path, Path) for path in scheme.files())
