"""Results that somebody has changed: ``verify`` finds it, or names it, and ``--deep``
finds it.

After every change the list of hashes is made anew, and with it what else the change
would give away, so that the files agree as well as whoever changed them could make them
agree.
"""

import base64
import json
import re
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import msgspec
import numpy as np
import pandas as pd
import pytest
from json_files import read_json
from small_results import (
    build_small_baseline,
    build_small_setting,
    small_world,
    write_small_results,
)

from experiments.export.csv import to_csv
from experiments.export.geojson import to_geojson
from experiments.jobs import anew, evaluation, placement
from experiments.jobs import search as jobs_search
from experiments.jobs.placement import answer_placement, write_files
from experiments.jobs.search import search
from experiments.jobs.verify import run_verification
from experiments.parts.reading import read_summary
from experiments.progress import StageProgress
from experiments.results.folders import MANIFEST, write_manifest
from geometry.errors import InputError
from geometry.scene_files import save_scene
from geometry.study_scene import load_study_scene
from placement.compute import Compute
from placement.layout import load_layout
from placement.proof_files import instance_of, save_problem
from placement.question import Question
from placement.verification.instances import load_stored_problem

pytestmark = pytest.mark.long

ASKED = Question(budget=2, give_up=0.0, time_limit_s=60.0)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """Results with a report, as they were written."""
    folder = tmp_path_factory.mktemp("placed") / "results"
    write_small_results(folder, build_small_setting(), ASKED, has_report=True)
    return folder


@pytest.fixture(scope="module")
def made_anew(written, tmp_path_factory):
    """What ``--deep`` computes, and the files that it writes: once for all changes."""
    folder = tmp_path_factory.mktemp("anew") / "anew"
    stored = read_summary(written / "summary.json")
    with small_world(build_small_setting()):
        found = search(ASKED, compute=Compute(workers=2), progress=StageProgress())
        answered = answer_placement(found)
        folder.mkdir()
        seconds = {
            stage: value
            for stage, value in stored.seconds.items()
            if stage not in ("write results", "total")
        }
        write_files(folder, answered, msgspec.structs.replace(stored, seconds=seconds))
        yield answered, folder


@pytest.fixture
def deep(made_anew, monkeypatch):
    """Lets ``--deep`` find what was computed before."""
    answered, files = made_anew

    def write(folder, *given):
        shutil.copytree(files, folder, dirs_exist_ok=True)

    monkeypatch.setattr(jobs_search, "search", lambda *given, **more: None)
    monkeypatch.setattr(placement, "answer_placement", lambda found: answered)
    monkeypatch.setattr(placement, "write_files", write)


def deeply_failed(folder):
    """Names of the checks of ``--deep`` that fail."""
    failures = []

    def add(name, wrong, right):
        if wrong:
            failures.append(name)

    anew.compare_anew(folder, ASKED, add, StageProgress())
    return failures


@pytest.fixture
def results(written, tmp_path):
    """A copy of them to change."""
    return Path(shutil.copytree(written, tmp_path / "results"))


def verified(folder, scene=""):
    """What ``verify`` finds."""
    return run_verification(folder, scene=scene, progress=StageProgress())


def verified_deeply(folder):
    """What ``verify --deep`` finds."""
    return run_verification(folder, question=ASKED, progress=StageProgress())


def failed(found):
    """Names of the checks that fail."""
    return [check.name for check in found.checks if not check.passed]


def edit(path, change):
    """Change a file of JSON."""
    document = read_json(path)
    change(document)
    path.write_text(json.dumps(document, indent=2))


def edited(name, change):
    """A JSON file of the results, changed as a document."""
    return lambda folder: edit(folder / name, change)


def told(name, /, *keys, **values):
    """Values otherwise in a JSON file, in the object that some keys lead to."""

    def change(document):
        for key in keys:
            document = document[key]
        document.update(values)

    return edited(name, change)


layout = partial(told, "layout.json")
certificate = partial(told, "certificate.json")
summary = partial(told, "summary.json")


def both(*keys, **values):
    """Values otherwise in certificate and summary alike."""
    return chained(certificate(*keys, **values), summary(*keys, **values))


def unit(**values):
    """The first unit otherwise, in ``layout.json`` alone."""
    return layout("layout", 0, **values)


def everywhere(**values):
    """The first unit otherwise, in every file that shows it."""

    def change(folder):
        layout("layout", 0, **values)(folder)
        certificate("layout", 0, "unit", **values)(folder)
        summary("layout", 0, **values)(folder)
        shown = load_layout(folder / "layout.json")
        scene = load_study_scene()
        (folder / "layout.csv").write_text(to_csv(shown, scene))
        (folder / "layout.geojson").write_text(to_geojson(shown, scene.crs, scene))

    return change


def instance(change):
    """Another instance, with its hash and sizes in the certificate; given the first
    unit's row.
    """

    def rewrite(folder):
        row = read_json(folder / "certificate.json")["layout"][0]["row"]
        problem, mounts = change(load_stored_problem(folder / "instance.npz"), row)
        save_problem(folder / "instance.npz", problem, mounts)
        told = instance_of(problem, mounts)
        edit(folder / "certificate.json", lambda d: d.update(instance=told))

    return rewrite


def mounts(**values):
    """Fields of the mounts otherwise: functions of the old value and the first unit's
    row.
    """

    def change(stored, row):
        return stored._replace(mounts=otherwise(stored.mounts, values, row))

    return instance(change)


def axis(**values):
    """Fields of the runs otherwise: functions of the old value."""

    def change(stored, row):
        table = stored.problem.table
        table = replace(table, axis=otherwise(table.axis, values))
        return stored._replace(problem=replace(stored.problem, table=table))

    return instance(change)


def limits(**values):
    """Fields of the limits otherwise: functions as those of mounts."""

    def change(stored, row):
        changed = otherwise(stored.problem.limits, values, row)
        return stored._replace(problem=replace(stored.problem, limits=changed))

    return instance(change)


def otherwise(thing, values, *given):
    """A copy of a thing with other fields, each a function of the old one."""
    changed = {name: new(getattr(thing, name), *given) for name, new in values.items()}
    return replace(thing, **changed)


def at(index, value):
    """A copy of an array with one value otherwise."""

    def change(array):
        copy = array.copy()
        copy[index] = value
        return copy

    return change


def at_row(value):
    """A value otherwise in the first unit's row."""
    return lambda array, row: at(row, value)(array)


def chained(*changes):
    """Several changes, one after the other."""

    def change(folder):
        for one in changes:
            one(folder)

    return change


def runs(change):
    """The table of runs otherwise."""

    def rewrite(folder):
        table = pd.read_parquet(folder / "runs.parquet")
        change(table)
        table.to_parquet(folder / "runs.parquet")

    return rewrite


def column(**values):
    """Columns of the table of runs otherwise: values, or functions of the old ones."""

    def change(table):
        for name, value in values.items():
            table[name] = value(table[name]) if callable(value) else value

    return runs(change)


def replaced(name, old, new):
    """The first of some words in a file otherwise."""

    def change(folder):
        text = (folder / name).read_text()
        assert old in text

        (folder / name).write_text(text.replace(old, new, 1))

    return change


def appended(name, text):
    """A file with more at its end."""
    return lambda folder: written_as(name, (folder / name).read_text() + text)(folder)


def written_as(name, text):
    """A file that says something else, or a new one."""
    return lambda folder: (folder / name).write_text(text)


def missing(name):
    """A file that is gone."""
    return lambda folder: (folder / name).unlink()


def without_row_of(name):
    """A table without its last row."""

    def change(folder):
        lines = (folder / name).read_text().splitlines(keepends=True)
        (folder / name).write_text("".join(lines[:-1]))

    return change


def row_of_equal_value(folder):
    """The first unit's row and name become those of another pose that detects the same.

    In the instance both detect the same from now on.
    """
    document = read_json(folder / "certificate.json")
    row = document["layout"][0]["row"]
    other = (row + 1) % document["instance"]["n_poses"]

    def change(stored, first):
        table = stored.problem.table
        problem = stored.problem
        packed = table.packed.copy()
        packed[other] = packed[row]
        return stored._replace(
            problem=replace(problem, table=replace(table, packed=packed))
        )

    instance(change)(folder)
    name = load_stored_problem(folder / "instance.npz").problem.table.pose_ids[other]
    certificate("layout", 0, row=other, pose=name)(folder)


def another_bit(stored, row):
    """A bit otherwise of a pose that is not used."""
    table = stored.problem.table
    unused = next(index for index in range(table.n_poses) if index != row)
    packed = table.packed.copy()
    packed[unused, 0] ^= np.uint8(1)
    return stored._replace(
        problem=replace(stored.problem, table=replace(table, packed=packed))
    )


def all_of_all(folder):
    """Everybody avoids every run, in all files alike: the headline says 100 %."""
    column(is_avoided=True)(folder)
    ratios = pd.read_csv(folder / "apr.csv", keep_default_na=False, dtype=str)
    ratios.loc[ratios["apr"] != "", "apr"] = "1.0"
    ratios["n_avoided"] = ratios["n_runs"]
    ratios.to_csv(folder / "apr.csv", index=False, lineterminator="\n")

    def tell(document):
        for one in (document, document["baseline"], document["greedy"]):
            for party, ratios in one["evaluation"].items():
                for told in ratios.values() if party == "units" else [ratios]:
                    if isinstance(told, dict) and "all" in told:
                        told["all"] = 1.0
                        for key in ("by_case", "by_position"):
                            told[key] = dict.fromkeys(told.get(key) or {}, 1.0)

    edited("summary.json", tell)(folder)


def twice(name, key):
    """A key of a JSON file stands there twice, first with another value."""

    def change(folder):
        text = (folder / name).read_text()
        (folder / name).write_text(text.replace("{", '{"' + key + '": [],', 1))

    return change


def flipped(name):
    """A bit in the middle of a file is another one."""

    def change(folder):
        data = bytearray((folder / name).read_bytes())
        data[len(data) // 2] ^= 1
        (folder / name).write_bytes(data)

    return change


def another_picture(folder):
    """The first picture in the report is another one."""
    text = (folder / "report.html").read_text()
    first = re.search(r"data:image/png;base64,([A-Za-z0-9+/=]+)", text)

    assert first is not None

    blank = base64.b64encode((folder / "plan.png").read_bytes()[:200]).decode()
    (folder / "report.html").write_text(text.replace(first[1], blank, 1))


def highest(document):
    """A highest APR that nobody found, with a proof."""
    stages = [dict(stage) for stage in document["stages"][:2]]
    document["highest"] = {"given_up": 0.01, "stages": stages, "compared": None}


def all_of_one(folder):
    """The evaluator's outcomes of a party, and every ratio that follows from them."""
    name = read_json(folder / "summary.json")["name"]

    def turn(table):
        table.loc[
            (table["layout"] == name) & (table["party"] == "vut"), "is_avoided"
        ] = True

    runs(turn)(folder)
    ratios = pd.read_csv(folder / "apr.csv", keep_default_na=False, dtype=str)
    rows = (ratios["layout"] == name) & (ratios["party"] == "vut")
    ratios.loc[rows, "apr"] = "1.0"
    ratios.loc[rows, "n_avoided"] = ratios.loc[rows, "n_runs"]
    ratios.to_csv(folder / "apr.csv", index=False, lineterminator="\n")

    def tell(document):
        vut = document["evaluation"]["vut"]
        vut["all"] = 1.0
        for key in ("by_case", "by_position"):
            vut[key] = dict.fromkeys(vut[key], 1.0)

    edited("summary.json", tell)(folder)


MINE = {
    **{
        "kind": "camera",
        "width_px": 1920,
        "height_px": 1080,
        "horizontal_fov_deg": 110.0,
    },
    **{"frame_rate_hz": 10.0, "near_m": 0.5, "price_eur": 1500.0},
}


def own_model(**values):
    """The layout file brings a model of its own under the name that all files have."""
    return layout(sensors={"carla-ncap-rgb": MINE | values})


# How the name of a check begins that must fail, or behind a question mark words that
# must be among what is said not to be checked; and what was changed.
FOUND = {
    "layout file": {
        "another yaw": unit(yaw_deg=12.0),
        "another pitch": unit(pitch_deg=-21.0),
        "30 m east": unit(x_m=-85.0),
        "higher": unit(z_m=7.0),
        "another site": unit(site="mast-w"),
        "another name of a unit": unit(id="U9"),
        "another latency": unit(latency_s=0.5),
        "a unit less": edited("layout.json", lambda d: d["layout"].pop()),
        "units in another order": edited(
            "layout.json", lambda d: d["layout"].reverse()
        ),
    },
    "unit ": {
        "more pixels under the same name": own_model(width_px=3840, height_px=2160),
        "a wider lens under the same name": own_model(horizontal_fov_deg=120.0),
        "a cheaper camera under the same name": own_model(price_eur=1.0),
        "30 m east, everywhere": everywhere(x_m=-85.0),
        "another yaw, everywhere": everywhere(yaw_deg=12.0),
        "another pitch, everywhere": everywhere(pitch_deg=-21.0),
        "higher, everywhere": everywhere(z_m=7.0),
        "another site, everywhere": everywhere(site="mast-n"),
        "another latency, everywhere": everywhere(latency_s=0.5),
        "another camera, everywhere": everywhere(camera="varifocal-1080p"),
        "a row of equal value": row_of_equal_value,
        "another sensor": mounts(
            sensors=lambda m, row: (replace(m[0], width_px=3840), *m[1:])
        ),
    },
    "scene": {
        "another scene": layout(scene="elsewhere"),
        "no scene": edited("layout.json", lambda d: d.pop("scene")),
        "another scene's name": mounts(scene_name=lambda m, row: "elsewhere"),
    },
    "summary.json: name": {"another name of the layout": layout(name="x")},
    "pose names": {
        "another row": certificate("layout", 0, row=0),
        "another name of a pose": certificate("layout", 0, pose="a"),
    },
    "smallest_margin_s": {"a better value": both("stages", 2, objective=9.0)},
    "mean_margin_s: bound": {"a lower bound": both("stages", 3, bound=0.1)},
    "mean_margin_s: gap": {"another gap": both("stages", 3, gap=0.5)},
    "mean_margin_s": {"not proven": certificate("stages", 3, is_proven=False)},
    "proof": {"proof incomplete": certificate(is_proven=False)},
    "stages": {
        "a stage less": chained(
            edited("certificate.json", lambda d: d["stages"].pop()),
            edited("summary.json", lambda d: d["stages"].pop()),
        )
    },
    "summary.json: solver": {"another solver": certificate(solver="x")},
    "summary.json: v": {"another version": certificate("versions", numpy="9")},
    "summary": {"seconds of a stage": certificate("stages", 0, seconds=9.9)},
    "?and seconds": {"seconds of a step": certificate("seconds", optimise=9.9)},
    "model in": {"other words": certificate("model", "in_words", apr="x")},
    "model": {
        "another budget": certificate("model", "limits", budget_units=9),
        "another rule": certificate("model", "rule", latency_s=9.0),
        "another goal": certificate("model", goal="fewest"),
    },
    "presolve": {
        "more poses before presolve": certificate("presolve", n_poses=[9999, 1])
    },
    "summary.json: presolve": {
        "fewer poses after presolve": edited(
            "certificate.json", lambda d: d["presolve"]["n_poses"].__setitem__(1, 1)
        )
    },
    "instance sizes": {
        "another size of the instance": certificate("instance", n_runs=9)
    },
    "instance": {"another hash": certificate("instance", sha256="0" * 64)},
    "?solver, presolved sizes": {"another solver, twice": both(solver="x")},
    "?versions of programs": {"other versions, twice": both("versions", numpy="9")},
    "poses and names": {
        "a pose that looks elsewhere": mounts(yaw_deg=at_row(12.0)),
        "a pose that hangs elsewhere": mounts(
            position_m=lambda m, row: at(row, m[row] + [1.0, 0.0, 0.0])(m)
        ),
    },
    "scene as it stands": {
        "all poses of a site elsewhere": mounts(
            position_m=lambda m, row: m + [30.0, 0.0, 0.0]
        ),
        "another scene's hash": mounts(scene_sha256=lambda m, row: "0" * 64),
    },
    "prices of sensors": {
        "another price of a sensor": mounts(
            sensors=lambda m, row: (replace(m[0], price_eur=1.0), *m[1:])
        ),
        "another price": limits(unit_cost_eur=at_row(1.0)),
    },
    "poses and sites": {
        "poses of another site": limits(
            site_index=lambda m, row: at(row, (m[row] + 1) % (m.max() + 1))(m)
        )
    },
    "runs.parquet": {
        "other weights": axis(
            weight=lambda w: (
                np.arange(1.0, len(w) + 1.0) / np.arange(1.0, len(w) + 1.0).sum()
            )
        ),
        "another last brake time": axis(last_brake_time_s=at(0, -9.0)),
        "another speed": axis(vut_speed_kmh=at(0, 9.0)),
        "weights of runs": column(weight=1.0),
    },
    "?whether the detection table is right": {
        "a bit of the table": instance(another_bit)
    },
    "summary.json: apr": {"another APR": summary(apr=0.5)},
    "summary.json: ratios": {
        "another ratio": summary("evaluation", "rsu_all", all=0.5),
        "another ratio of the baseline": summary(
            "baseline", "evaluation", "rsu_all", all=0.0
        ),
        "another ratio at a position": edited(
            "summary.json",
            lambda d: d["evaluation"]["vut"]["by_position"].update({"0": 0.123}),
        ),
    },
    "summary.json: candidates": {"more candidates": summary(candidates=9)},
    "summary.json: b": {"another budget, in the summary": summary(budget=9)},
    "summary.json: spent_eur": {"money spent": summary(spent_eur=1.0)},
    "?explained": {"what explains it": summary("explained", runs_without_weight=7)},
    "tables": {
        "no summary": missing("summary.json"),
        "a row of ratios less": without_row_of("apr.csv"),
        "no ratios": missing("apr.csv"),
        "no runs": missing("runs.parquet"),
    },
    "apr.csv": {
        "a ratio": replaced("apr.csv", ",1.0,", ",0.5,"),
        "an outcome": column(is_avoided=lambda old: ~old),
    },
    "?outcomes in runs.parquet": {"outcomes and all that follows": all_of_one},
    "layout.csv": {"layout.csv": replaced("layout.csv", "-20", "-21")},
    "layout.geojson": {"layout.geojson": replaced("layout.geojson", "-20", "-21")},
    "?layout.csv: not there": {"no layout.csv": missing("layout.csv")},
    "?bill_of_materials.csv": {
        "bill of materials": appended("bill_of_materials.csv", "x\n")
    },
    "?report.html": {"report.html": appended("report.html", "<p>x")},
    "?report.html: not there": {"no report.html": missing("report.html")},
    "?what a.txt": {"another file": written_as("a.txt", "x")},
}


# What the files agree about, so that ``verify`` alone cannot know: how the name of the
# file begins that ``--deep`` finds to differ when made anew, and what was changed.
DEEP = {
    "runs.parquet": {
        "all runs avoided, everywhere": all_of_all,
        "outcomes and all that follows": all_of_one,
        "margins": column(margin_s=9.0),
        "when a run is confirmed": column(confirmation_time_s=0.1),
        "how much is detected": column(detected_share=1.0),
        "impact speeds": column(impact_speed_kmh=1.0),
    },
    "certificate.json": {
        "a bit of a pose that is not used": instance(another_bit),
        "another solver, twice": both(solver="x"),
    },
    "bill": {
        "a price in the bill": replaced("bill_of_materials.csv", "1500", "1"),
        "a line of the bill less": without_row_of("bill_of_materials.csv"),
        "a line of the bill more": appended("bill_of_materials.csv", "x\n"),
        "no bill": missing("bill_of_materials.csv"),
    },
    "summary.json": {
        "costs of sites": summary(sites_eur=1.0),
        "costs of sites that are assumed": summary(assumed_prices=["none"]),
        "a highest APR": edited("summary.json", highest),
        "errors of mounting": summary(mounting=None),
        "the next unit": summary(next_unit=None),
        "random layouts": summary("baselines", random=None),
        "an expert's layout": summary("baselines", expert=None),
        "smaller layouts": summary(front=None),
        "what explains it": summary("explained", runs_without_weight=7),
        "by road user": summary(road_users=None),
        "how many disagree": summary(surrogate_disagreement=0.9),
        "what is left out": summary(driven=["everything"]),
        "another detector": summary(detector="x"),
        "another weather": summary(weathers=["fog"]),
    },
    "report.html": {
        "a word in the report": appended("report.html", "<p>x"),
        "a number in the report": replaced("report.html", " %", "9 %"),
        "a picture in the report": another_picture,
        "no report": missing("report.html"),
        "an empty report": written_as("report.html", ""),
    },
    "plan.png": {"another plan": flipped("plan.png"), "no plan": missing("plan.png")},
    "layout.csv": {"no layout.csv": missing("layout.csv")},
    "layout.geojson": {"no layout.geojson": missing("layout.geojson")},
    "a.txt": {"another file": written_as("a.txt", "x")},
    "recommended.json": {
        "a recommendation": lambda folder: shutil.copy(
            folder / "layout.json", folder / "recommended.json"
        )
    },
}

# What ``verify`` refuses to read at all: how its one line begins behind the name of the
# file.
REFUSED = {
    "no list of hashes": (
        missing(MANIFEST),
        "got no SHA256SUMS; expected a folder of results",
    ),
    "a certificate with stages twice": (
        twice("certificate.json", "stages"),
        (
            'certificate.json: got the key "stages" twice; expected every key of an'
            " object once"
        ),
    ),
    "a summary with stages twice": (
        twice("summary.json", "stages"),
        'summary.json: got the key "stages" twice',
    ),
    "a layout with units twice": (
        twice("layout.json", "layout"),
        'layout.json: got the key "layout" twice',
    ),
    "half an instance": (
        written_as("instance.npz", "PK"),
        "instance.npz: got ",
    ),
    "no certificate": (
        missing("certificate.json"),
        "certificate.json: got No such file",
    ),
    "no instance": (missing("instance.npz"), "instance.npz: got No such file"),
    "no layout": (missing("layout.json"), "layout.json: got No such file"),
}


def each_change(changes):
    """Pairs of a check and the name of a change that it must find."""
    return [(check, name) for check, names in changes.items() for name in names]


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_read_in_one_way_only_is_refused(results, name):
    change, expected = REFUSED[name]
    change(results)
    if (results / MANIFEST).exists():
        write_manifest(results)

    with pytest.raises(InputError, match=re.escape(expected)):
        verified(results)


def test_a_file_that_is_listed_twice_is_refused(results):
    lines = (results / MANIFEST).read_text()
    (results / MANIFEST).write_text(lines + f"{'0' * 64}  report.html\n")

    with pytest.raises(
        InputError, match=re.escape("got 'report.html'; expected every")
    ):
        verified(results)


def test_what_nobody_has_changed_is_the_same_when_it_is_made_anew(results, deep):
    found = verified_deeply(results)
    assert failed(found) == []
    assert found.is_verified

    left = " ".join(found.not_checked)

    assert "report.html" not in left
    assert "runs.parquet" not in left
    assert "seconds, versions of programs" in left


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(change, id=name)
        for changes in (*DEEP.values(), *FOUND.values())
        for name, change in changes.items()
    ],
)
def test_without_new_hashes_every_change_is_found(results, change):
    change(results)
    try:
        found = verified(results)
    except InputError:
        return

    assert any(one.startswith("file ") for one in failed(found))


@pytest.mark.parametrize(
    ("file", "name"), [(file, name) for file in DEEP for name in DEEP[file]]
)
def test_verify_alone_names_what_only_deep_finds(results, deep, file, name):
    DEEP[file][name](results)
    write_manifest(results)
    found = verified_deeply(results)

    assert not found.is_verified
    assert any(one.startswith(f"anew: {file}") for one in failed(found))


def test_every_value_of_a_summary_is_compared_with_the_one_made_anew(written):
    """Whatever is changed differs; times and versions do not count, what was asked is
    used.
    """
    document = read_json(written / "summary.json")
    assert anew.differences(document, json.loads(json.dumps(document))) == []

    n_changed = 0
    for holder, key in leaves(document):
        before = holder[key]
        if before != "other":
            holder[key] = "other"
        else:
            holder[key] = None
        changed = json.dumps(document)
        holder[key] = before

        assert anew.differences(json.loads(changed), document) != [], key

        n_changed += 1

    assert n_changed > 500


def leaves(node):
    """Every value in a document that holds no others, by what holds it and its key
    there.
    """
    if isinstance(node, dict):
        items = node.items()
    else:
        items = enumerate(node)
    for key, value in items:
        if key in ("seconds", "versions"):
            continue
        if isinstance(value, dict | list):
            yield from leaves(value)
        else:
            yield node, key


def test_numbers_are_equal_up_to_rounding_and_texts_exactly():
    assert anew.differences({"a": [1.0, 2]}, {"a": [1.0 + 1e-12, 2]}) == []
    assert anew.differences({"a": [1.0, 2]}, {"a": [1.0, 3]}) == ["a[1]"]
    assert anew.differences({"a": 1.0}, {"a": 1.0, "b": None}) == ["b"]
    assert anew.differences({"a": {"seconds": 1.0}}, {"a": {"seconds": 2.0}}) == []
    assert (
        anew.told(["a", "b", "c", "d"]) == "made anew it differs in a, b, c and 1 more"
    )


def test_another_layout_is_told_and_nothing_else_compared(results, deep):
    edit(results / "summary.json", lambda d: d["layout"].pop())
    assert deeply_failed(results) == ["anew: layout.json"]


def test_what_nobody_has_changed_is_verified(results):
    found = verified(results)
    assert failed(found) == []
    assert found.is_verified

    names = [check.name for check in found.checks]

    assert len(set(names)) == len(names)


@pytest.mark.parametrize(("expected", "name"), each_change(FOUND))
def test_what_was_changed_is_found_or_named(results, expected, name):
    change = FOUND[expected][name]
    change(results)
    write_manifest(results)
    found = verified(results)

    assert found.is_verified == (not failed(found))

    if expected.startswith("?"):
        assert failed(found) == []
        assert any(expected[1:] in line for line in found.not_checked), (
            found.not_checked
        )
    else:
        assert any(name.startswith(expected) for name in failed(found)), failed(found)


@pytest.mark.parametrize(
    "name",
    [
        "report.html",
        *("bill_of_materials.csv", "layout.geojson"),
    ],
)
def test_whoever_forgets_the_list_of_hashes_is_found_out(results, name):
    (results / name).write_text("x")
    (results / "more.txt").write_text("x")
    found = verified(results)

    assert {f"file {name}", "file more.txt"} <= set(failed(found))

    (results / name).unlink()
    details = {check.name: check.detail for check in verified(results).checks}

    assert details[f"file {name}"] == "missing, says SHA256SUMS"
    assert details["file more.txt"] == "not listed, says SHA256SUMS"


def test_a_list_of_hashes_that_is_none_is_refused(results):
    (results / MANIFEST).write_text("no list\n")
    with pytest.raises(InputError, match="SHA-256 hash, two spaces, a name"):
        verified(results)


def test_an_instance_of_the_first_version_says_what_it_cannot_show(results):
    def without_mounts(stored, row):
        return stored._replace(mounts=None)

    instance(without_mounts)(results)
    write_manifest(results)
    found = verified(results)

    assert failed(found) == []
    assert any(
        line.startswith("positions, directions and sensor models")
        for line in found.not_checked
    )
    assert "layout.csv" in {check.name for check in found.checks}


def test_another_scene_is_told_and_the_one_it_was_made_in_is_taken(results, tmp_path):
    (tmp_path / "scene").mkdir()
    # Rounded to millimetres: another one.
    save_scene(tmp_path / "scene", load_study_scene())

    assert failed(verified(results, str(tmp_path / "scene"))) == ["scene as it stands"]
    assert failed(verified(results, "town05")) == []


# ---------- results without a proof


@pytest.fixture(scope="module")
def compared(tmp_path_factory):
    """A comparison of the study's first units with its first one, without figures."""
    folder = tmp_path_factory.mktemp("compared") / "results"
    study = build_small_baseline(load_study_scene())
    layouts = [study, replace(study, name="one", units=study.units[:1])]
    with small_world(build_small_setting()) as patch:
        patch.setattr(placement, "write_report", lambda *given, **options: None)
        patch.setattr(evaluation, "compare_layout", lambda *given, **options: None)
        evaluation.run_comparison(
            Question(),
            layouts=layouts,
            out=folder,
            compute=Compute(workers=2),
            command="place-rsus",
            progress=StageProgress(),
        )

    return folder


def test_a_comparison_is_verified_as_far_as_its_files_tell(compared, tmp_path):
    found = verified(compared)
    assert failed(found) == []
    assert "summary.json: ratios" in {check.name for check in found.checks}
    assert any(
        line.startswith("detections, confirmations") for line in found.not_checked
    )

    results = Path(shutil.copytree(compared, tmp_path / "results"))
    edit(
        results / "summary.json", lambda d: d["evaluation"]["rsu_all"].update(all=0.123)
    )

    assert set(failed(verified(results))) == {
        "file summary.json",
        "summary.json: ratios",
    }
    with pytest.raises(InputError, match="expected a placement: run the command again"):
        verified_deeply(results)
