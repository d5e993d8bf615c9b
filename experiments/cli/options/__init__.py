"""Options of the commands, as plain click decorators.

An option of one command stands above that command, in the command's own module::

    @options.option(
        "--max",
        "max_units",
        type=click.IntRange(min=1),
        metavar="N",
        default=8,
        expected="a whole number of units, at least 1",
        help="Most units, beside those of --keep.",
    )

Deleting the decorator, and the parameter of the function, deletes the option.

``worded``
    :func:`option`, which is ``click.option`` with this project's wording of errors,
    sections of the help, and checks of options that need or exclude another one.
``sections``
    Commands whose help lists options in sections, and ``--help-all``.
``question``
    Options that ask a :class:`placement.Question`, one for each field. Their types,
    bounds and texts are those of the fields: the library checks the same ones.
``shared``
    Options that many commands have: ``--json``, ``--quiet``, ``--seed`` and so on.
"""

from .question import (
    ASKED,
    DRIVEN,
    JUDGED,
    MOUNTED,
    OF_SCENE,
    ONLY_DRIVEN,
    PICTURED,
    PLANNED,
    QUESTION_OPTIONS,
    SECTIONS,
    SEEN,
    SOUGHT,
    fields_in,
    help_of,
    one_run_options,
    option_of,
    question_options,
)
from .sections import SectionedCommand, SectionedGroup, with_option_names
from .shared import (
    asking,
    calling,
    compute_options,
    engine_options,
    folder_option,
    json_option,
    language_option,
    layout_option,
    quiet_option,
    recording_options,
    sign_option,
)
from .worded import PROGRAM, Decorator, combined, is_given, option, option_name

__all__ = [
    "ASKED",
    "DRIVEN",
    "JUDGED",
    "MOUNTED",
    "OF_SCENE",
    "ONLY_DRIVEN",
    "PICTURED",
    "PLANNED",
    "PROGRAM",
    "QUESTION_OPTIONS",
    "SECTIONS",
    "SEEN",
    "SOUGHT",
    "Decorator",
    "SectionedCommand",
    "SectionedGroup",
    "asking",
    "calling",
    "combined",
    "compute_options",
    "engine_options",
    "fields_in",
    "folder_option",
    "help_of",
    "is_given",
    "json_option",
    "language_option",
    "layout_option",
    "one_run_options",
    "option",
    "option_name",
    "option_of",
    "question_options",
    "quiet_option",
    "recording_options",
    "sign_option",
    "with_option_names",
]
