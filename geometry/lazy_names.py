"""Names of a package that are loaded when they are first used: numbers and solvers take seconds."""

import ast
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any


def lazy_names(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """``__getattr__``, ``__dir__``, ``__all__`` of a package, by its stub: SPEC 1, lazy loading."""
    stub = ast.parse(Path(file).with_suffix(".pyi").read_bytes())
    homes = {
        alias.name: f"{'.' * statement.level}{statement.module}"
        for statement in stub.body
        if isinstance(statement, ast.ImportFrom)
        for alias in statement.names
    }
    all_names = sorted(homes)

    def get(name: str) -> Any:
        if name not in homes:
            raise AttributeError(f"module {package!r} has no attribute {name!r}")
        return getattr(import_module(homes[name], package), name)

    return get, lambda: all_names, all_names
