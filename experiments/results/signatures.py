"""Signatures of result folders, made and checked by ``ssh-keygen``.

OpenSSH brings it.

``SHA256SUMS`` is what is signed: it names every other file with its hash. The signature
lies next to it, as OpenSSH writes it, so that ``ssh-keygen -Y verify -n place-rsus``
checks it anywhere.
"""

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from geometry.errors import InputError, Unquoted
from geometry.opening import read_bytes, read_text
from geometry.writing import write_atomically

SIGNATURE = "SHA256SUMS.sig"
NAMESPACE = "place-rsus"
"""Purpose that OpenSSH binds a signature to: it is none for mail or commits."""

_PROGRAM = "ssh-keygen"
# Keys in hardware wait until somebody touches them.
_LIMIT_S = 120.0
_MAX_KEY_BYTES = 1_000_000
# The name under which the one trusted key is listed.
_SIGNER = "signer"
# How the lines of public keys begin.
_KEY_KINDS = ("ssh-", "ecdsa-", "sk-")
_PRIVATE = "-----BEGIN"


def check_signing_key(key: Path) -> None:
    """Try a key before anything is computed.

    Raises InputError as :func:`sign`.
    """
    sign(b"", key)


def sign(content: bytes, key: Path) -> bytes:
    """Signature of a content, armoured as OpenSSH writes it.

    `key` is a private key without passphrase, or a public key whose private one an
    agent holds.

    Raises
    ------
    InputError
        There is no ``ssh-keygen``, or it cannot sign with this key.
    """
    where = "--sign"
    _check_program(where)
    if not key.is_file():
        raise InputError(
            where, Unquoted(f"{key}: no file"), "a file with a private key"
        )
    done = _run(["-Y", "sign", "-f", str(key), "-n", NAMESPACE], content, where)
    if done.returncode != 0 or b"BEGIN SSH SIGNATURE" not in done.stdout:
        expected = (
            "a private key without passphrase, or a public key that ssh-agent has"
        )
        raise InputError(where, Unquoted(f"{key}: {_reason(done)}"), expected)
    return done.stdout


def write_signature(folder: Path, manifest: Path, key: Path) -> None:
    """Sign a folder's list of hashes. Raises InputError as :func:`sign`."""
    write_atomically(folder / SIGNATURE, sign(manifest.read_bytes(), key))


def signature_fault(folder: Path, manifest: Path, key: Path) -> str:
    """Why a folder's signature does not hold, in words; nothing if it holds.

    `key` is a file with public keys, one a line, as OpenSSH writes them:
    ``id_ed25519.pub``.

    Raises
    ------
    InputError
        There is no ``ssh-keygen``, or the file holds no public key.
    """
    where = "--key"
    _check_program(where)
    trusted = _allowed_signers(key, where)
    signature = folder / SIGNATURE
    if not signature.is_file():
        return f"there is no {SIGNATURE}"
    content = read_bytes(manifest)
    with tempfile.TemporaryDirectory(prefix="place-rsus-") as temporary:
        signers = Path(temporary) / "allowed_signers"
        signers.write_text(trusted, encoding="utf-8")
        # A copy: ssh-keygen opens whatever the name is, and the folder is somebody
        # else's.
        copied = Path(temporary) / SIGNATURE
        copied.write_bytes(read_bytes(signature, max_bytes=_MAX_KEY_BYTES))
        arguments = ["-Y", "verify", "-f", str(signers), "-I", _SIGNER]
        arguments += ["-n", NAMESPACE, "-s", str(copied)]
        done = _run(arguments, content, where)
    if done.returncode == 0:
        return ""
    # The signature holds, but it is another key's.
    if not done.stderr.strip():
        return f"it is not signed by {key.name}"
    return f"it is not signed by {key.name}: {_reason(done)}"


def _allowed_signers(key: Path, where: str) -> str:
    """Public keys of a file, in the form of ``ssh-keygen -Y verify``."""
    expected = "a file with public keys, such as id_ed25519.pub"
    text = read_text(key, expected)
    if _PRIVATE in text:
        raise InputError(
            where, Unquoted(f"{key}: a private key"), f"{expected}: the public one"
        )
    lines = []
    for line in text.splitlines():
        words = line.split()
        if len(words) >= 2 and words[0].startswith(_KEY_KINDS):
            lines.append(f'{_SIGNER} namespaces="{NAMESPACE}" {words[0]} {words[1]}\n')
        elif words and not line.startswith("#"):
            raise InputError(where, Unquoted(f"{key}: no public key"), expected)
    if not lines:
        raise InputError(where, Unquoted(f"{key}: no public key"), expected)
    return "".join(lines)


def _check_program(where: str) -> None:
    if shutil.which(_PROGRAM) is None:
        raise InputError(
            where, Unquoted(f"no {_PROGRAM}"), "OpenSSH 8.1 or later installed"
        )


def _run(
    arguments: list[str], content: bytes, where: str
) -> subprocess.CompletedProcess[bytes]:
    """Run ``ssh-keygen`` where it can ask nobody for a passphrase."""
    quiet = {"SSH_ASKPASS_REQUIRE": "never", "LC_ALL": "C"}
    try:
        return subprocess.run(
            [_PROGRAM, *arguments],
            input=content,
            capture_output=True,
            check=False,
            timeout=_LIMIT_S,
            # Without a terminal.
            start_new_session=True,
            env=os.environ | quiet,
        )
    except subprocess.TimeoutExpired:
        got = Unquoted(f"no answer of {_PROGRAM} within {_LIMIT_S:g} s")
        raise InputError(where, got, "a key that can be used now") from None


def _reason(done: subprocess.CompletedProcess[bytes]) -> str:
    """What ``ssh-keygen`` said, in one line."""
    lines = done.stderr.decode(errors="replace").split("\n")
    said = [" ".join(line.split()) for line in lines if line.strip()]
    if not said:
        return f"{_PROGRAM} ended with exit code {done.returncode}"
    if any("passphrase" in line.lower() for line in said):
        return "it has a passphrase"
    return said[-1][:200]
