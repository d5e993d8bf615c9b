"""``place-rsus scene``: scenes cut out of maps, shown and checked."""

import sys
from collections.abc import Callable, Sequence
from functools import wraps
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from msgspec import UNSET

from placement.question import read_point

from ..cli import options
from ..cli.running import Call
from ..cli.terminal import listing, sentences, table

if TYPE_CHECKING:
    from geometry.maps.importing import ReadingOptions

    from .run import JunctionRecord, SceneCheckResult, SceneResult, SiteRecord

_MAX_LISTED = 20


def reading_options(command: Callable[..., Any], *, staggered_m: float = 0.0) -> Callable[..., Any]:
    """Add the options about facts that files do not state; the command gets one `reading`."""

    @wraps(command)
    def with_reading(*args: Any, **values: Any) -> Any:
        from geometry.maps.importing import ReadingOptions

        side = values.pop("driving_side")
        names = ("unit", "up", "class_name", "crs", "layer", "offset_m", "staggered_m")
        reading = ReadingOptions(
            keeps_left=None if side == "map" else side == "left",
            **{name: values.pop(name) for name in names},
        )
        return command(*args, reading=reading, **values)

    offset = {"type": lambda text: read_point(text, "--offset")}
    staggered = {"default": staggered_m}
    return options.from_table("reading", offset_m=offset, staggered_m=staggered)(with_reading)


@click.group()
def scene() -> None:
    """Scenes: cut out of maps, looked at, checked.

    A scene is a junction, its surroundings, and the sites at which sensors may be mounted; every
    command about a junction takes one with --scene.
    """


@scene.command("import", epilog=options.EXAMPLES["scene-import"])
@click.argument("files", nargs=-1, metavar="FILE...")
@options.from_table("scene-import", at={"type": lambda text: read_point(text, "--at")})
@reading_options
@options.option(
    "-o", "--out", type=click.Path(path_type=Path), required=True, help="Folder, or .zip file."
)
@options.calling
def import_(call: Call, /, *, files: tuple[str, ...], bbox: str, out: Path, **cut: Any) -> None:
    """Make a scene of map files, around one junction.

    Roads come from OpenDRIVE (.xodr), OpenStreetMap (.osm, .osm.pbf), Lanelet2 (.osm) or CommonRoad
    (.xml); buildings and other things
    from these, GeoJSON, GeoPackage, Shapefile, CityJSON, CityGML, meshes (glTF, OBJ, PLY, STL) and
    point clouds (LAS, LAZ, PCD). Where several junctions are in the map and none is named, the one
    with the most arms is taken; `scene show FILE` lists them.
    """
    call.start()
    from geometry.maps.importing import ImportOptions

    from . import run

    cut_out = ImportOptions(**cut)
    summary = run.run_import(files, cut_out, bbox=bbox, out=out, progress=call.progress)
    call.print(summary, lambda: scene_text(summary))


@scene.command(epilog=options.EXAMPLES["scene-show"])
@click.argument("paths", nargs=-1, metavar="[SCENE | FILE...]")
@reading_options
@options.from_table("scene-show")
@options.calling
def show(
    call: Call, *, paths: tuple[str, ...], reading: "ReadingOptions", out: Path | None, sort: str
) -> None:
    """Show a scene or a map: arms, lanes, sites, things, and what was left out and why."""
    call.start()
    from . import run

    summary = run.run_show(paths, reading, out=out, progress=call.progress, sort=sort)
    call.print(summary, lambda: scene_text(summary))


@scene.command(epilog=options.EXAMPLES["scene-check"])
@click.argument("path", metavar="[SCENE]", default="")
@options.calling
def check(call: Call, *, path: str) -> None:
    """Look for what may be wrong: holes, floating or overlapping buildings, sites inside walls."""
    call.start()
    from . import run

    summary = run.run_check(path, progress=call.progress)
    call.print(summary, lambda: findings_text(summary))
    if not summary.is_sound:
        sys.exit(1)


def scene_text(summary: "SceneResult") -> str:
    """Summary of a scene or a map for the terminal."""
    side = "left" if summary.keeps_left else "right"
    lines = sentences(
        f"{summary.name}: {_count(len(summary.junctions), 'junction')}, "
        f"{_count(summary.buildings, 'building')}, {_count(summary.things, 'thing')} in all, "
        f"{_count(summary.sites, 'site')}, {_count(summary.crosswalks, 'crosswalk')}; "
        f"traffic keeps {side}; coordinates: {summary.crs or 'of no known place'}"
    )
    lines += ["", *_junction_lines(summary.junctions)]
    if summary.site_list is not UNSET:
        lines += ["", *_site_lines(summary.site_list)]
    skipped = summary.skipped
    if skipped:
        lines += ["", "Left out, or assumed:"]
        left_out = (f"{entry.what}: {entry.why}" for entry in skipped[:_MAX_LISTED])
        lines += [*sentences(*left_out, indent=2, hanging=2), *_more(len(skipped))]
    if summary.written is not UNSET:
        lines += ["", f"Written to {summary.written}."]
    return "\n".join(lines)


def findings_text(summary: "SceneCheckResult") -> str:
    """Findings about a scene for the terminal."""
    if not summary.findings:
        return f"{summary.name}: nothing found."
    findings = (f"{one.level}: {one.what}: {one.why}" for one in summary.findings)
    return "\n".join([f"{summary.name}:", *sentences(*findings, indent=2, hanging=2)])


def _junction_lines(junctions: "Sequence[JunctionRecord]") -> list[str]:
    if not junctions:
        return ["  no junctions"]
    if len(junctions) == 1 and junctions[0].arm_list is not UNSET:
        arms = [
            [arm.name, str(arm.lanes_in), str(arm.lanes_out), str(arm.parking_lanes)]
            for arm in junctions[0].arm_list
        ]
        return table(["arm", "lanes in", "lanes out", "parking"], arms)
    heads = ["junction", "arms", "lanes", "signals", "crossings", "x", "y"]
    rows = [
        [one.id, *("-" if count is UNSET else str(count) for count in counts), *place]
        for one in junctions[:_MAX_LISTED]
        for counts in [(one.arms, one.lanes, one.signals, one.crossings)]
        for place in [(f"{one.x_m:.6f}", f"{one.y_m:.6f}")]
    ]
    names = [f"{at}. {one.name}" for at, one in enumerate(junctions[:_MAX_LISTED], start=1)]
    return [*listing(heads, rows, names), *_more(len(junctions))]


def _site_lines(sites: "Sequence[SiteRecord]") -> list[str]:
    heads = ["site", "kind", "x m", "y m", "mount m", "units"]
    rows = [
        [site.id, site.kind, f"{site.x_m:.3f}", f"{site.y_m:.3f}", mount, str(site.capacity_units)]
        for site in sites[:_MAX_LISTED]
        for mount in ["{:g} to {:g}".format(*site.height_range_m)]
    ]
    return [*listing(heads, rows), *_more(len(sites))]


def _more(count: int) -> list[str]:
    left = count - _MAX_LISTED
    return [f"  and {left} more: --json"] if left > 0 else []


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
