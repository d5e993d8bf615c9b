"""The report's partial templates by themselves, within the macros that they use."""

from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

REPORT = "report.html.j2"


def render_partial(name: str, **context: Any) -> str:
    """A partial as the report includes it: escaped, and every variable must be there."""
    loader = PackageLoader("experiments.report")
    environment = Environment(
        loader=loader,
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    source, _, _ = loader.get_source(environment, REPORT)
    macros = source[: source.index("<!DOCTYPE")]
    return environment.from_string(f'{macros}{{% include "{name}" %}}').render(**context)
