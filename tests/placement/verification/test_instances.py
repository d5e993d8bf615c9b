"""Whole problems as files, and their hash."""

from dataclasses import fields, replace

import numpy as np
import pytest
from changes import changed
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from numpy.testing import assert_array_equal
from problems import questions

from geometry.errors import InputError
from placement.detection_table import DetectionTable
from placement.optimiser import Floor, Limits, PlacementProblem
from placement.proof_files import problem_hash, save_problem
from placement.verification.instances import load_problem
from scenarios.aeb import AebRule

SHARED_FOLDER = settings(suppress_health_check=[HealthCheck.function_scoped_fixture])


@pytest.fixture
def problem(frame_axis):
    """Three runs, three poses on two sites, everything that can be asked at once."""
    rng = np.random.default_rng(1)
    drawn = rng.random((3, 10))
    bits = drawn < 0.6
    packed = np.packbits(bits, axis=1, bitorder="little")
    return PlacementProblem(
        table=DetectionTable(pose_ids=("a", "b", "c"), axis=frame_axis, packed=packed),
        limits=Limits(
            site_index=[0, 1, 1],
            site_capacity=[1, 2],
            budget_units=2,
            budget_eur=9000.0,
            unit_cost_eur=[1000.0, 2000.0, 3000.0],
            site_cost_eur=[500.0, 0.0],
            is_forced=[True, False, False],
            is_forbidden=[False, True, False],
            is_forced_site=[False, True],
            rivals=np.zeros((0, 2), dtype=np.int64),
        ),
        fusion="any",
        rule=AebRule(
            deceleration_mps2=7.72,
            latency_s=0.025,
            n_confirmations=1,
            frame_rate_hz=10.0,
        ),
        floors=(
            Floor(name="--target", share=0.5),
            Floor(
                name="--min-case-apr in A",
                share=0.25,
                is_counted=np.array([True, True, False]),
                n_failures=1,
            ),
        ),
        goal="fewest",
        survive=1,
        sample_index=np.array([0, 1, 0]),
        tail=0.5,
    )


def assert_same(one, other):
    """Compare everything that two problems are made of, bit by bit."""
    assert type(one) is type(other)

    if hasattr(one, "__dataclass_fields__"):
        for field in fields(one):
            assert_same(getattr(one, field.name), getattr(other, field.name))
    elif isinstance(one, np.ndarray):
        assert one.dtype == other.dtype
        assert_array_equal(one, other)
    elif isinstance(one, tuple) and one and hasattr(one[0], "__dataclass_fields__"):
        assert len(one) == len(other)
        for mine, theirs in zip(one, other, strict=True):
            assert_same(mine, theirs)
    else:
        assert one == other


@given(problem=questions())
@SHARED_FOLDER
def test_every_problem_comes_back_as_it_was(problem, tmp_path):
    floors = tuple(replace(floor, share=float(floor.share)) for floor in problem.floors)
    problem = replace(problem, floors=floors)
    path = tmp_path / "instance.npz"

    save_problem(path, problem)
    loaded = load_problem(path)
    entries = tmp_path.iterdir()
    names = [entry.name for entry in entries]

    assert_same(loaded, problem)
    assert problem_hash(loaded) == problem_hash(problem)
    assert names == ["instance.npz"]


def test_a_problem_with_every_wish_comes_back_and_makes_the_same_file(
    problem, tmp_path
):
    for name in ("one.npz", "two.npz"):
        save_problem(tmp_path / name, problem)

    expected = (tmp_path / "two.npz").read_bytes()

    assert_same(load_problem(tmp_path / "one.npz"), problem)
    assert (tmp_path / "one.npz").read_bytes() == expected


def _flipped(packed):
    """Bits of which one is another."""
    other = packed.copy()
    other[1, 0] ^= 4
    return other


def _with_other_frames(axis):
    """The axis with other frames."""
    return replace(axis, run_start=[0, 3, 7, 10], time_s=np.arange(10) / 10)


def _of_second_floor(**values):
    """Changes the second of some floors."""
    return lambda floors: (floors[0], replace(floors[1], **values))


VARIATIONS = (
    ("table.packed", _flipped),
    ("table.pose_ids", ("a", "b", "d")),
    ("table.pose_ids", ("a,b", "", "c")),  # names run together
    ("table.axis.run_ids", ("A/north/20", "A/north/30", "B/north/21")),
    ("table.axis.cases", ("A", "B", "B")),
    ("table.axis.approaches", ("north", "north", "east")),
    ("table.axis.positions", ("0", "0", "-15")),
    ("table.axis.weathers", ("day", "day", "fog")),
    ("table.axis.vut_speed_kmh", [20.0, 30.0, 21.0]),
    ("table.axis.weight", [0.25, 0.5, 0.25]),
    ("table.axis.last_brake_time_s", [-0.1, -0.1, -np.inf]),
    ("table.axis", _with_other_frames),
    ("table.axis.time_s", lambda time_s: time_s - 0.01),
    ("limits.site_index", [0, 0, 1]),
    ("limits.site_capacity", [1, 3]),
    ("limits.budget_units", 3),
    ("limits.budget_units", None),
    ("limits.budget_eur", 9001.0),
    ("limits.budget_eur", None),
    ("limits.unit_cost_eur", [1000.0, 2000.0, 3001.0]),
    ("limits.site_cost_eur", [500.0, 1.0]),
    ("limits.is_forced", [False] * 3),
    ("limits.is_forbidden", [False] * 3),
    ("limits.is_forced_site", [False] * 2),
    ("limits.rivals", [[0, 1]]),
    ("fusion", "single"),
    ("goal", "cheapest"),
    ("survive", 2),
    ("sample_index", np.array([0, 1, 1])),
    ("sample_index", None),
    ("tail", 0.25),
    ("floors", ()),
    ("floors.share", 0.75),
    ("floors", _of_second_floor(n_failures=2)),
    ("floors", _of_second_floor(is_counted=np.array([True, False, False]))),
    ("floors", _of_second_floor(is_counted=None)),
    ("rule.deceleration_mps2", 2),
    ("rule.build_up_s", 2),
    ("rule.latency_s", 2),
    ("rule.n_confirmations", 2),
    ("rule.frame_rate_hz", 2),
    ("rule.track_memory_s", 2),
)


def test_the_hash_changes_with_whatever_changes(problem):
    hashes = [problem_hash(changed(problem, *change)) for change in VARIATIONS]

    hashes.append(problem_hash(problem))
    distinct = len(set(hashes))

    assert distinct == len(hashes)
    for text in hashes:
        assert len(text) == 64


def test_files_without_positions_have_all_runs_at_zero_and_others_come_back(
    problem, tmp_path
):
    path = tmp_path / "a.npz"
    axis = problem.table.axis
    save_problem(path, problem)

    with np.load(path) as archive:
        assert "positions" not in archive.files  # as before there were any

    assert load_problem(path).table.axis.positions == ("0", "0", "0")

    moved = replace(axis, positions=("-15", "0", "+0"))
    there = changed(problem, "table.axis", moved)

    save_problem(path, there)

    assert_same(load_problem(path), there)

    positions = np.array(["-15", "0", "far"])
    rewrite(path, there, positions=positions)

    with pytest.raises(
        InputError, match=r"a\.npz: positions: got 'far'; expected 0, or metres"
    ):
        load_problem(path)

    rewrite(path, there, positions=np.array(["-15", "0"]))

    with pytest.raises(InputError, match=r"a\.npz: positions: got "):
        load_problem(path)


def test_tracks_that_live_for_ever_make_the_files_of_programs_without_a_memory(
    problem, tmp_path
):
    for memory_s, is_there in (
        (np.inf, False),
        (1.0, True),
    ):
        rule = replace(problem.rule, track_memory_s=memory_s)
        remembering = replace(problem, rule=rule)
        save_problem(tmp_path / "a.npz", remembering)

        with np.load(tmp_path / "a.npz") as archive:
            assert ("track_memory_s" in archive.files) == is_there

        loaded = load_problem(tmp_path / "a.npz")

        assert loaded.rule.track_memory_s == memory_s


def test_bits_behind_the_last_frame_and_the_sign_of_zero_mean_nothing(
    problem, tmp_path
):
    packed = problem.table.packed.copy()
    packed[:, -1] |= 0b11111100  # ten frames
    zeros = -1.0 * -problem.table.axis.time_s
    axis = replace(problem.table.axis, time_s=zeros)
    limits = replace(problem.limits, site_cost_eur=[500.0, -0.0])
    table = replace(problem.table, axis=axis, packed=packed)
    same = replace(problem, table=table, limits=limits)

    assert problem_hash(same) == problem_hash(problem)

    save_problem(tmp_path / "a.npz", same)
    loaded = load_problem(tmp_path / "a.npz")
    found = problem_hash(loaded)

    assert found == problem_hash(problem)


def test_a_name_that_numpy_would_cut_is_refused(problem, tmp_path):
    table = replace(problem.table, pose_ids=("a", "b", "c\0"))
    long_named = replace(problem, table=table)

    with pytest.raises(
        InputError, match=r"pose_ids: got .*; expected names without a null"
    ):
        save_problem(tmp_path / "a.npz", long_named)

    assert list(tmp_path.iterdir()) == []


# Bad files


def rewrite(path, problem, **changes):
    """The problem's file with some arrays replaced, added, or removed (...)."""
    save_problem(path, problem)
    with np.load(path) as archive:
        arrays_there = {name: archive[name] for name in archive.files}
        arrays = arrays_there | changes
    np.savez(
        path, **{name: array for name, array in arrays.items() if array is not ...}
    )


OPTIONAL = ("budget_units", "budget_eur", "sample_index", "track_memory_s")


@pytest.mark.long
def test_every_field_that_is_missing_is_named(problem, tmp_path):
    path = tmp_path / "a.npz"
    save_problem(path, problem)
    with np.load(path) as archive:
        names = set(archive.files)

    for name in names - set(OPTIONAL):
        rewrite(path, problem, **{name: ...})
        with pytest.raises(InputError, match=rf"a\.npz: {name}: got nothing; expected"):
            load_problem(path)


def test_what_may_be_missing_is_none(problem, tmp_path):
    path = tmp_path / "a.npz"
    missing = dict.fromkeys(OPTIONAL, ...)
    rewrite(path, problem, **missing)
    limits = replace(problem.limits, budget_units=None, budget_eur=None)
    bare = replace(problem, limits=limits, sample_index=None)
    loaded = problem_hash(load_problem(path))

    assert loaded == problem_hash(bare)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"kind": np.array("place-rsus/covering/1")},
            "kind: got 'place-rsus/covering/1'",
        ),
        ({"kind": np.array(["x"])}, "kind: got no text"),
        ({"more": np.zeros(3)}, "more: got a field; expected none of this name"),
        (
            {"site_index": np.array([0.0, 1.0, 1.0])},
            "site_index: got type float64; expected int64",
        ),
        (
            {"weight": np.array([[0.5, 0.25, 0.25]])},
            r"weight: got 2 axes; expected 1 \(runs\)",
        ),
        (
            {"weight": np.array([0.5, 0.5])},
            r"weight: got shape \(2,\); expected 3 runs",
        ),
        (
            {"pose_ids": np.array(["a", "b"])},
            r"packed: got shape \(3, 2\); expected 2 poses",
        ),
        (
            {"packed": np.zeros((3, 1), np.uint8)},
            r"packed: got shape \(3, 1\); expected shape",
        ),
        (
            {"packed": np.full((3, 2), 255, np.uint8)},
            "packed: got bits behind the last frame",
        ),
        ({"pose_ids": np.array(["a", "b", "a"])}, "pose_ids: got an id twice"),
        ({"rivals": np.array([[0, 5]])}, "rivals: got"),
        (
            {"floor_shares": np.zeros(1)},
            r"floor_shares: got shape \(1,\); expected 2 floors",
        ),
        ({"weight": np.array([0.5, 0.5, 0.5])}, "weight: got .*; expected shares >= 0"),
        (
            {"weight": np.array([0.5, np.nan, 0.5])},
            "weight: got .*; expected finite numbers",
        ),
        ({"time_s": np.full(10, np.inf)}, "time_s: got .*; expected finite numbers"),
        ({"last_brake_time_s": np.full(3, np.inf)}, "last_brake_time_s: got inf"),
        ({"run_start": np.array([0, 3, 2, 10])}, "run_start: got"),
        ({"run_start": np.array([0, 3, 8, 11])}, "time_s: got 10 frames; expected 11"),
        (
            {"site_index": np.array([0, 1, 2])},
            r"site_index: got \[0, 1, 2\]; expected sites 0..1",
        ),
        (
            {"fusion": np.array("both")},
            "fusion: got 'both'; expected one of any, single",
        ),
        ({"goal": np.array("most")}, "goal: got 'most'"),
        ({"tail": np.array(0.0)}, "tail: got 0.0"),
        (
            {"sample_index": np.array([0, 5, 0])},
            "sample_index: got a sample without weight",
        ),
        ({"latency_s": np.array(np.nan)}, "aeb.latency_s: got nan"),
        ({"n_confirmations": np.array(0)}, "aeb.n_confirmations: got 0"),
    ],
)
def test_a_value_that_cannot_be_is_named(problem, tmp_path, changes, message):
    path = tmp_path / "a.npz"
    rewrite(path, problem, **changes)

    with pytest.raises(InputError, match=rf"a\.npz: {message}"):
        load_problem(path)


def test_objects_are_never_loaded(problem, tmp_path):
    path = tmp_path / "a.npz"
    pose_ids = np.array(["a", None, "c"], dtype=object)
    rewrite(path, problem, pose_ids=pose_ids)

    with pytest.raises(
        InputError, match=r"a\.npz: pose_ids: got Object arrays cannot be loaded"
    ):
        load_problem(path)


def test_a_file_that_is_no_instance_is_refused(tmp_path):
    load = load_problem
    path = tmp_path / "a.npz"

    with pytest.raises(
        InputError, match=r"a\.npz: got No such file .*; expected a readable"
    ):
        load(path)

    with pytest.raises(InputError, match="got Is a directory; expected a readable"):
        load(tmp_path)

    for content in (b"", b"PK\3\4", b"4 5\n1 1 1 1 1\n"):
        path.write_bytes(content)
        with pytest.raises(
            InputError, match=r"a\.npz: got .*; expected an undamaged instance"
        ):
            load(path)

    with path.open("wb") as file:
        zeros = np.zeros(3)
        np.save(file, zeros)

    with pytest.raises(
        InputError, match="got File is not a zip file; expected an undamaged"
    ):
        load(path)

    zeros = np.zeros(3)
    np.savez(path, rows=zeros)

    with pytest.raises(
        InputError, match=r"a\.npz: kind: got nothing; expected a text such as"
    ):
        load(path)


@given(where=st.floats(0.0, 1.0, exclude_max=True), flip=st.integers(1, 255))
@SHARED_FOLDER
def test_a_damaged_byte_is_never_taken_for_data(problem, tmp_path, where, flip):
    path = tmp_path / "a.npz"
    save_problem(path, problem)
    content = bytearray(path.read_bytes())
    content[int(where * len(content))] ^= flip
    path.write_bytes(content)
    try:
        loaded = load_problem(path)
    except InputError:
        pass
    else:  # a date, or something else that is not data
        assert problem_hash(loaded) == problem_hash(problem)
