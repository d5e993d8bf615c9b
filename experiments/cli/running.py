"""How a command begins and ends.

What it needs to know, what it prints. Imports nothing heavy.
"""

import os
import shlex
import sys
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from geometry.cache_folders import user_cache_folder
from geometry.writing import write_atomically

from ..parts import Part
from ..progress import StageProgress, tell, write_out
from .terminal import answer_text

_LEAST_BYTES = 2_000_000_000

if TYPE_CHECKING:
    from placement.compute import Compute
    from placement.layout import Layout
    from placement.question import Question


class ProgramSession(StageProgress):
    """The context object of all commands: progress, and the importer of maps.

    It is handed in by the program, so that no command depends on all formats of maps,
    and returns the folder of the scene, and what was imported in words.
    """

    def __init__(self, import_map: Callable[..., tuple[str, str]]) -> None:
        super().__init__()
        self.import_map = import_map


def begin(progress: StageProgress, question: "Question", *, quiet: bool) -> "Question":
    """Show what happens from here on; the question, with its map imported.

    Raises InputError: options of a map stand with a scene, or the map has no such
    junction.
    """
    from placement.question import map_options

    progress.start(quiet=quiet)
    if not (map_options(question) or Path(question.scene).is_file()):
        return question
    from geometry.scene_sources import has_scene

    if has_scene(Path(question.scene)) and not map_options(question):
        return question
    assert isinstance(progress, ProgramSession)
    folder, words = progress.import_map(
        question, cache=cache_folder(), progress=progress
    )
    if not quiet:
        tell(words, err=True)
    return replace(
        question,
        scene=folder,
        junction="",
        at="",
        sites="",
        sites_crs="",
        driving_side="map",
    )


def load_one_layout(
    names: Sequence[str], question: "Question | None" = None
) -> "Layout":
    """The layout of ``--layout``, given once, else click.UsageError.

    InputError: there is none.

    With a question, a list of units with places on earth may stand in its place: CSV,
    or JSON.
    """
    if len(names) != 1:
        if names:
            given = f"{len(names)} layouts"
        else:
            given = "nothing"
        raise click.UsageError(f"--layout: got {given}; expected it once")
    from placement.layout import find_layout

    if question is None:
        return find_layout(names[0], "--layout")
    from geometry.scene_sources import load_scene

    scene = load_scene(question.scene)
    return find_layout(names[0], "--layout", scene=scene, sensors=question.sensors)


@dataclass(frozen=True, slots=True, kw_only=True)
class Call:
    """A call of a command that prints a result."""

    progress: StageProgress
    as_json: bool
    quiet: bool

    def start(self) -> None:
        """Show what happens from here on."""
        self.progress.start(quiet=self.quiet)

    def announce(self, sentence: str) -> None:
        """Tell something beside the stages."""
        if not self.quiet:
            tell(f"place-rsus: {sentence}", err=True)

    def announce_lines(self, lines: Sequence[str]) -> None:
        """Tell the first lines of an answer, while the rest is being computed."""
        if not self.quiet:
            tell("\n".join(lines), err=True)

    def print(self, result: Any, text: Callable[[], str]) -> None:
        """Take the progress bar away and print a command's result.

        As JSON, or as text for people.
        """
        from ..export.json import to_json_text

        self.progress.stop()
        tell(to_json_text(result).rstrip() if self.as_json else text())


@dataclass(frozen=True, slots=True, kw_only=True)
class QuestionCall(Call):
    """A call of a command that asks something and computes."""

    question: "Question"
    compute: "Compute"

    def begin(self) -> "QuestionCall":
        """Show what happens from here on.

        The job with its map imported, see :func:`begin`.
        """
        return replace(
            self, question=begin(self.progress, self.question, quiet=self.quiet)
        )

    def layout(self, names: Sequence[str]) -> "Layout":
        """The layout of ``--layout``, given once; see :func:`load_one_layout`."""
        return load_one_layout(names, self.question)

    @property
    def means(self) -> dict[str, Any]:
        """What functions that compute take beside what they are asked."""
        return {"compute": self.compute, "progress": self.progress}

    def print_answer(self, result: Any, parts: Callable[[], Iterable[Part]]) -> None:
        """End a command that answers: in short, or with ``--verbose`` all of it."""
        self.print(
            result, lambda: answer_text(parts(), is_verbose=self.progress.is_verbose)
        )


def command_line() -> str:
    """The command line of this call, as a shell would take it again."""
    # What the system hands over need not be text.
    arguments = [
        argument.encode(errors="replace").decode() for argument in sys.argv[1:]
    ]
    return shlex.join(["place-rsus", *arguments])


def cache_folder() -> Path:
    """Where results are cached: PLACE_RSUS_CACHE, or the user's cache folder."""
    folder = os.environ.get("PLACE_RSUS_CACHE")
    if folder:
        return Path(folder)
    return user_cache_folder()


def check_address_space() -> None:
    """Refuse a limit of address space in which libraries crash.

    Raises click.UsageError.
    """
    try:
        import resource
    except ImportError:
        # Windows.
        return
    limit, _ = resource.getrlimit(resource.RLIMIT_AS)
    if limit != resource.RLIM_INFINITY and limit < _LEAST_BYTES:
        raise click.UsageError(
            f"ulimit -v: got {limit // 1000:,} kB; expected {_LEAST_BYTES // 1000:,} or"
            " no limit"
        )


def write_result(out: Path | None, content: str | bytes) -> None:
    """Write a content to a file, or to stdout.

    Raises click.UsageError: it cannot be written.
    """
    if out is None:
        write_out(content)
        return
    try:
        write_atomically(out, content)
    except OSError as error:
        raise unwritable(out, error) from None


def unwritable(path: object, error: OSError) -> click.UsageError:
    """The error of an ``--out`` that cannot be written."""
    return click.UsageError(
        f"--out: got {path}: {error.strerror or error}; expected a file that can be"
        " written"
    )
