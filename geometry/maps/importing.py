"""From map files to a scene: read them, choose the junction, cut it out, decide on sites."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import InputError, Unquoted
from ..scene import Scene
from .cut import build_scene, cut_out
from .map_files import ReadingOptions, read_map
from .model import SourceMap
from .site_choice import choose_sites
from .survey import Surveyed, choose_junction, survey_junctions

DEFAULT_RADIUS_M = 80.0
_RADIUS_LIMITS_M = (20.0, 500.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportOptions:
    """What is to be cut out of the maps.

    Attributes
    ----------
    junction : str
        See :func:`geometry.maps.survey.choose_junction`.
    at : (float, float), optional
        The same.
    radius_m : float
        Of what is kept around the junction's middle. [m]
    sites : str
        "auto": poles of the map, or where it has none within the radius every 15 m along the
        kerbs; "map": poles of the map alone; "kerb:SPACING"; or a CSV or GeoJSON file.
    ground_m : float, optional
        See :func:`geometry.maps.cut.cut_out`. [m]
    name : str
        Of the scene; empty: after the file and the junction.
    reading : ReadingOptions
        What files do not say of themselves.
    """

    junction: str = ""
    at: tuple[float, float] | None = None
    radius_m: float = DEFAULT_RADIUS_M
    sites: str = "auto"
    ground_m: float | None = None
    name: str = ""
    reading: ReadingOptions = field(default_factory=ReadingOptions)

    def __post_init__(self) -> None:
        low, high = _RADIUS_LIMITS_M
        if not low <= self.radius_m <= high:
            raise InputError("--radius", self.radius_m, f"metres, {low:g} to {high:g}")
        if self.junction and self.at is not None:
            raise InputError("--at", Unquoted("it beside --junction"), "one of them")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ImportedScene:
    """A scene, and how it came about.

    Attributes
    ----------
    scene : Scene
        What was cut out.
    junctions : tuple of Surveyed
        All of the map, the largest first.
    chosen : Surveyed
        The one that was cut out.
    sources : tuple of str
        Names of the files.
    skipped : tuple of (str, str)
        What was left out or assumed, and why.
    assumed_heights : frozenset of str
        Ids of things whose heights the sources do not say.
    """

    scene: Scene
    junctions: tuple[Surveyed, ...]
    chosen: Surveyed
    sources: tuple[str, ...]
    skipped: tuple[tuple[str, str], ...]
    assumed_heights: frozenset[str]


def read_maps(
    paths: Sequence[Path], reading: ReadingOptions
) -> tuple[list[SourceMap], tuple[Surveyed, ...]]:
    """Read map files, the one with the roads first, and survey its junctions.

    Parameters
    ----------
    paths : sequence of Path
        One of them has roads; the others have buildings and more.
    reading : ReadingOptions
        What files do not say of themselves.

    Returns
    -------
    maps : list of SourceMap
        The map with the roads, then the others as given.
    junctions : tuple of Surveyed
        See :func:`geometry.maps.survey.survey_junctions`.

    Raises
    ------
    InputError
        A file cannot be read, or none or several have roads.
    """
    if not paths:
        raise InputError("FILE", Unquoted("nothing"), "a map: OpenDRIVE or OpenStreetMap")
    maps = [read_map(path, reading) for path in paths]
    with_roads = [source for source in maps if source.lanes]
    if len(with_roads) != 1:
        names = " and ".join(source.name for source in with_roads) or "none"
        where = ", ".join(source.name for source in maps)
        raise InputError(where, Unquoted(f"roads in {names}"), "roads in one of the files")
    roads = with_roads[0]
    return [roads, *(s for s in maps if s is not roads)], survey_junctions(roads)


def import_scene(paths: Sequence[Path], options: ImportOptions) -> ImportedScene:
    """Make a scene of map files.

    Parameters
    ----------
    paths : sequence of Path
        See :func:`read_maps`.
    options : ImportOptions
        What is to be cut out.

    Returns
    -------
    imported : ImportedScene
        At least one arm leads into its junction, and it has a site at least.

    Raises
    ------
    InputError
        A file cannot be read, there is no such junction, no lane leads into it, or nothing there
        can carry a sensor.
    """
    maps, junctions = read_maps(paths, options.reading)
    roads = maps[0]
    chosen = choose_junction(roads, junctions, name=options.junction, at=options.at)
    if not chosen.n_driven:
        raise InputError(
            f"{roads.name}: junction {chosen.junction.id}",
            Unquoted("no lane that leads into it"),
            "a junction that cars drive into",
        )
    surroundings = cut_out(
        maps, chosen.junction, radius_m=options.radius_m, ground_m=options.ground_m
    )
    sites, told = choose_sites(options.sites, surroundings, roads, radius_m=options.radius_m)
    scene = build_scene(
        surroundings,
        name=options.name or f"{Path(roads.name).stem}/{chosen.junction.id}",
        source_crs=_crs_of_results(roads),
        sites=sites,
        radius_m=options.radius_m,
    )
    skipped = [(skip.what, skip.why) for skip in (*surroundings.skipped, *told)]
    if len(junctions) > 1 and not options.junction and options.at is None:
        skipped.append(
            (
                f"{len(junctions) - 1} other junctions of {roads.name}",
                "none was named: the one with the most arms and lanes was taken",
            )
        )
    return ImportedScene(
        scene=scene,
        junctions=junctions,
        chosen=chosen,
        sources=tuple(source.name for source in maps),
        skipped=tuple(skipped),
        assumed_heights=frozenset(t.id for t in surroundings.things if t.is_height_assumed),
    )


def _crs_of_results(roads: SourceMap) -> str:
    """In which results are wanted back: what the file itself uses."""
    return roads.source_crs or roads.crs if roads.crs else ""
