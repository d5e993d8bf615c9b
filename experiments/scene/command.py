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


def _at(text: str) -> tuple[float, float]:
    """Two numbers of ``--at``, in the coordinates of the file."""
    return read_point(text, "--at")


def reading_options(
    command: Callable[..., Any], *, staggered_m: float = 0.0
) -> Callable[..., Any]:
    """Add the options about facts that files do not state.

    The command gets one `reading`.
    """

    @wraps(command)
    def with_reading(*args: Any, **values: Any) -> Any:
        from geometry.maps.importing import ReadingOptions

        side = values.pop("driving_side")
        names = ("unit", "up", "class_name", "staggered_m")
        reading = ReadingOptions(
            keeps_left=None if side == "map" else side == "left",
            **{name: values.pop(name) for name in names},
        )
        return command(*args, reading=reading, **values)

    add = options.combined(
        options.option(
            "--unit",
            type=click.Choice(["m", "km", "cm", "mm", "ft", "in"]),
            is_common=False,
            help="Of meshes whose format does not say (OBJ, PLY, STL).",
        ),
        options.option(
            "--up",
            type=click.Choice(["x", "y", "z", "-x", "-y", "-z"]),
            is_common=False,
            help="Axis of meshes that points up, where the format does not say.",
        ),
        options.option(
            "--class",
            "class_name",
            type=click.Choice(["building", "wall", "vegetation"]),
            default="building",
            is_common=False,
            help="Of meshes, point clouds and footprints that do not say.",
        ),
        options.option(
            "--driving-side",
            type=click.Choice(["map", "left", "right"]),
            default="map",
            is_common=False,
            help="On which traffic keeps; map: as it says or shows.",
        ),
        options.option(
            "--staggered",
            "staggered_m",
            type=click.FloatRange(min=0.0, max=60.0),
            default=staggered_m,
            metavar="METRES",
            is_common=False,
            expected="metres, 0 to 60",
            help=(
                "Two side roads that meet a road of OpenStreetMap from either side, "
                "no farther apart, are one junction. All roads that meet within 25 m "
                "are."
            ),
        ),
    )
    return add(with_reading)


@click.group()
def scene() -> None:
    """Scenes: cut out of maps, looked at, checked.

    A scene is a junction, its surroundings, and the sites at which sensors may be
    mounted; every command about a junction takes one with --scene.
    """


sites_crs_option = options.option(
    "--sites-crs",
    default="",
    metavar="CRS",
    is_common=False,
    help=(
        "Of x and y in the list of --sites, where its file does not say: EPSG:25832 "
        "or another that pyproj knows; default: that of the map, or the only one in "
        "use there that fits."
    ),
)
_IMPORT_EXAMPLES = """\b
Examples:
  place-rsus scene import city.osm -o scene
  place-rsus scene import city.osm --junction "Mill Lane / High St" -o scene
  place-rsus scene import town.xodr --junction 189 -o scene.zip
  place-rsus scene import city.osm.pbf --at 13.4412,52.4771 -o scene
  place-rsus scene import roads.xodr houses.gml --sites poles.csv -o scene
  place-rsus scene import roads.xodr scan.laz --class vegetation -o scene
  place-rsus scene import town05 -o scene          the study's junction
  place-rsus --scene scene --budget 3              and then"""


@scene.command("import", epilog=_IMPORT_EXAMPLES)
@click.argument("files", nargs=-1, metavar="FILE...")
@options.option(
    "--junction",
    default="",
    metavar="ID",
    help='Id, name ("A Street / B Street") or part of it.',
)
@options.option(
    "--at",
    type=_at,
    metavar="X,Y",
    expected="two numbers: X,Y",
    help=(
        "A point near the junction, in the file's own coordinates: longitude,latitude"
        " or metres."
    ),
)
@options.option(
    "--sites",
    default="auto",
    metavar="WHERE",
    help=(
        "map: its lamps, signals and poles; kerb:15: every 15 m along the kerbs; a "
        "list (CSV, GeoJSON, GeoPackage, Shapefile); auto: map, but for low sign posts "
        "and poles of other junctions, and kerb:15 where none is within 25 m."
    ),
)
@sites_crs_option
@options.option(
    "--terrain",
    type=click.Path(path_type=Path),
    metavar="DEM",
    help=(
        "Heights of the ground: a GeoTIFF (extra: terrain). By default those of the"
        " maps."
    ),
)
@options.option(
    "--name",
    default="",
    metavar="NAME",
    help="Of the scene.",
)
@options.option(
    "--bbox",
    default="",
    metavar="W,S,E,N",
    help="Fetch OpenStreetMap there instead of a file (extra: online).",
)
@reading_options
@options.option(
    "-o",
    "--out",
    type=click.Path(path_type=Path),
    required=True,
    help="Folder, or .zip file.",
)
@options.calling
def import_(
    call: Call, /, *, files: tuple[str, ...], bbox: str, out: Path, **cut: Any
) -> None:
    """Make a scene of map files, around one junction.

    Roads come from OpenDRIVE (.xodr), OpenStreetMap (.osm, .osm.pbf), Lanelet2 (.osm)
    or CommonRoad (.xml); buildings and other things from these, GeoJSON, GeoPackage,
    Shapefile, CityJSON, CityGML, meshes (glTF, OBJ, PLY, STL) and point clouds (LAS,
    LAZ). Where several junctions are in the map and none is named, the one with
    the most arms is taken; `scene show FILE` lists them.
    """
    call.start()
    from geometry.maps.importing import ImportOptions

    from . import run

    cut_out = ImportOptions(**cut)
    summary = run.run_import(files, cut_out, bbox=bbox, out=out, progress=call.progress)
    call.print(summary, lambda: scene_text(summary))


_SHOW_EXAMPLES = """\b
Examples:
  place-rsus scene show                            the study's junction
  place-rsus scene show scene --out pictures
  place-rsus scene show city.osm --sort signals    all junctions of a map
  place-rsus scene show city.osm --out pictures    .. drawn with their names
  place-rsus scene show city.osm --json --quiet | jq .junctions"""


@scene.command(epilog=_SHOW_EXAMPLES)
@click.argument("paths", nargs=-1, metavar="[SCENE | FILE...]")
@reading_options
@options.option(
    "--out",
    type=click.Path(path_type=Path),
    help=(
        "Folder for plan.png; of a map for junctions.html, to choose one; else none."
    ),
)
@options.option(
    "--sort",
    type=click.Choice(["arms", "lanes", "signals", "crossings", "name"]),
    default="arms",
    help="Of the junctions of a map: the most first, or by name.",
)
@options.calling
def show(
    call: Call,
    *,
    paths: tuple[str, ...],
    reading: "ReadingOptions",
    out: Path | None,
    sort: str,
) -> None:
    """Show a scene or a map.

    Arms, lanes, sites, things, and what was left out and why.
    """
    call.start()
    from . import run

    summary = run.run_show(paths, reading, out=out, progress=call.progress, sort=sort)
    call.print(summary, lambda: scene_text(summary))


_CHECK_EXAMPLES = """\b
Examples:
  place-rsus scene check scene
  place-rsus scene check scene.zip --json --quiet | jq .findings

Exit codes: 0 no errors (there may be warnings), 1 errors, 2 the input is wrong."""


@scene.command(epilog=_CHECK_EXAMPLES)
@click.argument("path", metavar="[SCENE]", default="")
@options.calling
def check(call: Call, *, path: str) -> None:
    """Look for what may be wrong.

    Holes, floating or overlapping buildings, sites inside walls.
    """
    call.start()
    from . import run

    summary = run.run_check(path, progress=call.progress)
    call.print(summary, lambda: findings_text(summary))
    if not summary.is_sound:
        sys.exit(1)


def scene_text(summary: "SceneResult") -> str:
    """Summary of a scene or a map for the terminal."""
    if summary.keeps_left:
        side = "left"
    else:
        side = "right"
    lines = sentences(
        f"{summary.name}: {_count(len(summary.junctions), 'junction')},"
        f" {_count(summary.buildings, 'building')},"
        f" {_count(summary.things, 'thing')} in all, {_count(summary.sites, 'site')},"
        f" {_count(summary.crosswalks, 'crosswalk')}; traffic keeps {side};"
        f" coordinates: {summary.crs or 'of no known place'}"
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
    """The arms of the only junction, or the junctions of a map."""
    if not junctions:
        return ["  no junctions"]
    if len(junctions) == 1 and junctions[0].arm_list is not UNSET:
        arms = [
            [
                arm.name,
                str(arm.lanes_in),
                str(arm.lanes_out),
                str(arm.parking_lanes),
                str(arm.bus_lanes),
            ]
            for arm in junctions[0].arm_list
        ]
        heads = ["arm", "lanes in", "lanes out", "parking", "bus"]
        return table(heads, arms)
    heads = ["junction", "arms", "lanes", "signals", "crossings", "x", "y"]
    rows = [
        [one.id, *("-" if count is UNSET else str(count) for count in counts), *place]
        for one in junctions[:_MAX_LISTED]
        for counts in [(one.arms, one.lanes, one.signals, one.crossings)]
        for place in [(f"{one.x_m:.6f}", f"{one.y_m:.6f}")]
    ]
    names = [
        f"{at}. {one.name}" for at, one in enumerate(junctions[:_MAX_LISTED], start=1)
    ]
    return [*listing(heads, rows, names), *_more(len(junctions))]


def _site_lines(sites: "Sequence[SiteRecord]") -> list[str]:
    heads = ["site", "kind", "x m", "y m", "mount m", "units"]
    rows = [
        [
            site.id,
            site.kind,
            f"{site.x_m:.3f}",
            f"{site.y_m:.3f}",
            mount,
            str(site.capacity_units),
        ]
        for site in sites[:_MAX_LISTED]
        for mount in ["{:g} to {:g}".format(*site.height_range_m)]
    ]
    return [*listing(heads, rows), *_more(len(sites))]


def _more(count: int) -> list[str]:
    left = count - _MAX_LISTED
    if left > 0:
        return [f"  and {left} more: --json"]
    return []


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"
