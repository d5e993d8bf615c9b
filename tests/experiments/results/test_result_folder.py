"""Folders of results: replaced as a whole or not at all, and only if they are ours."""

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from experiments.progress import Interrupted, StageProgress, ending_on_signals
from experiments.results import folders as result_folder
from experiments.results.folders import (
    MANIFEST,
    MARKER,
    changed_files,
    check_result_folder,
    new_result_folder,
    read_manifest,
)
from geometry.errors import InputError
from geometry.locks import lock_while_alive


def fill(folder: Path, text: str = "new") -> None:
    """Write results into a folder."""
    with new_result_folder(folder) as new:
        (new / "report.html").write_text(text)
        (new / MARKER).write_text("{}")


WHOLE = [MANIFEST, "report.html", MARKER]
"""Names of what is in a folder with results."""


def names(folder: Path) -> list[str]:
    """Names of what is in a folder."""
    return sorted(os.listdir(folder))  # noqa: PTH208 - names are wanted


@pytest.fixture
def earlier(tmp_path):
    """A folder with earlier results."""
    folder = tmp_path / "latest"
    fill(folder, "old")
    return folder


def test_a_new_folder_is_made_with_its_parents(tmp_path):
    folder = tmp_path / "a/b"
    check_result_folder(folder)
    assert names(tmp_path) == []  # a check leaves nothing

    fill(folder)
    assert names(folder) == WHOLE
    assert names(tmp_path / "a") == ["b"]


def test_an_empty_folder_is_filled(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    fill(folder)

    assert names(folder) == WHOLE


def test_results_are_as_readable_as_other_folders(tmp_path):
    folder = tmp_path / "out"
    other = tmp_path / "other"
    other.mkdir()
    fill(folder)

    assert folder.stat().st_mode == other.stat().st_mode


def test_half_of_an_earlier_result_is_replaced(earlier):
    (earlier / "report.html").unlink()
    fill(earlier)
    assert names(earlier) == WHOLE


def test_a_link_to_a_folder_stays_a_link(earlier):
    link = earlier.with_name("link")
    link.symlink_to(earlier)
    fill(link)

    assert link.is_symlink()
    assert (earlier / "report.html").read_text() == "new"
    assert names(earlier.parent) == ["latest", "link"]


def test_a_link_to_a_folder_that_does_not_exist_yet_is_followed(tmp_path):
    link = tmp_path / "link"
    link.symlink_to(tmp_path / "later")
    fill(link)

    assert names(tmp_path / "later") == WHOLE


def test_a_name_of_the_greatest_length_is_taken(tmp_path):
    fill(tmp_path / ("a" * 255))
    assert names(tmp_path) == ["a" * 255]


@pytest.mark.parametrize(
    "error", [OSError(28, "No space left on device"), KeyboardInterrupt()]
)
def test_a_failure_leaves_everything_as_it_was(earlier, error):
    def fail(folder: Path) -> None:
        with new_result_folder(folder) as new:
            (new / "report.html").write_text("half")
            raise error

    for folder in (earlier, earlier.parent / "a/b"):
        with pytest.raises(type(error)):
            fail(folder)
    assert (earlier / "report.html").read_text() == "old"
    assert names(earlier.parent) == ["latest"]


@pytest.mark.parametrize(
    "error", [OSError(28, "No space left on device"), ValueError("glyph")]
)
def test_an_answer_whose_report_cannot_be_written_is_kept(earlier, error):
    def fail() -> None:
        with new_result_folder(earlier) as new:
            (new / MARKER).write_text('{"apr": 1}')
            raise error

    if isinstance(error, OSError):
        expected = InputError
    else:
        expected = type(error)
    for name in ("latest.unfinished", "latest.unfinished-2"):
        with pytest.raises(expected) as caught:
            fail()

        said = [str(caught.value), *getattr(caught.value, "__notes__", ())][-1]
        assert said.endswith(f"what was computed is kept in {earlier.with_name(name)}")
        assert (earlier.with_name(name) / MARKER).read_text() == '{"apr": 1}'

    assert (earlier / "report.html").read_text() == "old"


def test_an_answer_that_the_user_interrupts_is_not_kept(earlier):
    def interrupt() -> None:
        with new_result_folder(earlier) as new:
            (new / MARKER).write_text("{}")
            raise Interrupted(signal.SIGINT)

    with pytest.raises(Interrupted):
        interrupt()
    assert names(earlier.parent) == ["latest"]


@pytest.fixture(params=[True, False], ids=["one step", "two steps"])
def exchange(request, monkeypatch):
    """With the system's exchange of two names, and where there is none."""
    if not request.param:
        monkeypatch.setattr(result_folder, "_exchange", lambda first, second: False)


@pytest.mark.usefixtures("exchange")
def test_earlier_results_are_replaced_either_way(earlier):
    fill(earlier)
    assert (earlier / "report.html").read_text() == "new"
    assert names(earlier.parent) == ["latest"]


def test_an_exchange_that_fails_puts_the_earlier_results_back(earlier, monkeypatch):
    rename = Path.rename

    def rename_once(path: Path, target: Path) -> Path:
        if path.suffix == ".tmp" and target == earlier:
            raise OSError(16, "Device or resource busy")
        return rename(path, target)

    monkeypatch.setattr(result_folder, "_exchange", lambda first, second: False)
    monkeypatch.setattr(Path, "rename", rename_once)

    with pytest.raises(InputError, match=r"busy; .* kept in .*latest\.unfinished"):
        fill(earlier)
    assert (earlier / "report.html").read_text() == "old"
    assert names(earlier.parent) == ["latest", "latest.unfinished"]


@pytest.mark.skipif(sys.platform != "linux", reason="exchanges folders in one step")
def test_two_folders_are_exchanged_in_one_step(tmp_path):
    for name in "ab":
        (tmp_path / name).mkdir()
        (tmp_path / name / name).touch()
    assert result_folder._exchange(tmp_path / "a", tmp_path / "b")
    assert names(tmp_path / "a") == ["b"]
    with pytest.raises(FileNotFoundError):
        result_folder._exchange(tmp_path / "a", tmp_path / "c")


@pytest.mark.usefixtures("exchange")
def test_a_signal_during_the_exchange_comes_too_late(earlier, monkeypatch):
    rename = Path.rename
    swap = result_folder._exchange

    def rename_interrupted(path: Path, target: Path) -> Path:
        signal.raise_signal(signal.SIGINT)
        return rename(path, target)

    def swap_interrupted(first: Path, second: Path) -> bool:
        signal.raise_signal(signal.SIGINT)
        return swap(first, second)

    monkeypatch.setattr(Path, "rename", rename_interrupted)
    monkeypatch.setattr(result_folder, "_exchange", swap_interrupted)
    with ending_on_signals(StageProgress()):
        fill(earlier)

    assert (earlier / "report.html").read_text() == "new"
    assert names(earlier.parent) == ["latest"]


def test_a_signal_during_the_check_leaves_nothing(tmp_path, monkeypatch):
    make = result_folder.tempfile.mkdtemp

    def make_interrupted(**options: object) -> str:
        signal.raise_signal(signal.SIGINT)
        return make(**options)

    monkeypatch.setattr(result_folder.tempfile, "mkdtemp", make_interrupted)

    with pytest.raises(Interrupted), ending_on_signals(StageProgress()):
        check_result_folder(tmp_path / "out")
    assert names(tmp_path) == []


def refusal(folder: Path) -> str:
    """Words in which a folder is refused."""
    with pytest.raises(InputError) as caught:
        check_result_folder(folder)
    return str(caught.value)


def test_a_file_is_no_folder(tmp_path):
    path = tmp_path / "file"
    path.write_text("mine")

    assert refusal(path) == f"--out: got '{path}'; expected a folder, not a file"
    assert (
        refusal(path / "below")
        == f"--out: got {path}/below: Not a directory; expected a folder that can be"
        " written to"
    )
    assert path.read_text() == "mine"


def test_a_folder_that_cannot_be_is_refused(tmp_path):
    long = tmp_path / ("a" * 256)
    expected = "expected a folder that can be written to"

    assert refusal(long) == f"--out: got {long}: File name too long; {expected}"
    assert refusal(long / "x") == f"--out: got {long}/x: File name too long; {expected}"
    assert refusal(Path("/proc/x/y")).startswith("--out: got /proc/x/y: ")


def test_a_circle_of_links_is_refused(tmp_path):
    link = tmp_path / "link"
    link.symlink_to(link)
    assert refusal(link).endswith("expected a folder that can be written to")


OURS_ONLY = (
    "expected a new or empty folder, or one with earlier results and nothing else"
)


@pytest.mark.parametrize("name", ["notes.txt", "layout.backup/old.json", "plot.png"])
def test_what_others_put_into_a_folder_is_never_replaced(earlier, name):
    path = earlier / name
    if name.endswith("/"):
        path.mkdir()
    else:
        path.parent.mkdir(exist_ok=True)
        path.write_text("mine")
    shown = name.rstrip("/")

    assert refusal(earlier) == f"--out: got {earlier}, which holds {shown}; {OURS_ONLY}"
    assert path.exists()


@pytest.mark.parametrize(
    "held", [("cat.png",), ("plot.png", "runs.parquet", "summary.json")]
)
def test_a_folder_of_somebody_else_is_refused(tmp_path, held):
    folder = tmp_path / "theirs"
    folder.mkdir()
    for name in held:
        (folder / name).write_text("mine")

    assert (
        refusal(folder)
        == f"--out: got {folder}, which holds {held[0]} but no {MANIFEST}; {OURS_ONLY}"
    )


def test_results_that_somebody_changed_are_not_replaced(earlier):
    (earlier / "report.html").write_text("old, with my notes")
    assert (
        refusal(earlier)
        == f"--out: got {earlier}, which holds report.html, changed since it was"
        f" written; {OURS_ONLY}"
    )


def test_what_file_managers_leave_does_not_count(earlier):
    (earlier / ".DS_Store").write_text("icons")
    fill(earlier)
    assert names(earlier) == WHOLE


def test_the_manifest_lists_every_file_with_its_hash(earlier):
    assert list(read_manifest(earlier)) == ["report.html", MARKER]
    assert changed_files(earlier) == {}

    checked = subprocess.run(
        ["sha256sum", "-c", MANIFEST], cwd=earlier, capture_output=True
    )
    assert checked.returncode == 0

    (earlier / "report.html").unlink()
    (earlier / MARKER).write_text("[]")
    (earlier / "more").mkdir()

    assert changed_files(earlier) == {
        "report.html": "missing",
        MARKER: "changed",
        "more": "not listed",
    }


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("abc", 1),
        (f"{'0' * 64} a\n", 1),
        (f"{'0' * 64}  a\n{'g' * 64}  b", 2),
    ],
)
def test_a_damaged_manifest_is_told(earlier, text, line):
    (earlier / MANIFEST).write_text(text)
    assert refusal(earlier).startswith(f"{earlier / MANIFEST}: line {line}: got ")


def test_a_name_that_is_no_text_is_refused_before_anything_is_computed(tmp_path):
    folder = Path(os.fsdecode(os.fsencode(tmp_path) + b"/out-\xff"))
    assert (
        refusal(folder)
        == f"--out: got '{tmp_path}/out-\\\\xff'; expected a name in UTF-8"
    )


def test_folders_of_a_killed_run_are_removed_by_the_next_but_not_of_one_that_is_alive(
    tmp_path,
):
    dead, alive, young = (
        tmp_path / f".place-rsus.{name}.tmp" for name in ("dead", "live", "new")
    )
    for path in (dead, alive, young):
        path.mkdir()
    for path in (dead, alive):
        os.utime(path, (0, 0))
    with lock_while_alive(alive):
        fill(tmp_path / "out")

    assert names(tmp_path) == [alive.name, young.name, "out"]


def test_files_of_others_that_came_meanwhile_are_kept(earlier):
    def fill_late() -> None:
        with new_result_folder(earlier):
            pass

    (earlier / "notes.txt").write_text("mine")

    with pytest.raises(InputError, match=r"notes\.txt"):
        fill_late()
    assert (earlier / "notes.txt").read_text() == "mine"


def test_the_current_folder_is_not_replaced(tmp_path, monkeypatch):
    (tmp_path / "inside").mkdir()
    monkeypatch.chdir(tmp_path / "inside")
    assert (
        refusal(Path())
        == "--out: got ., the current folder or a mounted one; expected a folder"
        " inside it"
    )
