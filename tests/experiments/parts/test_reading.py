"""Result folders are read back whole, or refused in one line."""

import math
import shutil
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from command_results import answer
from json_files import change_json

from experiments.export.json import to_json_text
from experiments.jobs import placement
from experiments.parts.reading import load_result
from experiments.results.record import build_unit_records
from geometry.errors import InputError
from geometry.study_scene import load_study_scene
from placement.layout import load_carlancap_layout


@pytest.fixture(scope="module")
def folder_of_one(tmp_path_factory):
    """Where the result is, once it is made."""
    return tmp_path_factory.mktemp("results") / "out"


@pytest.fixture
def folder(folder_of_one, small_study, without_figures, run, tmp_path, monkeypatch):
    """A copy of a result that was made once, compared with two units of the study's."""
    if not folder_of_one.exists():
        study = load_carlancap_layout()
        few = replace(study, units=study.units[:2])
        monkeypatch.setattr(placement, "find_baseline", lambda scene: few)
        answer(run("--budget 2 --out", folder_of_one, "--quiet"))
    shutil.copytree(folder_of_one, tmp_path / "result")
    return tmp_path / "result"


@pytest.mark.long
def test_a_result_is_read_back(folder):
    result = load_result(str(folder))
    assert result.folder == folder
    assert (
        build_unit_records(result.layout, load_study_scene()) == result.summary.layout
    )

    text = (folder / "summary.json").read_text()
    assert to_json_text(result.summary) == text

    together = result.runs.query("layout == @result.layout.name and party == 'rsu_all'")
    assert len(together) == result.summary.runs

    share = together["weight"][together["is_avoided"]].sum()
    assert share == pytest.approx(result.summary.evaluation.rsu_all.all)

    of_all = result.apr.query(
        "layout == @result.layout.name and party == 'rsu_all' and case == 'all' "
        "and approach == 'all' and weather == 'all' and vut_speed_kmh == 'all'"
    )
    assert of_all["apr"].tolist() == pytest.approx([share])
    assert (
        repr(result) == f"Result('best-2', {result.summary.runs} runs, {str(folder)!r})"
    )


def change_summary(change):
    """Damage to a summary."""
    return lambda folder: change_json(folder / "summary.json", change)


def change_runs(change):
    """Damage to the table of runs."""

    def damage(folder):
        path = folder / "runs.parquet"
        change(pd.read_parquet(path)).to_parquet(path)

    return damage


def change_text(name, change):
    """Damage to a file of text."""

    def damage(folder):
        path = folder / name
        path.write_text(change(path.read_text()))

    return damage


def cut_off(name, share=0.5):
    """Damage that leaves the first part of a file."""

    def damage(folder):
        data = (folder / name).read_bytes()
        (folder / name).write_bytes(data[: math.floor(share * len(data))])

    return damage


def drop_last_line(text):
    return "".join(text.splitlines(keepends=True)[:-1])


BROKEN = {
    "no summary": (
        lambda f: (f / "summary.json").unlink(),
        "summary.json: got No such file",
    ),
    "no runs": (
        lambda f: (f / "runs.parquet").unlink(),
        "runs.parquet: got No such file",
    ),
    "half a summary": (
        cut_off("summary.json"),
        "expected a whole file, as place-rsus has",
    ),
    "no JSON": (
        change_text("summary.json", lambda text: "[" * 100_000),
        "nested too deep",
    ),
    "a list": (
        change_text("summary.json", lambda text: "[]"),
        "got no object; expected an",
    ),
    "no schema": (
        change_summary(lambda s: s.pop("schema")),
        "schema: got nothing; expected",
    ),
    "later": (
        change_summary(lambda s: s.update(schema="place-rsus/placement/3")),
        "schema: got 'place-rsus/placement/3'; expected place-rsus/placement/2 or ",
    ),
    "older": (
        change_summary(lambda s: s.update(schema="place-rsus/result/1")),
        (
            "schema: got 'place-rsus/result/1'; expected place-rsus/placement/2 or .*:"
            " an older"
        ),
    ),
    "no name": (
        change_summary(lambda s: s.pop("name")),
        "name: got nothing; expected a value",
    ),
    "truth": (
        change_summary(lambda s: s.update(runs=True)),
        "runs: got True; expected a whole",
    ),
    "no units": (
        change_summary(lambda s: s.update(layout=[])),
        r"layout: got \[\]; expected a",
    ),
    "other units": (
        change_summary(lambda s: s["layout"][0].update(id="U7")),
        "layout.json: got units U1, .*; expected U7, .*, those of summary.json",
    ),
    "half a layout": (
        cut_off("layout.json"),
        "layout.json: got .*; expected JSON in UTF-8",
    ),
    "a run less": (
        change_runs(lambda runs: runs.iloc[:-1]),
        (
            "runs.parquet: got 5 runs of carlancap-12, vut_and_rsus; expected each of"
            " the 6 runs of"
        ),
    ),
    "other results": (
        change_runs(lambda runs: runs[runs["layout"] != "best-2"]),
        "layout: got no run of best-2; expected those of summary.json",
    ),
    "no column": (
        change_runs(lambda runs: runs.drop(columns="margin_s")),
        "runs.parquet: got no column margin_s; expected columns layout, party, run,",
    ),
    "no rows": (change_runs(lambda runs: runs.iloc[:0]), "runs.parquet: layout: got "),
    "words": (
        change_runs(lambda runs: runs.assign(weight="much")),
        "runs.parquet: weight: got object values; expected numbers",
    ),
    "counts": (
        change_runs(lambda runs: runs.assign(is_avoided=1)),
        "is_avoided: got int64 values; expected true or false",
    ),
    "half a row": (
        cut_off("apr.csv", 0.999),
        "apr.csv: got no line break at the end; expected a",
    ),
    "a row less": (
        change_text("apr.csv", drop_last_line),
        (
            r"apr.csv: got \d+ rows, not the same ones for every layout and party;"
            r" expected those of"
        ),
    ),
    "another party": (
        change_text("apr.csv", lambda text: text.replace(",rsu_all,", ",rsu_none,")),
        "not the same ones for every layout and party",
    ),
    "another table": (
        change_text("apr.csv", lambda text: "a,b\n1,2\n"),
        "no column layout",
    ),
    "too many": (
        change_text("apr.csv", lambda text: text + '"\n'),
        "apr.csv: got .*; expected a",
    ),
}


@pytest.mark.parametrize("what", BROKEN)
def test_what_is_broken_or_of_other_results_is_refused_in_one_line(what, folder):
    damage, expected = BROKEN[what]
    damage(folder)

    with pytest.raises(InputError, match=expected) as caught:
        load_result(folder)
    assert "\n" not in str(caught.value)
    assert str(folder) in str(caught.value)


def test_a_file_or_nothing_is_no_folder(tmp_path):
    with pytest.raises(InputError, match="got no folder; expected a folder of results"):
        load_result(tmp_path / "missing")
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="got no folder; expected a folder of results"):
        load_result(tmp_path / "file")


def test_runs_that_are_cut_off_anywhere_are_refused(folder):
    path = folder / "runs.parquet"
    data = path.read_bytes()
    for length in np.linspace(0, len(data) - 1, 40).astype(int).tolist():
        path.write_bytes(data[:length])
        with pytest.raises(
            InputError, match=r"runs\.parquet: got .*; expected a whole file"
        ):
            load_result(folder)


@pytest.mark.long
def test_runs_with_a_wrong_byte_are_refused_or_read(folder):
    """Never anything else than one line; some bytes are of no consequence."""
    path = folder / "runs.parquet"
    data = path.read_bytes()
    rng = np.random.default_rng(1)
    n_refused = 0
    for index in rng.choice(len(data), 80, replace=False).tolist():
        damaged = bytearray(data)
        damaged[index] ^= int(rng.integers(1, 256))
        path.write_bytes(bytes(damaged))
        with suppress(InputError):
            load_result(folder)
            continue
        n_refused += 1

    assert n_refused > 0


def test_layouts_may_be_called_as_what_is_missing(folder):
    """ "nan" is text in apr.csv, not a number that is none."""
    for name in ("nan", "12"):
        change_json(
            folder / "summary.json",
            lambda summary, name=name: summary.update(name=name),
        )
        old = pd.read_parquet(folder / "runs.parquet")["layout"].iloc[0]
        change_runs(lambda runs, o=old, n=name: runs.replace({"layout": {o: n}}))(
            folder
        )
        change_text(
            "apr.csv", lambda text, o=old, n=name: text.replace(f"{o},", f"{n},")
        )(folder)
        assert set(load_result(folder).apr["layout"]) >= {name}
