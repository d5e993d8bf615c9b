"""Signatures of result folders, by OpenSSH's own program."""

import shutil
import subprocess
from pathlib import Path

import msgspec
import pytest

from experiments.progress import StageProgress
from experiments.results import folders, signatures
from experiments.results.folders import MANIFEST, new_result_folder
from experiments.results.signatures import SIGNATURE, sign, signature_fault
from geometry.errors import InputError


class Timed(msgspec.Struct, frozen=True):
    """A result that has times and nothing else."""

    seconds: dict[str, float] = {}


needs_openssh = pytest.mark.skipif(
    shutil.which("ssh-keygen") is None, reason="OpenSSH is not installed"
)


def make_key(path: Path, passphrase: str = "") -> Path:
    """Make a key of ssh, and its public half beside it."""
    arguments = ["ssh-keygen", "-q", "-t", "ed25519", "-N", passphrase, "-f", str(path)]
    subprocess.run(arguments, check=True)
    return path


@pytest.fixture(scope="module")
def keys(tmp_path_factory):
    """A folder with keys of two people, and one behind a passphrase."""
    folder = tmp_path_factory.mktemp("keys")
    make_key(folder / "mine")
    make_key(folder / "other")
    make_key(folder / "locked", "a secret")
    return folder


@pytest.fixture
def signed(keys, tmp_path):
    """A folder of results that was signed."""
    with new_result_folder(tmp_path / "results", sign=keys / "mine") as new:
        (new / "summary.json").write_text("{}")
    return tmp_path / "results"


def fault(folder: Path, key: Path) -> str:
    """What is wrong with a signature."""
    return signature_fault(folder, folder / MANIFEST, key)


@needs_openssh
def test_a_signed_folder_holds_for_its_key_alone(keys, signed):
    assert fault(signed, keys / "mine.pub") == ""
    assert fault(signed, keys / "other.pub") == "it is not signed by other.pub"
    assert SIGNATURE not in folders.read_manifest(signed)
    assert folders.changed_files(signed) == {}


@needs_openssh
def test_one_of_several_keys_is_enough(keys, signed, tmp_path):
    both = tmp_path / "keys.pub"
    lines = [(keys / f"{name}.pub").read_text() for name in ("other", "mine")]
    both.write_text("# those who may sign\n" + "".join(lines))

    assert fault(signed, both) == ""


@needs_openssh
def test_a_list_of_hashes_made_anew_is_not_signed(keys, signed):
    (signed / "summary.json").write_text('{"apr": 1.0}')
    folders.write_manifest(signed)

    assert folders.changed_files(signed) == {}
    assert "it is not signed by mine.pub" in fault(signed, keys / "mine.pub")


@needs_openssh
def test_a_missing_damaged_or_foreign_signature_does_not_hold(keys, signed):
    key = keys / "mine.pub"
    # One that was made with the right key for another purpose.
    arguments = ["ssh-keygen", "-Y", "sign", "-f", str(keys / "mine"), "-n", "mail"]
    content = (signed / MANIFEST).read_bytes()
    done = subprocess.run(arguments, input=content, capture_output=True, check=True)
    (signed / SIGNATURE).write_bytes(done.stdout)

    assert "it is not signed by mine.pub" in fault(signed, key)

    (signed / SIGNATURE).write_text("no signature")
    assert "it is not signed by mine.pub" in fault(signed, key)

    (signed / SIGNATURE).unlink()
    assert fault(signed, key) == f"there is no {SIGNATURE}"


@needs_openssh
@pytest.mark.parametrize(
    ("name", "words"),
    [
        (
            "locked",
            (
                "it has a passphrase; expected a private key without passphrase, or a"
                " public"
            ),
        ),
        ("none", "no file; expected a file with a private key"),
        ("words", "; expected a private key without passphrase"),
    ],
)
def test_a_key_that_cannot_sign_is_refused_in_one_line(keys, name, words):
    (keys / "words").write_text("no key\n")
    with pytest.raises(InputError) as caught:
        sign(b"", keys / name)
    assert str(caught.value).startswith(f"--sign: got {keys / name}")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@needs_openssh
@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            "-----BEGIN OPENSSH PRIVATE KEY-----\n",
            "a private key; expected a file with public",
        ),
        ("no key\n", "no public key; expected a file with public keys"),
        ("", "no public key; expected a file with public keys"),
    ],
)
def test_what_is_no_public_key_is_refused_in_one_line(signed, tmp_path, text, words):
    (tmp_path / "key").write_text(text)
    with pytest.raises(InputError) as caught:
        fault(signed, tmp_path / "key")
    assert f"--key: got {tmp_path / 'key'}: {words}" in str(caught.value)


def test_without_openssh_it_is_said_before_anything_is_computed(tmp_path, monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    (tmp_path / "key").write_text("")
    words = "got no ssh-keygen; expected OpenSSH 8.1 or later installed"

    with pytest.raises(InputError, match=f"--sign: {words}"):
        folders.expect_results(tmp_path / "r", StageProgress(), sign=tmp_path / "key")
    with pytest.raises(InputError, match=f"--sign: {words}"):
        folders.expect_files(tmp_path / "r", StageProgress(), sign=tmp_path / "key")
    with pytest.raises(InputError, match=f"--key: {words}"):
        fault(tmp_path, tmp_path / "key")
    assert not (tmp_path / "r").exists()


def test_a_key_that_nobody_touches_is_not_waited_for(tmp_path, monkeypatch):
    (tmp_path / "ssh-keygen").write_text("#!/bin/sh\nsleep 60\n")
    (tmp_path / "ssh-keygen").chmod(0o755)
    (tmp_path / "key").write_text("")
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    monkeypatch.setattr(signatures, "_LIMIT_S", 0.2)

    with pytest.raises(InputError, match="no answer of ssh-keygen within"):
        sign(b"", tmp_path / "key")


def test_there_is_nothing_to_sign_without_a_folder(tmp_path):
    with pytest.raises(InputError, match="expected --out as well, a folder to sign"):
        folders.expect_results(None, StageProgress(), sign=tmp_path / "key")


@needs_openssh
def test_what_is_added_to_a_folder_can_be_signed_too(keys, tmp_path):
    out = tmp_path / "certified"
    folders.save_files(
        Timed(),
        out,
        StageProgress(),
        lambda done: {"certified.json": "{}"},
        has_manifest=True,
        sign=keys / "mine",
    )

    assert fault(out, keys / "mine.pub") == ""
    assert folders.changed_files(out) == {}

    folders.save_files(
        Timed(),
        out,
        StageProgress(),
        lambda done: {"certified.json": "[]"},
        has_manifest=True,
    )
    assert fault(out, keys / "mine.pub") == f"there is no {SIGNATURE}"
