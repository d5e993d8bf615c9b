"""Documents of XML, from templates of this folder."""

from functools import cache
from typing import Any


@cache
def _templates() -> Any:
    from jinja2 import Environment, PackageLoader, StrictUndefined

    loader = PackageLoader(__package__, "")
    return Environment(loader=loader, autoescape=True, undefined=StrictUndefined)


def xml_text(template: str, *, namespace: str = "", **values: Any) -> str:
    """XML document of a template of this folder, indented; texts in it are escaped."""
    import xml.etree.ElementTree as ET

    root = ET.fromstring(_templates().get_template(template).render(values))
    for element in root.iter():
        if not len(element) and not (element.text or "").strip():
            # Blanks of the template, where nothing was filled in.
            element.text = None
    if namespace:
        root.set("xmlns", namespace)
    ET.indent(root)
    text = ET.tostring(root, encoding="unicode")
    return f'<?xml version="1.0" encoding="UTF-8"?>\n{text}\n'
