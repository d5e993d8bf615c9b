"""Files read in a process of their own, within limits: see reading_process.py."""

import json
import os
import selectors
import shutil
import subprocess
import sys
from pathlib import Path

from readers import Files

ROOT = Path(__file__).parents[2]
WALL_S = 120.0  # for one file, on a machine that does other things, too


class Process:
    """The process that reads; another one after it has ended."""

    def __init__(self) -> None:
        self.running: subprocess.Popen[str] | None = None

    def ask(self, reader: str, path: Path, *, is_sound: bool = False) -> dict[str, str]:
        """What became of a file; a process that ends or waits has failed."""
        if self.running is None:
            folders = os.pathsep.join(map(str, (ROOT, ROOT / "tests/support")))
            self.running = subprocess.Popen(
                [
                    sys.executable,
                    str(ROOT / "tests/support/reading_process.py"),
                ],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
                cwd=ROOT,
                env=os.environ | {"PYTHONPATH": folders, "OMP_NUM_THREADS": "1"},
            )
        process = self.running

        assert process.stdin is not None
        assert process.stdout is not None

        asked = {"reader": reader, "path": str(path), "is_sound": is_sound}
        process.stdin.write(json.dumps(asked) + "\n")
        process.stdin.flush()
        with selectors.DefaultSelector() as selector:
            selector.register(process.stdout, selectors.EVENT_READ)
            if selector.select(WALL_S):
                line = process.stdout.readline()
            else:
                line = ""

        if line:
            answer: dict[str, str] = json.loads(line)
            return answer
        code = self._gone(process)
        self.end()
        words = {-27: "it took 10 s of processor time", None: f"it took {WALL_S:.0f} s"}
        return {
            "outcome": "failed",
            "text": words.get(code, f"the process ended by {code}"),
        }

    @staticmethod
    def _gone(process: "subprocess.Popen[str]") -> int | None:
        try:
            return process.wait(2.0)
        except subprocess.TimeoutExpired:
            return None

    def end(self) -> None:
        if self.running is not None:
            self.running.kill()
            self.running.communicate()
            self.running = None


def put(folder: Path, files: Files, entry: str) -> Path:
    """Files in an empty folder; the path that is to be read."""
    shutil.rmtree(folder, ignore_errors=True)
    for name, data in files.items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)
    if entry == ".":
        return folder
    return folder / entry
