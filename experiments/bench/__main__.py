"""What the main job costs: ``python -m experiments.bench main-job``."""

import click

from .main_job import measure_main_job


@click.group()
def main() -> None:
    """Measure this program."""


@main.command("main-job")
@click.option("--budget", default=3, show_default=True, help="Units.")
def tell_main_job(budget: int) -> None:
    """Time of the main job, also as ratios to named references."""
    for figure, value in measure_main_job(budget).items():
        click.echo(f"{figure:<72} {value:.3g}")


if __name__ == "__main__":
    main()
