"""Units of a recording, chosen and evaluated: against all choices."""

import shutil
from functools import cache
from itertools import combinations
from pathlib import Path

import msgspec
import numpy as np
import pytest
from json_files import read_json, write_json
from oracles import naive_confirmed

from experiments.cli.recording import recording_text
from experiments.jobs.verify import run_verification
from experiments.parts import recording as part
from experiments.parts.recording import RecordedResult, run_recording
from experiments.progress import StageProgress
from experiments.results.record import to_plain
from geometry.errors import InputError
from placement.question import Question
from placement.recordings import WrittenDrive, write_recording
from scenarios.aeb import load_aeb_rule

BOX = np.array([100.0, 200.0, 140.0, 300.0])
N_UNITS = 6
N_DRIVES = 5
N_FRAMES = 14
SPEEDS_MPS = (6.0, 7.0, 8.0, 9.0, 10.0)


def _write(folder, detected):
    """Pedestrians that cross; detected: (n_units + 1, n_drives, n_frames), the car
    comes last.
    """
    names = [str(unit) for unit in range(len(detected) - 1)] + ["car"]
    seen = dict(zip(names, detected, strict=True))
    labels_px = dict.fromkeys(names, np.tile(BOX, (N_FRAMES, 1)))
    ahead_s = np.arange(N_FRAMES)[::-1] / 10.0
    drives = []
    for index, speed_mps in enumerate(SPEEDS_MPS):
        found_px = {name: rows[index][:, None] * BOX for name, rows in seen.items()}
        drive = WrittenDrive(
            scenario=index % 2,
            vru_class="pedestrian",
            vut_speed_mps=speed_mps,
            vru_speed_mps=1.5,
            distance_m=2.0 + speed_mps * ahead_s,
            labels_px=labels_px,
            detections_px=found_px,
            label_distance_m=dict.fromkeys(names, np.full(N_FRAMES, 20.0)),
        )
        drives.append(drive)
    write_recording(folder, drives)
    # Drives are read scenario by scenario.
    order = sorted(range(N_DRIVES), key=lambda index: index % 2)
    return detected[:, order], np.array(SPEEDS_MPS)[order]


def _random(seed, share):
    """Detections by lot, (n_units + 1, n_drives, n_frames)."""
    return np.random.default_rng(seed).random((N_UNITS + 1, N_DRIVES, N_FRAMES)) < share


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """Folder of a recording, what is detected in it, and speeds: thousands of files,
    made once.
    """

    @cache
    def make(seed=1, share=0.4):
        folder = tmp_path_factory.mktemp("recorded") / "data"
        return folder, *_write(folder, _random(seed, share))

    return make


@pytest.fixture(scope="module", autouse=True)
def _read_once():
    """What was read is not read again: nothing is changed after that."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(part, "read_recording", cache(part.read_recording))
        yield


def _with_own(folder, name, to):
    """A recording again, one of whose folders may be changed; the others are links."""
    to.mkdir()
    for path in folder.iterdir():
        if path.name == name:
            shutil.copytree(path, to / name)
        else:
            (to / path.name).symlink_to(path)
    return to


def _in_time(frames, speed_mps):
    """Whether a drive is avoided, frame by frame: a = 7.72 m/s^2, 25 ms, three in a
    row.
    """
    for index, confirmed in enumerate(naive_confirmed(frames, 3)):
        if confirmed:
            return (index - N_FRAMES + 1) / 10.0 + 0.025 <= -speed_mps / (2.0 * 7.72)
    return False


def _avoided(detected, speeds_mps, units, fusion):
    """Drives that some units avoid, by the definition."""
    if fusion == "any":
        if units:
            rows = [detected[list(units)].any(axis=0)]
        else:
            rows = []
    else:
        rows = list(detected[list(units)])
    return [
        any(_in_time(frames[index], speed) for frames in rows)
        for index, speed in enumerate(speeds_mps)
    ]


def _place(folder, budget=2, fusion="any", **options):
    """Plain summary of a choice among the units of a recording."""
    question = Question(budget=budget, fusion=fusion, time_limit_s=60.0)
    return _evaluate(folder, question, chooses=True, **options)


def _evaluate(folder, question=Question(), **options):  # noqa: B008 - frozen
    """Plain summary of a recording; of a choice among its units if it `chooses`."""
    given = {"min_confidence": 0.0, "out": None, "progress": StageProgress()}
    return to_plain(run_recording(question, folder=folder, **(given | options)))


def _text(summary, folder=None):
    """What the terminal says of a plain summary."""
    return recording_text(msgspec.convert(summary, RecordedResult), folder)


@pytest.mark.long
@pytest.mark.parametrize("fusion", ["any", "single"])
@pytest.mark.parametrize(
    ("seed", "share"),
    [
        (1, 0.4),
        (2, 0.5),
        (3, 0.6),
    ],
)
def test_no_other_choice_of_units_prevents_more(recorded, fusion, seed, share):
    folder, detected, speeds = recorded(seed, share)

    def apr(units, fusion=fusion):
        return np.mean(_avoided(detected, speeds, units, fusion))

    def without_worst(units):
        return min(apr([unit for unit in units if unit != failed]) for failed in units)

    for budget in (1, 2, 3, N_UNITS):
        summary = _place(folder, budget, fusion)
        chosen = [int(unit["folder"]) for unit in summary["layout"]]
        aprs = {units: apr(units) for units in combinations(range(N_UNITS), budget)}
        best = pytest.approx(max(aprs.values()))

        assert summary["apr"] == best
        # What adds nothing is left out.
        assert len(chosen) <= budget
        assert apr(chosen) == best
        assert summary["bound"] == best
        assert summary["gap"] == 0.0

        # Among the best ones, none loses less when one unit fails.
        equal = [units for units, value in aprs.items() if value == best]
        left = max(without_worst(units) for units in equal)
        if max(aprs.values()) > 0.0:
            assert summary["apr_without_worst_unit"] == pytest.approx(left)

        everything = apr(range(N_UNITS), "any")
        assert summary["baseline"]["rsu_all"]["all"] == pytest.approx(everything)
        assert [stage["name"] for stage in summary["stages"]] == [
            "apr",
            "apr_one_failed",
            "smallest_margin_s",
            "mean_margin_s",
            "cost_eur",
        ]


@pytest.mark.long
def test_drives_frames_and_what_was_skipped_are_told(recorded, tmp_path):
    _with_own(recorded()[0], "WorldData", tmp_path / "data")
    (tmp_path / "data/WorldData/0_3.txt").unlink()
    summary = _evaluate(tmp_path / "data")

    assert summary["frames"] == {
        "recorded": N_DRIVES * (N_FRAMES + 30) - 1,
        "in_drives": N_DRIVES * N_FRAMES,
        "missing_in_drives": 1,
        "several_vrus_in_view": 0,
    }
    assert summary["skipped"] == {
        "frames without WorldData": 1,
        "frames between drives (bodies back at their starts)": 150,
    }
    assert summary["runs"] == 5
    assert summary["weathers"] == ["recorded"]

    first = summary["drives"][0]
    expected = {
        "run": "recording/0/22",
        "case": "scenario-0-pedestrian",
        "motion": "crossing",
        "first_frame": 0,
        "frames": N_FRAMES,
        "missing_frames": 1,
        "last_brake_time_s": pytest.approx(-6.0 / 15.44),
        "closing_speed_mps": pytest.approx(6.0),
    }
    assert first | expected == first


@pytest.mark.long
def test_nothing_is_written_unless_asked_for_and_then_little(
    recorded, tmp_path, monkeypatch
):
    (tmp_path / "data").symlink_to(recorded()[0])
    monkeypatch.chdir(tmp_path)
    _evaluate(Path("data"))
    _place(Path("data"))

    assert [path.name for path in tmp_path.iterdir()] == ["data"]

    for run in (_evaluate, _place):
        progress = StageProgress()
        summary = run(Path("data"), out=Path("out"), progress=progress)
        names = {path.name for path in Path("out").iterdir()}
        if run is _place:
            proof = {"certificate.json", "instance.npz"}
        else:
            proof = set()

        assert names == {"summary.json", "SHA256SUMS"} | proof
        assert read_json(Path("out/summary.json")) == summary
        assert progress.kept == "the results are in out"
    assert "Written to out: summary.json." in _text(summary, Path("out"))


def test_a_folder_with_other_things_is_not_replaced(recorded):
    folder, *_ = recorded()
    with pytest.raises(
        InputError, match=r"--out: got .*data, which holds 0/.* but no SHA256SUMS"
    ):
        _evaluate(folder, out=folder)
    assert (folder / "Eval/0_0.txt").exists()


@pytest.mark.long
def test_tables_fit_80_columns_and_show_every_party(recorded):
    folder, *_ = recorded()
    evaluation = _text(_evaluate(folder))
    placement = _text(_place(folder))

    for text in (evaluation, placement):
        assert max(map(len, text.splitlines()[1:])) <= 80

    names = [f"RSU{unit}" for unit in range(N_UNITS)]
    names += ["RSU_all", "car", "car + RSU_all"]
    rows = [line[2:18].strip() for line in evaluation.splitlines()]

    assert [row for row in rows if row in names] == names
    assert (
        "Skipped: 150 frames between drives (bodies back at their starts)."
        in evaluation
    )
    assert (
        "12 (where no unit has that number) and -1 also mean car"
        in evaluation.replace("\n", " ")
    )
    assert "proven" in placement
    # What the numbers of this file stand on.
    assert load_aeb_rule().deceleration_mps2 == 7.72


@pytest.mark.long
def test_a_recorded_choice_has_a_certificate_that_holds(recorded, tmp_path):
    out = tmp_path / "out"
    summary = _place(recorded(3, 0.6)[0], out=out)
    assert run_verification(out, progress=StageProgress()).is_verified

    summary["layout"][0]["folder"] = "another"
    write_json((out / "summary.json"), summary)
    assert not run_verification(out, progress=StageProgress()).is_verified

    (out / "summary.json").write_text("[]")
    with pytest.raises(
        InputError, match=r"summary\.json: got no object; expected a summary"
    ):
        run_verification(out, progress=StageProgress())
