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
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import msgspec
import numpy as np
import pandas as pd
import pytest
from small_results import (
    build_small_baseline,
    build_small_setting,
    small_world,
    write_small_results,
)

from experiments.export.geojson import to_geojson
from experiments.export.table import to_csv
from experiments.jobs import anew, evaluation, placement
from experiments.jobs.placement import answer_placement, write_files
from experiments.jobs.verify import run_verification
from experiments.parts.reading import read_summary
from experiments.progress import StageProgress
from experiments.results.folders import MANIFEST, write_manifest
from geometry.errors import InputError
from geometry.scene_files import save_scene
from geometry.study_scene import load_study_scene
from placement.compute import Compute
from placement.layout import load_layout
from placement.question import Question
from placement.verification.certificates import instance_of
from placement.verification.instances import (
    load_stored_problem,
    save_problem,
)

ASKED = Question(budget=2, give_up=0.0, time_limit_s=60.0)
Change = Callable[[Path], None]
Document = dict[str, Any]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("placed") / "results"
    write_small_results(folder, build_small_setting(), ASKED, has_report=True)
    return folder


@pytest.fixture(scope="module")
def made_anew(written, tmp_path_factory):
    """What ``--deep`` computes, and the files that it writes: once for all changes."""
    folder = tmp_path_factory.mktemp("anew") / "anew"
    stored = read_summary(written / "summary.json")
    with (
        small_world(build_small_setting()),
        answer_placement(
            ASKED, out=folder, compute=Compute(workers=2), progress=StageProgress()
        ) as answered,
    ):
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

    monkeypatch.setattr(
        placement, "answer_placement", lambda *given, **more: nullcontext(answered)
    )
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
    return Path(shutil.copytree(written, tmp_path / "results"))


def verified(folder, scene=""):
    return run_verification(folder, scene=scene, progress=StageProgress())


def verified_deeply(folder):
    return run_verification(folder, question=ASKED, progress=StageProgress())


def failed(found):
    return [check.name for check in found.checks if not check.passed]


def edit(path, change):
    document = json.loads(path.read_text())
    change(document)
    path.write_text(json.dumps(document, indent=2))


def layout(change):
    return lambda folder: edit(folder / "layout.json", change)


def certificate(change):
    return lambda folder: edit(folder / "certificate.json", change)


def summary(change):
    return lambda folder: edit(folder / "summary.json", change)


def unit(**values):
    """The first unit otherwise, in ``layout.json`` alone."""
    return layout(lambda d: d["layout"][0].update(values))


def everywhere(**values):
    """The first unit otherwise, in every file that shows it."""

    def change(folder):
        edit(folder / "layout.json", lambda d: d["layout"][0].update(values))
        edit(
            folder / "certificate.json", lambda d: d["layout"][0]["unit"].update(values)
        )
        edit(folder / "summary.json", lambda d: d["layout"][0].update(values))
        shown = load_layout(folder / "layout.json")
        scene = load_study_scene()
        (folder / "layout.csv").write_text(to_csv(shown, scene))
        (folder / "layout.geojson").write_text(to_geojson(shown, scene.crs, scene))

    return change


def both(change):
    def change_both(folder):
        certificate(change)(folder)
        summary(change)(folder)

    return change_both


def instance(change):
    """Another instance, with its hash and sizes in the certificate; given the first
    unit's row.
    """

    def rewrite(folder):
        row = json.loads((folder / "certificate.json").read_text())["layout"][0]["row"]
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
        assert stored.mounts is not None
        changed = {
            name: new(getattr(stored.mounts, name), row) for name, new in values.items()
        }
        return stored._replace(mounts=replace(stored.mounts, **changed))

    return instance(change)


def axis(**values):
    def change(stored, row):
        table = stored.problem.table
        changed = {name: new(getattr(table.axis, name)) for name, new in values.items()}
        table = replace(table, axis=replace(table.axis, **changed))
        return stored._replace(problem=replace(stored.problem, table=table))

    return instance(change)


def limits(**values):
    def change(stored, row):
        old = stored.problem.limits
        changed = {name: new(getattr(old, name), row) for name, new in values.items()}
        return stored._replace(
            problem=replace(stored.problem, limits=replace(old, **changed))
        )

    return instance(change)


def at(index, value):
    """A copy of an array with one value otherwise."""

    def change(array):
        copy = array.copy()
        copy[index] = value
        return copy

    return change


def at_row(value):
    return lambda array, row: at(row, value)(array)


def chained(*changes):
    def change(folder):
        for one in changes:
            one(folder)

    return change


def runs(change):
    def rewrite(folder):
        table = pd.read_parquet(folder / "runs.parquet")
        change(table)
        table.to_parquet(folder / "runs.parquet")

    return rewrite


def replaced(name, old, new):
    def change(folder):
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1))

    return change


def appended(name, text):
    return lambda folder: (
        (folder / name).write_text((folder / name).read_text() + text) and None
    )


def missing(name):
    return lambda folder: (folder / name).unlink()


def without_row_of(name):
    def change(folder):
        lines = (folder / name).read_text().splitlines(keepends=True)
        (folder / name).write_text("".join(lines[:-1]))

    return change


def row_of_equal_value(folder):
    """The first unit's row and name become those of another pose that detects the same.

    In the instance both detect the same from now on.
    """
    document = json.loads((folder / "certificate.json").read_text())
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
    certificate(lambda d: d["layout"][0].update(row=other, pose=name))(folder)


def flip(array, row=0):
    copy = array.copy()
    copy[0, 0] ^= np.uint8(1)
    return copy


def another_bit(stored, row):
    table = stored.problem.table
    unused = next(index for index in range(table.n_poses) if index != row)
    packed = table.packed.copy()
    packed[unused, 0] ^= np.uint8(1)
    return stored._replace(
        problem=replace(stored.problem, table=replace(table, packed=packed))
    )


def all_of_all(folder):
    """Everybody avoids every run, in all files alike: the headline says 100 %."""
    runs(lambda table: table.__setitem__("is_avoided", True))(folder)
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

    summary(tell)(folder)


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
    name = json.loads((folder / "summary.json").read_text())["name"]

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

    summary(tell)(folder)


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
    return layout(lambda d: d.update(sensors={"carla-ncap-rgb": MINE | values}))


# What was changed; how the name of a check begins that must fail, or behind a question
# mark words that must be among what is said not to be checked.
FOUND = {
    # The layout alone.
    "another yaw": (unit(yaw_deg=12.0), "layout file"),
    "another pitch": (unit(pitch_deg=-21.0), "layout file"),
    "30 m east": (unit(x_m=-85.0), "layout file"),
    "higher": (unit(z_m=7.0), "layout file"),
    "another site": (unit(site="mast-w"), "layout file"),
    "another name of a unit": (unit(id="U9"), "layout file"),
    "another latency": (unit(latency_s=0.5), "layout file"),
    "more pixels under the same name": (
        own_model(width_px=3840, height_px=2160),
        "unit ",
    ),
    "a wider lens under the same name": (own_model(horizontal_fov_deg=120.0), "unit "),
    "a cheaper camera under the same name": (own_model(price_eur=1.0), "unit "),
    "another scene": (layout(lambda d: d.update(scene="elsewhere")), "scene"),
    "no scene": (layout(lambda d: d.pop("scene")), "scene"),
    "another name of the layout": (
        layout(lambda d: d.update(name="x")),
        "summary.json: name",
    ),
    "a unit less": (layout(lambda d: d["layout"].pop()), "layout file"),
    "units in another order": (layout(lambda d: d["layout"].reverse()), "layout file"),
    # The layout wherever it is shown.
    "30 m east, everywhere": (everywhere(x_m=-85.0), "unit "),
    "another yaw, everywhere": (everywhere(yaw_deg=12.0), "unit "),
    "another pitch, everywhere": (everywhere(pitch_deg=-21.0), "unit "),
    "higher, everywhere": (everywhere(z_m=7.0), "unit "),
    "another site, everywhere": (everywhere(site="mast-n"), "unit "),
    "another latency, everywhere": (everywhere(latency_s=0.5), "unit "),
    "another camera, everywhere": (everywhere(camera="varifocal-1080p"), "unit "),
    # The certificate.
    "a row of equal value": (row_of_equal_value, "unit "),
    "another row": (certificate(lambda d: d["layout"][0].update(row=0)), "pose names"),
    "another name of a pose": (
        certificate(lambda d: d["layout"][0].update(pose="a")),
        "pose names",
    ),
    "a better value": (
        both(lambda d: d["stages"][2].update(objective=9.0)),
        "smallest_margin_s",
    ),
    "a lower bound": (
        both(lambda d: d["stages"][3].update(bound=0.1)),
        "mean_margin_s: bound",
    ),
    "another gap": (
        both(lambda d: d["stages"][3].update(gap=0.5)),
        "mean_margin_s: gap",
    ),
    "not proven": (
        certificate(lambda d: d["stages"][3].update(is_proven=False)),
        "mean_margin_s",
    ),
    "proof incomplete": (certificate(lambda d: d.update(is_proven=False)), "proof"),
    "a stage less": (both(lambda d: d["stages"].pop()), "stages"),
    "another solver": (
        certificate(lambda d: d.update(solver="x")),
        "summary.json: solver",
    ),
    "another version": (
        certificate(lambda d: d["versions"].update(numpy="9")),
        "summary.json: v",
    ),
    "seconds of a stage": (
        certificate(lambda d: d["stages"][0].update(seconds=9.9)),
        "summary",
    ),
    "seconds of a step": (
        certificate(lambda d: d["seconds"].update(optimise=9.9)),
        "?and seconds",
    ),
    "other words": (
        certificate(lambda d: d["model"]["in_words"].update(apr="x")),
        "model in",
    ),
    "another budget": (
        certificate(lambda d: d["model"]["limits"].update(budget_units=9)),
        "model",
    ),
    "another rule": (
        certificate(lambda d: d["model"]["rule"].update(latency_s=9.0)),
        "model",
    ),
    "another goal": (certificate(lambda d: d["model"].update(goal="fewest")), "model"),
    "more poses before presolve": (
        certificate(lambda d: d["presolve"].update(n_poses=[9999, 1])),
        "presolve",
    ),
    "fewer poses after presolve": (
        certificate(lambda d: d["presolve"]["n_poses"].__setitem__(1, 1)),
        "summary.json: presolve",
    ),
    "another size of the instance": (
        certificate(lambda d: d["instance"].update(n_runs=9)),
        "instance sizes",
    ),
    "another hash": (
        certificate(lambda d: d["instance"].update(sha256="0" * 64)),
        "instance",
    ),
    "another solver, twice": (
        both(lambda d: d.update(solver="x")),
        "?solver, presolved sizes",
    ),
    "other versions, twice": (
        both(lambda d: d["versions"].update(numpy="9")),
        "?versions of programs",
    ),
    # The instance, with its hash in the certificate.
    "a pose that looks elsewhere": (mounts(yaw_deg=at_row(12.0)), "poses and names"),
    "a pose that hangs elsewhere": (
        mounts(position_m=lambda m, row: at(row, m[row] + [1.0, 0.0, 0.0])(m)),
        "poses and names",
    ),
    "all poses of a site elsewhere": (
        mounts(
            position_m=lambda m, row: m + [30.0, 0.0, 0.0],
        ),
        "scene as it stands",
    ),
    "another sensor": (
        mounts(sensors=lambda m, row: (replace(m[0], width_px=3840), *m[1:])),
        "unit ",
    ),
    "another price of a sensor": (
        mounts(sensors=lambda m, row: (replace(m[0], price_eur=1.0), *m[1:])),
        "prices of sensors",
    ),
    "another scene's hash": (
        mounts(scene_sha256=lambda m, row: "0" * 64),
        "scene as it stands",
    ),
    "another scene's name": (mounts(scene_name=lambda m, row: "elsewhere"), "scene"),
    "poses of another site": (
        limits(site_index=lambda m, row: at(row, (m[row] + 1) % (m.max() + 1))(m)),
        "poses and sites",
    ),
    "another price": (limits(unit_cost_eur=at_row(1.0)), "prices of sensors"),
    "other weights": (
        axis(
            weight=lambda w: (
                np.arange(1.0, len(w) + 1.0) / np.arange(1.0, len(w) + 1.0).sum()
            )
        ),
        "runs.parquet",
    ),
    "another last brake time": (axis(last_brake_time_s=at(0, -9.0)), "runs.parquet"),
    "another speed": (axis(vut_speed_kmh=at(0, 9.0)), "runs.parquet"),
    "a bit of the table": (
        instance(another_bit),
        "?whether the detection table is right",
    ),
    # The summary.
    "another APR": (summary(lambda d: d.update(apr=0.5)), "summary.json: apr"),
    "another ratio": (
        summary(lambda d: d["evaluation"]["rsu_all"].update(all=0.5)),
        "summary.json: ratios",
    ),
    "another ratio of the baseline": (
        summary(lambda d: d["baseline"]["evaluation"]["rsu_all"].update(all=0.0)),
        "summary.json: ratios",
    ),
    "another ratio at a position": (
        summary(lambda d: d["evaluation"]["vut"]["by_position"].update({"0": 0.123})),
        "summary.json: ratios",
    ),
    "more candidates": (
        summary(lambda d: d.update(candidates=9)),
        "summary.json: candidates",
    ),
    "another budget, in the summary": (
        summary(lambda d: d.update(budget=9)),
        "summary.json: b",
    ),
    "money spent": (
        summary(lambda d: d.update(spent_eur=1.0)),
        "summary.json: spent_eur",
    ),
    "what explains it": (
        summary(lambda d: d["explained"].update(runs_without_weight=7)),
        "?explained",
    ),
    "no summary": (missing("summary.json"), "tables"),
    # Tables.
    "a ratio": (replaced("apr.csv", ",1.0,", ",0.5,"), "apr.csv"),
    "a row of ratios less": (without_row_of("apr.csv"), "tables"),
    "no ratios": (missing("apr.csv"), "tables"),
    "an outcome": (
        runs(lambda t: t.__setitem__("is_avoided", ~t["is_avoided"])),
        "apr.csv",
    ),
    "weights of runs": (runs(lambda t: t.__setitem__("weight", 1.0)), "runs.parquet"),
    "no runs": (missing("runs.parquet"), "tables"),
    "outcomes and all that follows": (all_of_one, "?outcomes in runs.parquet"),
    # The layout in other formats, and what people read.
    "layout.csv": (replaced("layout.csv", "-20", "-21"), "layout.csv"),
    "layout.geojson": (replaced("layout.geojson", "-20", "-21"), "layout.geojson"),
    "no layout.csv": (missing("layout.csv"), "?layout.csv: not there"),
    "bill of materials": (
        appended("bill_of_materials.csv", "x\n"),
        "?bill_of_materials.csv",
    ),
    "report.html": (appended("report.html", "<p>x"), "?report.html"),
    "no report.html": (missing("report.html"), "?report.html: not there"),
    "another file": (
        lambda folder: (folder / "a.txt").write_text("x") and None,
        "?what a.txt",
    ),
}


# What the files agree about, so that ``verify`` alone cannot know: how the name of a
# check of ``--deep`` begins that must fail.
DEEP = {
    "all runs avoided, everywhere": (all_of_all, "anew: runs.parquet"),
    "outcomes and all that follows": (all_of_one, "anew: runs.parquet"),
    "margins": (runs(lambda t: t.__setitem__("margin_s", 9.0)), "anew: runs.parquet"),
    "when a run is confirmed": (
        runs(lambda t: t.__setitem__("confirmation_time_s", 0.1)),
        "anew: runs.parquet",
    ),
    "how much is detected": (
        runs(lambda t: t.__setitem__("detected_share", 1.0)),
        "anew: runs.parquet",
    ),
    "impact speeds": (
        runs(lambda t: t.__setitem__("impact_speed_kmh", 1.0)),
        "anew: runs.parquet",
    ),
    # The instance.
    "a bit of a pose that is not used": (
        instance(another_bit),
        "anew: certificate.json",
    ),
    "another solver, twice": (
        both(lambda d: d.update(solver="x")),
        "anew: certificate.json",
    ),
    # The bill.
    "a price in the bill": (
        replaced("bill_of_materials.csv", "1500", "1"),
        "anew: bill",
    ),
    "a line of the bill less": (without_row_of("bill_of_materials.csv"), "anew: bill"),
    "a line of the bill more": (appended("bill_of_materials.csv", "x\n"), "anew: bill"),
    "no bill": (missing("bill_of_materials.csv"), "anew: bill"),
    "costs of sites": (
        summary(lambda d: d.update(sites_eur=1.0)),
        "anew: summary.json",
    ),
    "costs of sites that are assumed": (
        summary(lambda d: d.update(assumed_prices=["none"])),
        "anew: summary.json",
    ),
    # Numbers of the summary that no other file has.
    "a highest APR": (summary(highest), "anew: summary.json"),
    "errors of mounting": (
        summary(lambda d: d.update(mounting=None)),
        "anew: summary.json",
    ),
    "the next unit": (
        summary(lambda d: d.update(next_unit=None)),
        "anew: summary.json",
    ),
    "random layouts": (
        summary(lambda d: d["baselines"].update(random=None)),
        "anew: summary.json",
    ),
    "an expert's layout": (
        summary(lambda d: d["baselines"].update(expert=None)),
        "anew: summary.json",
    ),
    "smaller layouts": (summary(lambda d: d.update(front=None)), "anew: summary.json"),
    "what explains it": (
        summary(lambda d: d["explained"].update(runs_without_weight=7)),
        "anew: summary.json",
    ),
    "by road user": (
        summary(lambda d: d.update(road_users=None)),
        "anew: summary.json",
    ),
    "how many disagree": (
        summary(lambda d: d.update(surrogate_disagreement=0.9)),
        "anew: summary.json",
    ),
    "what is left out": (
        summary(lambda d: d.update(driven=["everything"])),
        "anew: summary.json",
    ),
    "another detector": (
        summary(lambda d: d.update(detector="x")),
        "anew: summary.json",
    ),
    "another weather": (
        summary(lambda d: d.update(weathers=["fog"])),
        "anew: summary.json",
    ),
    # What people read.
    "a word in the report": (appended("report.html", "<p>x"), "anew: report.html"),
    "a number in the report": (
        replaced("report.html", " %", "9 %"),
        "anew: report.html",
    ),
    "a picture in the report": (another_picture, "anew: report.html"),
    "no report": (missing("report.html"), "anew: report.html"),
    "an empty report": (
        lambda folder: (folder / "report.html").write_text("") and None,
        "anew: report.html",
    ),
    "another plan": (flipped("plan.png"), "anew: plan.png"),
    "no plan": (missing("plan.png"), "anew: plan.png"),
    "no layout.csv": (missing("layout.csv"), "anew: layout.csv"),
    "no layout.geojson": (missing("layout.geojson"), "anew: layout.geojson"),
    "another file": (
        lambda folder: (folder / "a.txt").write_text("x") and None,
        "anew: a.txt",
    ),
    "a recommendation": (
        lambda folder: (
            shutil.copy(folder / "layout.json", folder / "recommended.json") and None
        ),
        "anew: recommended.json",
    ),
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
        lambda folder: (folder / "instance.npz").write_bytes(b"PK") and None,
        "instance.npz: got ",
    ),
    "no certificate": (
        missing("certificate.json"),
        "certificate.json: got No such file",
    ),
    "no instance": (missing("instance.npz"), "instance.npz: got No such file"),
    "no layout": (missing("layout.json"), "layout.json: got No such file"),
}


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


@pytest.mark.parametrize("name", DEEP)
def test_what_the_files_agree_about_is_found_when_it_is_made_anew(results, deep, name):
    change, expected = DEEP[name]
    change(results)
    write_manifest(results)
    assert any(one.startswith(expected) for one in deeply_failed(results)), (
        deeply_failed(results)
    )


def test_what_nobody_has_changed_is_the_same_when_it_is_made_anew(results, deep):
    found = verified_deeply(results)
    assert failed(found) == []
    assert found.is_verified
    left = " ".join(found.not_checked)
    assert "report.html" not in left
    assert "runs.parquet" not in left
    assert "seconds, versions of programs" in left


@pytest.mark.parametrize("name", ["report.html", "runs.parquet", "certificate.json"])
def test_without_new_hashes_whatever_is_changed_is_found_by_its_hash(results, name):
    if name != "certificate.json":
        change = flipped(name)
    else:
        change = appended(name, "\n")
    change(results)
    assert f"file {name}" in failed(verified(results))


@pytest.mark.long
@pytest.mark.parametrize("name", [*DEEP, *(name for name in FOUND if name not in DEEP)])
def test_without_new_hashes_every_change_is_found(results, name):
    change, _ = DEEP.get(name) or FOUND[name]
    change(results)
    try:
        found = verified(results)
    except InputError:
        return
    assert any(one.startswith("file ") for one in failed(found))


@pytest.mark.long
@pytest.mark.parametrize("name", DEEP)
def test_verify_alone_names_what_only_deep_finds(results, deep, name):
    change, expected = DEEP[name]
    change(results)
    write_manifest(results)
    found = verified_deeply(results)
    assert not found.is_verified
    assert any(one.startswith(expected) for one in failed(found))


def test_every_value_of_a_summary_is_compared_with_the_one_made_anew(written):
    """Whatever is changed differs; times and versions do not count, what was asked is
    used.
    """
    document = json.loads((written / "summary.json").read_text())
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


def changes():
    """Quickly, one change for each check that finds it; the others are long."""
    told = set()
    for name, (_, expected) in FOUND.items():
        yield pytest.param(name, marks=[pytest.mark.long] if expected in told else [])
        told.add(expected)


@pytest.mark.parametrize("name", list(changes()))
def test_what_was_changed_is_found_or_named(results, name):
    change, expected = FOUND[name]
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
    "name", ["report.html", "bill_of_materials.csv", "layout.geojson"]
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
    save_scene(
        tmp_path / "scene", load_study_scene()
    )  # rounded to millimetres: another one
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
        patch.setattr(
            evaluation, "begin_job", partial(_begin_small_job, build_small_setting())
        )
        evaluation.run_comparison(
            Question(),
            layouts=layouts,
            out=folder,
            compute=Compute(workers=2),
            command="place-rsus",
            progress=StageProgress(),
        )
    return folder


def _begin_small_job(setting, *given, **options):
    return placement.begin_job(*given, setting=setting, **options)


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
