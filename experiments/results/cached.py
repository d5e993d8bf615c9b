"""Parts of a result's files, cached in the language that is spoken."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

from placement.cache import cached_value
from placement.fingerprints import ALL_PACKAGES, version_of

from ..language import language

_T = TypeVar("_T")
# Decide what is written and drawn, besides those that decide the answer.
_LIBRARIES = (
    *("embreex", "matplotlib", "pandas", "pillow", "pyarrow"),
    *("shapely", "trimesh"),
)


def cached_part(
    folder: Path | None,
    name: str,
    make: Callable[[], _T],
    *,
    kind: Any,
    made_from: Sequence[object],
) -> _T:
    """Value of `make`, or the same from an earlier call.

    `make` uses nothing but `made_from`, the language, and code; see
    :func:`placement.cache.cached_value`. What only `make` needs is loaded there.
    """
    libraries = [version_of(library) for library in _LIBRARIES]
    return cached_value(
        folder,
        name,
        make,
        kind=kind,
        made_from=(language(), libraries, *made_from),
        packages=(*ALL_PACKAGES, "experiments"),
    )
