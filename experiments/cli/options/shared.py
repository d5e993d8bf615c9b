"""Options that many commands have, and how a command gets them as one value."""

import os
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any

import click

from placement.compute import RAYS, Compute

from ...language import LANGUAGES, speaking
from ..running import Call, QuestionCall, cache_folder, check_address_space
from .question import SEEN, question_options
from .worded import PROGRAM, Decorator, combined, option

# ---------- what is printed


def _tell_more(context: click.Context, _param: click.Parameter, is_given: bool) -> None:
    """Let the program tell what it does in more words."""
    if is_given:
        context.obj.tell_more()


def _speak(context: click.Context, _param: click.Parameter, code: str | None) -> None:
    """Speak a language until the command ends; that of the group, where none is said."""
    if code is not None:
        context.with_resource(speaking(code))


json_option = option(
    "--json",
    "as_json",
    is_flag=True,
    section=PROGRAM,
    help="Print JSON on stdout and nothing else.",
)
_only_quiet_option = option(
    "--quiet",
    is_flag=True,
    section=PROGRAM,
    help="Nothing but errors on stderr.",
)
_verbose_option = option(
    "--verbose",
    is_flag=True,
    expose_value=False,
    callback=_tell_more,
    section=PROGRAM,
    is_common=False,
    help=(
        "Print all of the answer; tell sizes, bounds, files that are read, and seconds"
        " too."
    ),
)
quiet_option = combined(_only_quiet_option, _verbose_option)
"""Options ``--quiet``, which the command gets, and ``--verbose``."""
language_option = option(
    "--language",
    type=click.Choice(LANGUAGES),
    show_default="en",
    envvar="PLACE_RSUS_LANGUAGE",
    expose_value=False,
    callback=_speak,
    section=PROGRAM,
    is_common=False,
    help=(
        "Language of the answer, the report and the sheet; or that of"
        " PLACE_RSUS_LANGUAGE."
    ),
)


# ---------- how it is computed

_seed_option = option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    metavar="N",
    section=PROGRAM,
    is_common=False,
    expected="a whole number, at least 0",
    help=(
        "Of all that is left to chance: points on the road users, misses, lost"
        " messages."
    ),
)
_workers_option = option(
    "--workers",
    type=click.IntRange(min=1, max=1024),
    default=os.cpu_count() or 1,
    show_default="one per processor",
    metavar="N",
    section=PROGRAM,
    is_common=False,
    expected="a number of threads, 1 to 1024",
    help="Threads.",
)
_rays_option = option(
    "--rays",
    type=click.Choice(RAYS),
    default=RAYS[0],
    section=PROGRAM,
    is_common=False,
    help=(
        "Library that casts rays; auto: the fastest that loads. The results are the"
        " same."
    ),
)
_cache_option = option(
    "--cache/--no-cache",
    "uses_cache",
    default=True,
    section=PROGRAM,
    is_common=False,
    help=(
        "Cache what sensors detect between calls, in PLACE_RSUS_CACHE or the user's"
        " cache folder."
    ),
)


# ---------- where tasks run

_ENGINE = (
    option(
        "--scheduler",
        default="",
        metavar="WHERE",
        is_path=True,
        section=PROGRAM,
        is_common=False,
        help=(
            "Run on the workers of a dask scheduler: its address "
            "(tls://10.0.0.1:8786), its file, or local: one of this machine, for this "
            "call. Default: processes of this machine."
        ),
    ),
    *(
        option(
            name,
            type=click.Path(path_type=Path, dir_okay=False),
            metavar="FILE",
            needs="scheduler",
            section=PROGRAM,
            is_common=False,
            help=text,
        )
        for name, text in (
            ("--tls-ca", "Certificates of those that scheduler and workers come from."),
            ("--tls-cert", "Our certificate; may hold the key, too."),
            ("--tls-key", "Our private key."),
        )
    ),
    option(
        "--scheduler-timeout",
        type=click.FloatRange(min=0.0, min_open=True),
        default=60.0,
        metavar="SECONDS",
        needs="scheduler",
        section=PROGRAM,
        is_common=False,
        expected="seconds, more than 0",
        help="How long it may be without workers.",
    ),
    option(
        "--insecure-scheduler",
        is_flag=True,
        needs="scheduler",
        section=PROGRAM,
        is_common=False,
        help=(
            "Take one without TLS: whoever reaches it can run programs as you, here "
            "and on its workers."
        ),
    ),
)
_ENGINE_NAMES = (
    *("scheduler", "tls_ca", "tls_cert", "tls_key"),
    *("scheduler_timeout", "insecure_scheduler"),
)


def engine_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options of an existing cluster; the command gets them as one dict, `engine`."""

    @wraps(command)
    def with_engine(*args: Any, **values: Any) -> Any:
        engine = {name: values.pop(name) for name in _ENGINE_NAMES}
        return command(*args, engine=engine, **values)

    return combined(*_ENGINE)(with_engine)


# ---------- what is read and written

layout_option = option(
    "--layout",
    "layout_names",
    multiple=True,
    is_path=True,
    help="carlancap-12, or a layout file.",
)


def folder_option(files: str) -> Decorator:
    """``--out``, a folder for some files, named in its help.

    Parameters
    ----------
    files : str
        Names of the files; without the option none is written.
    """
    return option(
        "--out",
        type=click.Path(path_type=Path),
        help=f"Folder for {files}; else none.",
    )


sign_option = option(
    "--sign",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="KEY",
    is_common=False,
    help=(
        "Sign the folder with this key by ssh-keygen (OpenSSH); `place-rsus verify "
        "--key` checks it."
    ),
)
"""Option ``--sign`` of all commands that write a folder of results."""


recording_options = combined(
    option(
        "--recording",
        type=click.Path(path_type=Path),
        metavar="DIR",
        section=SEEN,
        is_common=False,
        help=(
            "Work on recorded detections in the study's folder format; --out gets"
            " summary.json."
        ),
    ),
    option(
        "--min-confidence",
        type=click.FloatRange(min=0.0, max=1.0),
        default=0.0,
        show_default=True,
        metavar="SHARE",
        section=SEEN,
        is_common=False,
        needs="recording",
        expected="a confidence, 0 to 1",
        help="With --recording: detections below do not count.",
    ),
)
"""Options ``--recording`` and ``--min-confidence``."""


# ---------- several of them, as one value


def compute_options(*, has_cache: bool = False) -> Decorator:
    """Options that say how to compute; the command gets them as one `compute`.

    Parameters
    ----------
    has_cache : bool
        The command builds detection tables: it has ``--cache``, too.
    """
    added = [_seed_option, _workers_option, _rays_option]
    if has_cache:
        added.append(_cache_option)

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(command)
        def with_compute(
            *args: Any,
            seed: int,
            workers: int,
            rays: str,
            uses_cache: bool = False,
            **values: Any,
        ) -> Any:
            check_address_space()
            # A library that is named must load: this is said before anything is read.
            if rays != RAYS[0]:
                from geometry.raycast import caster_name

                caster_name(rays, where="--rays")
            tables = None
            if uses_cache:
                tables = cache_folder()
            compute = Compute(
                seed=seed,
                workers=workers,
                rays=rays,
                cache_folder=tables,
                progress=click.get_current_context().find_root().obj,
            )
            return command(*args, compute=compute, **values)

        return combined(*added)(with_compute)

    return decorate


def calling(command: Callable[..., Any]) -> Callable[..., Any]:
    """Options ``--json``, ``--quiet`` and so on: the command gets them as one `call`.

    It is for commands that compute nothing that rays, seeds or threads have to do with.
    """

    @wraps(command)
    def with_call(*, as_json: bool, quiet: bool, **values: Any) -> Any:
        # The program's own object, which tells how far it is
        progress = click.get_current_context().find_root().obj
        call = Call(progress=progress, as_json=as_json, quiet=quiet)
        return command(call, **values)

    return combined(json_option, quiet_option)(with_call)


def asking(
    *names: str, defaults: dict[str, Any] | None = None, has_cache: bool = True
) -> Decorator:
    """Options of a command that asks something and computes; it gets them as one `job`.

    Parameters
    ----------
    *names : str
        Fields of the question that the command has options for.
    defaults : dict, optional
        Defaults in place of the fields' own, by field.
    has_cache : bool
        As of :func:`compute_options`.
    """

    def decorate(command: Callable[..., Any]) -> Callable[..., Any]:
        @wraps(command)
        def with_job(
            *,
            question: Any,
            compute: Compute,
            as_json: bool,
            quiet: bool,
            **values: Any,
        ) -> Any:
            progress = click.get_current_context().find_root().obj
            job = QuestionCall(
                progress=progress,
                question=question,
                compute=compute,
                as_json=as_json,
                quiet=quiet,
            )
            return command(job, **values)

        add = combined(
            question_options(*names, defaults=defaults),
            language_option,
            json_option,
            quiet_option,
            compute_options(has_cache=has_cache),
        )
        return add(with_job)

    return decorate
