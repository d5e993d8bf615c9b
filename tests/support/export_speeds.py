"""Sizes and times of exports: ``python tests/support/export_speeds.py`` writes
results/exports.md.
"""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from experiments.results.tables import markdown_table
from geometry.study_scene import load_study_scene
from placement.layout import load_carlancap_layout


def measure_exports(n_units: int = 500) -> list[tuple[str, str, str, str]]:
    """Format, what is written, processor seconds, and MB of many units.

    Libraries are loaded before.
    """
    from experiments.export import FORMAT_NAMES, load_format

    study = load_carlancap_layout()
    scene = load_study_scene()
    units = []
    for number in range(n_units):
        unit = study.units[number % len(study.units)]
        pose = replace(unit.pose, yaw_deg=unit.pose.yaw_deg + number)
        units.append(replace(unit, id=f"unit {number}", pose=pose))

    layout = replace(study, units=tuple(units))
    few = replace(study, units=tuple(units[:1]))

    def row(
        name: str, what: str, write: Callable[..., str | bytes]
    ) -> tuple[str, str, str, str]:
        write(few, scene)
        begin_s = time.process_time()
        content = write(layout, scene)
        taken_s = time.process_time() - begin_s
        return name, what, f"{taken_s:.1f}", f"{len(content) / 1.0e6:.2f}"

    rows = []
    for name in FORMAT_NAMES:
        what = f"{n_units} units"
        if name == "dxf":
            what += ", with views"
        rows.append(row(name, what, load_format(name).write))
    return rows


def main(path: Path = Path("results/exports.md")) -> None:
    """Write the table."""
    heads = ("format", "what is written", "processor seconds", "MB")
    lines = [
        "# Sizes and times of exports",
        "",
        (
            "`uv run python tests/support/export_speeds.py` wrote this page."
            " Libraries are loaded before."
        ),
        "",
        *markdown_table(heads, measure_exports()),
    ]
    path.write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
