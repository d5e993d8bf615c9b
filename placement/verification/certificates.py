"""Certificates: what was solved and found, and how good it is.

``certificate.json`` is the file's name. Next to it lies ``instance.npz``, the
whole problem (:mod:`.instances`): together they are enough to check the claim
without the optimiser.
"""

import math
from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta, Struct, defstruct, field

from geometry.errors import InputError, Unquoted
from geometry.opening import read_text
from geometry.tables import Text, read_table, take_text
from geometry.text_formats import parse_json

from ..layout import Stage
from ..optimiser import PresolveStatistics
from ..proof_files import SCHEMA

_Count = Annotated[int, Meta(ge=0)]
_SOME = Meta(min_length=1, description="a list of at least one")
_Sizes = defstruct(
    "_Sizes", [(one.name, tuple[_Count, _Count]) for one in fields(PresolveStatistics)]
)
"""Before and after presolve."""


class StoredUnit(Struct, frozen=True, kw_only=True):
    """A unit of the layout."""

    # Of the detection table.
    row: _Count
    # Its name there.
    pose: Text
    # As ``layout.json`` has it.
    unit: dict[str, Any]


class Claim(Struct, frozen=True, kw_only=True):
    """What is claimed of a stage; see :class:`placement.layout.Stage`."""

    name: Text
    objective: float
    bound: float
    # None: infinite
    gap: float | None
    seconds: float
    # Is the layout claimed to be the best?
    is_proven: bool


class StoredCertificate(Struct, frozen=True, kw_only=True):
    """Claims of a ``certificate.json``, read and checked for form only.

    As :func:`build_certificate` makes them.
    """

    # What :func:`instance_of` says.
    instance: dict[str, Any]
    # What :func:`model_of` says, and the names of the "stages" in order.
    model: dict[str, Any]
    layout: Annotated[list[StoredUnit], _SOME]
    # Objectives in order.
    claims: Annotated[list[Claim], _SOME] = field(name="stages")
    # Is the layout claimed to be the best in all?
    is_proven: bool
    # Name and version of what the proof rests on.
    solver: Text
    # Of the programs that the numbers depend on.
    versions: dict[str, Any]
    presolve: _Sizes  # type: ignore[valid-type]  # sizes before and after

    @property
    def sha256(self) -> str:
        """Hash of the problem, see :func:`problem_hash`."""
        return str(self.instance["sha256"])

    @property
    def pose_index(self) -> tuple[int, ...]:
        """Rows of the detection table."""
        return tuple(one.row for one in self.layout)

    @property
    def stages(self) -> tuple[Stage, ...]:
        """Objectives in order, each with what is claimed of it."""
        return tuple(
            Stage(
                name=one.name,
                objective=one.objective,
                bound=one.bound,
                gap=math.inf if one.gap is None else one.gap,
                seconds=one.seconds,
            )
            for one in self.claims
        )

    @property
    def units(self) -> tuple[dict[str, Any], ...]:
        """The units, as ``layout.json`` has them."""
        return tuple(one.unit for one in self.layout)


def load_certificate(path: str | Path) -> StoredCertificate:
    """Read a ``certificate.json``; whether its claims are true is not looked at.

    Parameters
    ----------
    path : Path
        The file.

    Returns
    -------
    stored : StoredCertificate
        What it claims.

    Raises
    ------
    InputError
        The file cannot be read, is no certificate, or a field is missing or not of its
        kind.
    """
    where = str(path)
    # Form and version are checked; claims are not.
    document = parse_json(read_text(Path(path), "JSON"), where, "a certificate")
    if isinstance(document, dict):
        schema = document.get("schema")
    else:
        schema = Unquoted("no object")
    if schema != SCHEMA:
        raise InputError(f"{where}: schema", schema, SCHEMA)
    read = read_table(document, StoredCertificate, where)
    take_text(read.instance, "sha256", f"{where}: instance")
    return read
