"""Real recordings against predictions.

``python -m experiments.study.reality FOLDER``.

FOLDER has the repositories' folders side by side: OpenTraj, sort, DeepFusionMOT,
AB3DMOT. ``docs/how_to/recordings.md`` says which files are read.
"""

from pathlib import Path

import click

from geometry.errors import InputError
from geometry.writing import write_atomically

from ...figures.axes import to_png
from .report import measure, plot_confirmations, plot_heights, plot_recall, tables, text


@click.command()
@click.argument("folder", type=click.Path(path_type=Path))
@click.option(
    "--out", type=click.Path(path_type=Path), default=Path("results"), show_default=True
)
@click.option(
    "--tables", "tables_to", type=click.Path(path_type=Path), help="Write TOML here."
)
def main(folder: Path, out: Path, tables_to: Path | None) -> None:
    """Write reality.md and its figures.

    With --tables the response tables fitted as well.
    """
    try:
        measured = measure(folder)
        for place in (out, tables_to):
            if place is not None:
                place.mkdir(parents=True, exist_ok=True)
        for name, figure in (
            ("heights", plot_heights(measured.heights)),
            ("recall", plot_recall(measured.panels())),
            ("confirmation", plot_confirmations(measured.confirmations())),
        ):
            write_atomically(out / f"reality_{name}.png", to_png(figure))
        write_atomically(out / "reality.md", text(measured))
        if tables_to is not None:
            for name, content in tables(measured).items():
                write_atomically(tables_to / name, content)
    except InputError as error:
        click.echo(str(error), err=True)
        raise SystemExit(2) from None


if __name__ == "__main__":
    main()
