"""``place-rsus export``: a layout for other programs."""

from pathlib import Path

import click

from .cli_options import OneOf, layout_option, scene_option

EXPORT_FORMATS = ("csv", "geojson", "carla")


@click.command(
    epilog="""\b
Examples:
  place-rsus export --layout carlancap-12 --format carla
  place-rsus export --layout carlancap-12 --format geojson --out rsus.geojson"""
)
@layout_option
@click.option(
    "--format",
    "format_name",
    required=True,
    type=OneOf(EXPORT_FORMATS),
    help="csv; geojson (WGS 84); carla: spawn transforms in CARLA's frame.",
)
@scene_option
@click.option("--out", type=click.Path(path_type=Path), help="File to write; else stdout.")
def export(
    *, layout_names: tuple[str, ...], format_name: str, scene: str, out: Path | None
) -> None:
    """Write a layout in a format that other programs read."""
    if len(layout_names) != 1:
        given = f"{len(layout_names)} layouts" if layout_names else "nothing"
        raise click.UsageError(f"--layout: got {given}; expected it once")
    from . import jobs
    from .study import find_layout

    layout = find_layout(layout_names[0], "--layout")

    text = jobs.export_layout(layout, format_name, scene_path=scene)
    if out is None:
        click.echo(text, nl=False)
        return
    from geometry.atomic_files import write_atomically

    try:
        write_atomically(out, lambda file: file.write(text.encode()))
    except OSError as error:
        raise click.UsageError(
            f"--out: got {out}: {error.strerror}; expected a file that can be written"
        ) from None
