import os
import signal
from pathlib import Path

import pytest

from experiments.progress import Interrupted, StageProgress, ending_on_signals
from experiments.results import folders
from experiments.results.folders import MARKER, check_result_folder, new_result_folder
from geometry.errors import InputError


def fill(folder: Path, text: str = "new") -> None:
    with new_result_folder(folder) as new:
        (new / "report.html").write_text(text)
        (new / MARKER).write_text("{}")


def names(folder: Path) -> list[str]:
    return sorted(os.listdir(folder))  # noqa: PTH208 - names are wanted


@pytest.fixture
def earlier(tmp_path):
    """A folder with earlier results."""
    folder = tmp_path / "latest"
    fill(folder, "old")
    (folder / "apr_by_case.png").write_text("old")
    return folder


def test_a_new_folder_is_made_with_its_parents(tmp_path):
    folder = tmp_path / "a" / "b"
    check_result_folder(folder)
    assert names(tmp_path) == []  # a check leaves nothing
    fill(folder)
    assert names(folder) == ["report.html", MARKER]
    assert names(tmp_path / "a") == ["b"]


def test_an_empty_folder_is_filled(tmp_path):
    folder = tmp_path / "out"
    folder.mkdir()
    fill(folder)
    assert names(folder) == ["report.html", MARKER]


def test_results_are_as_readable_as_other_folders(tmp_path):
    folder, other = tmp_path / "out", tmp_path / "other"
    other.mkdir()
    fill(folder)
    assert folder.stat().st_mode == other.stat().st_mode


def test_earlier_results_are_replaced_as_a_whole(earlier):
    fill(earlier)
    assert names(earlier) == ["report.html", MARKER]
    assert (earlier / "report.html").read_text() == "new"
    assert names(earlier.parent) == ["latest"]


def test_half_of_an_earlier_result_is_replaced(earlier):
    (earlier / "report.html").unlink()
    fill(earlier)
    assert names(earlier) == ["report.html", MARKER]


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
    assert names(tmp_path / "later") == ["report.html", MARKER]


def test_a_name_of_the_greatest_length_is_taken(tmp_path):
    fill(tmp_path / ("a" * 255))
    assert names(tmp_path) == ["a" * 255]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
def test_a_failure_leaves_everything_as_it_was(earlier, error):
    def fail(folder: Path) -> None:
        with new_result_folder(folder) as new:
            (new / "report.html").write_text("half")
            raise error

    for folder in (earlier, earlier.parent / "a" / "b"):
        with pytest.raises(type(error)):
            fail(folder)
    assert (earlier / "report.html").read_text() == "old"
    assert names(earlier.parent) == ["latest"]


def test_an_exchange_that_fails_puts_the_earlier_results_back(earlier, monkeypatch):
    rename = Path.rename

    def rename_once(path: Path, target: Path) -> Path:
        if path.suffix == ".tmp":
            raise OSError(16, "Device or resource busy")
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", rename_once)
    with pytest.raises(OSError, match="busy"):
        fill(earlier)
    assert (earlier / "report.html").read_text() == "old"
    assert names(earlier.parent) == ["latest"]


def test_a_signal_during_the_exchange_comes_too_late(earlier, monkeypatch):
    rename = Path.rename

    def rename_interrupted(path: Path, target: Path) -> Path:
        signal.raise_signal(signal.SIGINT)
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", rename_interrupted)
    with ending_on_signals(StageProgress()):
        fill(earlier)
    assert (earlier / "report.html").read_text() == "new"
    assert names(earlier.parent) == ["latest"]


def test_a_signal_during_the_check_leaves_nothing(tmp_path, monkeypatch):
    make = folders.tempfile.mkdtemp

    def make_interrupted(**options: object) -> str:
        signal.raise_signal(signal.SIGINT)
        return make(**options)

    monkeypatch.setattr(folders.tempfile, "mkdtemp", make_interrupted)
    with pytest.raises(Interrupted), ending_on_signals(StageProgress()):
        check_result_folder(tmp_path / "out")
    assert names(tmp_path) == []


def refusal(folder: Path) -> str:
    with pytest.raises(InputError) as caught:
        check_result_folder(folder)
    return str(caught.value)


def test_a_file_is_no_folder(tmp_path):
    path = tmp_path / "file"
    path.write_text("mine")
    assert refusal(path) == f"--out: got '{path}'; expected a folder, not a file"
    assert refusal(path / "below") == (
        f"--out: got {path}/below: Not a directory; expected a folder that can be written to"
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


def test_folders_with_files_of_others_are_refused(earlier, tmp_path):
    expected = "expected a new or empty folder, or one with earlier results and nothing else"
    (earlier / "notes.txt").write_text("mine")
    assert refusal(earlier) == f"--out: got {earlier}, which holds notes.txt; {expected}"
    pictures = tmp_path / "pictures"
    pictures.mkdir()
    (pictures / "cat.png").write_text("mine")
    assert refusal(pictures) == (
        f"--out: got {pictures}, which holds cat.png but no {MARKER}; {expected}"
    )


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
    assert refusal(Path()) == (
        "--out: got ., the current folder or a mounted one; expected a folder inside it"
    )
