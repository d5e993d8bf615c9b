"""The template of all pages: a title, an answer, sections with text, tables and figures."""

from functools import cache

from jinja2 import Environment, PackageLoader, StrictUndefined, Template


@cache
def page_environment() -> Environment:
    """How all pages are made from templates: text of others is shown as text."""
    return Environment(
        loader=PackageLoader("experiments.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )


@cache
def page_template() -> Template:
    """The template of all pages: title, answer, sections, details; and what can be played."""
    return page_environment().get_template("report.html.j2")
