"""Folders that nobody else can read or write."""

import os
import tempfile

import pytest

from geometry import cache_folders
from geometry.cache_folders import (
    open_own,
    private_temporary_folder,
    user_cache_folder,
    writable_by_others,
)


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="the system has no such rights")
@pytest.mark.parametrize(
    ("mode", "is_shared"),
    [
        (0o700, False),
        (0o755, False),
        (0o707, True),
        (0o777, True),
        (0o1777, True),
    ],
)
def test_who_else_may_write_is_told_by_the_rights_of_a_folder(
    tmp_path, mode, is_shared
):
    folder = tmp_path / "cache"
    folder.mkdir()
    folder.chmod(mode)

    assert writable_by_others(folder) is is_shared

    inside = folder / "own"
    # Others may put another in its place, but where that is forbidden.
    inside.mkdir(mode=0o700)

    assert writable_by_others(inside) is (is_shared and not mode & 0o1000)


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="the system has no such rights")
@pytest.mark.parametrize(
    ("group", "members", "is_shared"),
    [
        ("ann", [], False),
        ("ann", ["ann"], False),
        ("ann", ["bob"], True),
        ("staff", [], True),
    ],
)
def test_a_users_own_group_is_nobody_else(
    tmp_path, monkeypatch, group, members, is_shared
):
    import grp
    import pwd
    from types import SimpleNamespace

    folder = tmp_path / "cache"
    folder.mkdir()
    folder.chmod(0o770)
    if os.getuid() == 0:
        os.chown(folder, 0, 12345)
    monkeypatch.setattr(pwd, "getpwuid", lambda uid: SimpleNamespace(pw_name="ann"))
    found = SimpleNamespace(gr_name=group, gr_mem=members)
    monkeypatch.setattr(grp, "getgrgid", lambda gid: found)

    assert writable_by_others(folder) is is_shared
    if os.getuid() == 0:
        os.chown(folder, 4321, 0)
        assert writable_by_others(folder)


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="the system has no such rights")
def test_a_folder_behind_links_is_judged_by_all_that_leads_there(tmp_path):
    (tmp_path / "open").mkdir()
    target = tmp_path / "open" / "own"
    target.mkdir(mode=0o700)
    (tmp_path / "first").symlink_to("open")
    (tmp_path / "link").symlink_to(tmp_path / "first" / "own")

    assert not writable_by_others(tmp_path / "link")

    (tmp_path / "open").chmod(0o777)
    assert writable_by_others(tmp_path / "link")


@pytest.mark.skipif(
    not hasattr(os, "getuid") or os.getuid() != 0, reason="only root gives away"
)
def test_files_of_another_user_are_not_believed(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"mine")
    path.chmod(0o600)

    with open_own(path) as file:
        assert file.read() == b"mine"
    os.chown(path, 4321, 4321)

    assert writable_by_others(path)
    with pytest.raises(PermissionError, match="another user may have written it"):
        open_own(path)


def test_a_relative_cache_home_does_not_count(monkeypatch, tmp_path):
    monkeypatch.setenv("HOME", str(tmp_path))
    for value in ("here", "../there", ""):
        monkeypatch.setenv("XDG_CACHE_HOME", value)
        assert user_cache_folder().is_relative_to(tmp_path)


@pytest.mark.skipif(not hasattr(os, "getuid"), reason="the system has no such rights")
def test_a_temporary_folder_is_the_same_unless_somebody_else_holds_its_name(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    find = private_temporary_folder.__wrapped__
    first = find()

    assert find() == first == tmp_path / f"place-rsus-{os.getuid()}"
    assert first.stat().st_mode & 0o777 == 0o700

    first.chmod(0o777)
    removed = []
    monkeypatch.setattr(
        cache_folders.atexit,
        "register",
        lambda remove, folder, **_: removed.append(folder),
    )
    other = find()

    assert other != first
    assert other.stat().st_mode & 0o777 == 0o700
    assert removed == [other]
