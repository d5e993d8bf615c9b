"""Fuzz one reader, guided by which lines its input reaches; not part of the suite.

``PYTHONPATH=tests/support:. uv run --with atheris==3.0.0 python
tests/support/coverage_fuzz.py READER``, and options of libFuzzer such as
``-max_total_time=600``. Readers are those of ``readers.py``; it begins with their sound
files, and ends at an input that is neither read nor refused, which it keeps.
"""

import contextlib
import logging
import sys
import tempfile
import warnings
from pathlib import Path

from readers import READERS

OURS = ["geometry", "scenarios", "placement", "experiments"]


def main() -> None:
    import atheris

    reader = READERS[sys.argv.pop(1)]
    seeds = list(reader.seeds().values())
    warnings.simplefilter("ignore")
    logging.disable(logging.CRITICAL)
    folder = Path(tempfile.mkdtemp())
    corpus = folder / "corpus"
    corpus.mkdir()

    for number, (name, files) in enumerate(seeds):
        # Not a folder: the first byte says which of the sound files it stands for.
        if name in files:
            (corpus / f"{number}").write_bytes(bytes([number]) + files[name])

    def read(data: bytes) -> None:
        name, files = seeds[data[0] % len(seeds) if data else 0]
        if name not in files:
            return
        for beside, content in files.items():
            (folder / beside).write_bytes(content)
        (folder / name).write_bytes(data[1:])
        with contextlib.suppress(InputError):
            reader.read(folder / name)

    # Much is imported by the first that needs it.
    with atheris.instrument_imports(include=OURS):
        from geometry.errors import InputError

        for number in range(len(seeds)):
            read(bytes([number]) + seeds[number][1].get(seeds[number][0], b""))

    atheris.Setup([*sys.argv, str(corpus)], read)
    atheris.Fuzz()


if __name__ == "__main__":
    main()
