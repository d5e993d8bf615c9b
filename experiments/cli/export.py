"""``place-rsus export``: a layout for other programs."""

from pathlib import Path

import click

from ..export import FORMAT_NOTES
from ..progress import load_one_layout
from .options import OneOf, layout_option, scene_option

_FORMATS = "\n".join(
    f"  {name:<10} {note.content}{'; needs --out' if note.is_binary else ''}"
    for name, note in FORMAT_NOTES.items()
)


@click.command(
    epilog=f"""\b
Formats, and who reads them:
{_FORMATS}
opencv and ros leave LiDARs out; geojson, gpkg, kml and cpm need a scene that
lies somewhere on earth.

\b
Examples:
  place-rsus export --layout carlancap-12 --format carla
  place-rsus export --layout carlancap-12 --format geojson --out rsus.geojson
  place-rsus export --layout a.json --scene city --format gpkg --out a.gpkg"""
)
@layout_option
@click.option(
    "--format",
    "format_name",
    required=True,
    metavar="FORMAT",
    type=OneOf(tuple(FORMAT_NOTES)),
    help="One of those below.",
)
@scene_option
@click.option("--out", type=click.Path(path_type=Path), help="File to write; else stdout.")
def export(
    *, layout_names: tuple[str, ...], format_name: str, scene: str, out: Path | None
) -> None:
    """Write a layout in a format that other programs read."""
    if out is None and FORMAT_NOTES[format_name].is_binary:
        raise click.UsageError(f"--out: got nothing; expected a file: {format_name} is no text")
    layout = load_one_layout(layout_names)
    from ..export.formats import export_layout, left_out

    content = export_layout(layout, format_name, scene_path=scene)
    missing = left_out(layout, format_name)
    if missing:
        click.echo(f"left out, for they are no cameras: {', '.join(missing)}", err=True)
    if out is None:
        click.echo(content, nl=False)
        return
    from geometry.files import write_atomically

    data = content.encode() if isinstance(content, str) else content
    try:
        write_atomically(out, lambda file: file.write(data))
    except OSError as error:
        raise click.UsageError(
            f"--out: got {out}: {error.strerror}; expected a file that can be written"
        ) from None
