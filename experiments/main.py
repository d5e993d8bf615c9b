"""``place-rsus``: knows the commands; turns errors into one line and an exit code."""

import logging
import os
import sys
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NoReturn

import click

from .cli import options
from .cli.commands import COMMANDS
from .cli.place import cli
from .cli.running import ProgramSession, command_line
from .cli.terminal import sentences
from .progress import Interrupted, StageProgress, StderrLog, ending_on_signals, tell
from .results.numbers import several

if TYPE_CHECKING:
    from placement.question import Question

_EXIT_BAD_INPUT = 2
# EX_SOFTWARE of BSD's sysexits.h.
_EXIT_UNEXPECTED = 70


cli.add_entries(COMMANDS)


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line.

    Every problem that the user can mend is one line and exit code 2.

    What nobody foresaw is one line, too, with exit code 70: it names a file with the
    whole text.
    """
    os.environ["MPLBACKEND"] = (
        # No window is opened, whatever a user prefers elsewhere.
        "agg"
    )
    logging.basicConfig(handlers=[StderrLog()], format="place-rsus: %(message)s")
    progress = ProgramSession(_import_map)
    code = 0
    message = ""
    try:
        with ending_on_signals(progress):
            cli.main(
                args=arguments,
                prog_name="place-rsus",
                standalone_mode=False,
                obj=progress,
            )
    except Interrupted as error:
        code = 128 + error.signum
        message = progress.interruption()
    except _mendable_errors() as error:
        code = _EXIT_BAD_INPUT
        message = f"place-rsus: {options.with_option_names(str(error), cli)}"
    except click.ClickException as error:
        text = " ".join(error.format_message().split())
        code = _EXIT_BAD_INPUT
        message = f"place-rsus: {text}"
    except OSError as error:
        # Such as a disk that is full.
        if error.filename:
            where = f"{error.filename}: "
        else:
            where = ""
        notes = "".join(f"; {note}" for note in getattr(error, "__notes__", ()))
        code = _EXIT_BAD_INPUT
        message = f"place-rsus: {where}{error.strerror or error}{notes}"
    except Exception as error:
        # Libraries make errors of their own of what ends their loading.
        if progress.signum:
            code = 128 + progress.signum
            message = progress.interruption()
        elif _is_out_of_memory(error):
            got = f"got too little in stage '{progress.stage}'; {progress.kept}"
            message = (
                f"place-rsus: memory: {got}; expected more of it, or less to compute"
            )
            code = _EXIT_BAD_INPUT
        else:
            code = _EXIT_UNEXPECTED
            message = _unexpected(error, progress)
    finally:
        progress.stop()
    if message:
        tell(message, err=True)
    sys.exit(code)


def _import_map(question: "Question", **options: Any) -> tuple[str, str]:
    """Import a junction of a map into the cache.

    The folder, and what was imported in words.
    """
    from .scene.run import import_into_cache

    folder, found = import_into_cache(question, **options)
    (junction,) = found.junctions
    arms = several(junction.arms, "arm", "arms")
    sites = several(found.sites, "site", "sites")
    buildings = several(found.buildings, "building", "buildings")
    if found.keeps_left:
        side = "left"
    else:
        side = "right"
    text = (
        f"Imported {junction.name}: {arms}, {sites}, {buildings}; traffic keeps {side}."
        f" The scene is in {folder}."
    )
    return folder, "\n".join(sentences(text))


def _unexpected(error: Exception, progress: StageProgress) -> str:
    """Message of an error that is ours, not the user's.

    Its text is saved in a file.
    """
    # These are hardly ever needed.
    import platform
    import tempfile
    import traceback
    from importlib.metadata import version

    said = f"{type(error).__name__}: {' '.join(str(error).split())[:200]}"
    said += "".join(f"; {note}" for note in getattr(error, "__notes__", ()))
    text = "".join(traceback.format_exception(error))
    message = (
        f"place-rsus: unexpected error in stage '{progress.stage}': {said};"
        f" {progress.kept}"
    )
    report = (
        f"place-rsus {version('place-rsus')}, Python {platform.python_version()}, "
        f"{platform.platform()}\n{command_line()}\n\n{text}"
    )
    try:
        name = time.strftime("place-rsus-error-%Y%m%d-%H%M%S-")
        with tempfile.NamedTemporaryFile(
            "w",
            prefix=name,
            suffix=".txt",
            delete=False,
            encoding="utf-8",
            errors="replace",
        ) as file:
            file.write(report)
        message += f". Please report it, with {file.name}"
    except OSError:
        # The disk is full, perhaps: then the text goes to the terminal.
        message += f". Please report it:\n{report}"
    return message


def _is_out_of_memory(error: Exception) -> bool:
    """Memory or address space ran out, also while a library was loaded."""
    said = ("failed to map segment", "cannot allocate memory")
    is_unloaded = isinstance(error, ImportError) and any(
        one in str(error).lower() for one in said
    )
    return isinstance(error, MemoryError) or is_unloaded


def _mendable_errors() -> tuple[type[Exception], ...]:
    from geometry.errors import InputError, MissingExtraError

    return InputError, MissingExtraError


if __name__ == "__main__":
    main()
