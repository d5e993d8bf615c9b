"""``place-rsus plan``: a page in the browser for planning by hand."""

import signal
import tempfile
import webbrowser
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from geometry.errors import InputError
from placement.compute import Compute
from placement.question import Question, map_options

from ..cli import options
from ..cli.running import begin
from ..language import mark, tr
from ..progress import Interrupted, StageProgress, tell

if TYPE_CHECKING:
    from geometry.scene import Scene
    from placement.candidates import CandidatePose
    from placement.layout import Layout

    from .files import MapFile
    from .plan_files import Plan
    from .server import RunningServer

_OF_ANSWER = ("keep", "within", "force_site")
_ASKED = (
    *options.fields_in(options.MOUNTED, but=_OF_ANSWER),
    "solver",
    "time_limit_s",
    "gap",
    *options.JUDGED,
)
_TAKEN_OVER = (*options.fields_in(options.MOUNTED, but=_OF_ANSWER), *options.JUDGED)
"""Fields that a layout's own question gives the page; how it was looked for is not."""
_LOCAL = "127.0.0.1"


_EXAMPLES = """\b
Examples:
  place-rsus plan
  place-rsus plan --layout carlancap-12 --cases study
  place-rsus plan --scene scene --layout mine.json --save plan.json
  place-rsus plan --scene city.osm --port 8042 --no-open"""


@click.command(cls=options.SectionedCommand, epilog=_EXAMPLES)
@options.layout_option
@options.option(
    "--port",
    type=click.IntRange(min=0, max=65535),
    default=0,
    metavar="N",
    expected="a port, 0 to 65535",
    help="Of the page; default: one that is free.",
)
@options.option(
    "--open/--no-open",
    "opens",
    default=True,
    help="Open the page in the browser.",
)
@options.option(
    "--keep-open",
    is_flag=True,
    help="Go on after the page is closed; else all ends some seconds later.",
)
@options.option(
    "--save",
    type=click.Path(path_type=Path, dir_okay=False),
    metavar="FILE",
    help="Keep the plan in this file, whenever it rests; opened again if it is there.",
)
@options.option(
    "--host",
    default="127.0.0.1",
    is_common=False,
    help="Address to listen at; another one lets others in, see --i-know.",
)
@options.option(
    "--i-know",
    is_flag=True,
    is_common=False,
    needs="host",
    help=(
        "With --host: whoever has the page's address can change the plan and send"
        " files."
    ),
)
@options.option(
    "--tiles",
    default="",
    metavar="ADDRESS",
    help=(
        "Tiles of a map or of aerial pictures behind the plan, such as "
        "https://HOST/{z}/{x}/{y}.png: the browser asks HOST for them, and nothing "
        "else. Default: none, and no request leaves the machine."
    ),
)
@options.option(
    "--tiles-attribution",
    default="",
    metavar="TEXT",
    is_common=False,
    needs="tiles",
    help=(
        "Whose tiles they are, as their server asks; it stands on the plan. Default: "
        "the host's name."
    ),
)
@options.question_options(*_ASKED)
@options.language_option
@options.quiet_option
@options.compute_options(has_cache=True)
@click.pass_obj
def plan(
    progress: StageProgress,
    *,
    layout_names: tuple[str, ...],
    port: int,
    opens: bool,
    keep_open: bool,
    save: Path | None,
    host: str,
    i_know: bool,
    tiles: str,
    tiles_attribution: str,
    question: Question,
    quiet: bool,
    compute: Compute,
) -> None:
    """Plan by hand in the browser: mount sensors, drag them, see at once who is saved.

    The page is served from this computer, to this computer alone, and loads nothing
    from elsewhere but the tiles of a server that --tiles names. Numbers of a drag are
    by the detection table; the evaluator's follow, the same as `evaluate` gives. The
    optimiser proposes what to do next. A layout of a folder of results brings its own
    question. It ends when the page is closed, or by Ctrl-C.
    """
    if host != _LOCAL and not i_know:
        raise click.UsageError(
            f"--host: got {host}; expected --i-know beside it: others could change the"
            " plan"
        )
    question = _question_of(layout_names, question, quiet=quiet)
    asked = question
    tile_server = None
    # Refused before anything is read
    if tiles:
        from .tiles import read_tile_server

        tile_server = read_tile_server(tiles, tiles_attribution)
    question = begin(progress, question, quiet=quiet)
    if save is None:
        progress.kept = "nothing was written"
    else:
        progress.kept = f"the plan is in {save}"
    from geometry.scene_sources import load_scene
    from geometry.writing import check_target
    from placement.evaluator import with_sight
    from placement.question import read_cars
    from placement.setting import build_setting

    from .server import RunningServer
    from .session import Session
    from .tasks import Work

    if save is not None:
        check_target(save)
    if 0.0 < read_cars(question.cars) < 1.0:
        raise InputError(
            "--cars", question.cars, "blind or see: the page shows each run once"
        )
    scene = load_scene(question.scene)
    map_file = _map_file(asked)
    begun = _begun_plan(layout_names, save, scene)
    progress(mark("setting"), 0, 0)
    setting = with_sight(
        build_setting(question, scene, compute=compute), compute=compute
    )
    with tempfile.TemporaryDirectory(prefix="place-rsus-plan-") as folder:
        work = Work(question=question, scratch=Path(folder), compute=compute)

        def make_session() -> Session:
            return Session(
                work,
                setting,
                begun=begun,
                save=save,
                map_file=map_file,
                tiles=tile_server,
            )

        server = RunningServer(
            make_session,
            host=host,
            port=port,
            keeps_open=keep_open,
        )
        progress.stop()
        _serve_page(server, opens=opens, folder=Path(folder))


def _serve_page(server: "RunningServer", *, opens: bool, folder: Path) -> None:
    """Serve until the page is closed or by Ctrl-C; a page that leads to it is in the folder."""
    server.start()
    try:
        ends = tr("Close the page or press Ctrl-C to stop.")
        if server.keeps_open:
            ends = tr("Press Ctrl-C to stop.")
        tell(tr("The page is at {address}", address=server.address) + f"\n{ends}")
        if server.host != _LOCAL:
            warning = tr(
                "--host {host}: anyone who has this address can change the plan.",
                host=server.host,
            )
            tell(warning, err=True)
        if opens:
            webbrowser.open(_redirect(server.address, folder))
        server.wait()
        is_closed = True
    except Interrupted as interrupted:
        if interrupted.signum != signal.SIGINT:
            raise
        is_closed = False
    finally:
        problem = server.stop()
    if problem:
        tell(f"place-rsus: {problem}", err=True)
    saved: list[str] = []
    if server.session is not None:
        saved = server.session.saved_files()
    tell(_last_words(saved, is_closed=is_closed))


def _last_words(saved: Sequence[str], *, is_closed: bool) -> str:
    """Why it has ended, and where the plans are; `is_closed`: the page was, else by Ctrl-C."""
    files = tr(" and ").join(saved)
    if is_closed and saved:
        return tr("The page was closed: ended; the plan is in {files}.", files=files)
    if is_closed:
        return tr("The page was closed: ended.")
    if saved:
        return tr("Ended; the plan is in {files}.", files=files)
    return tr("Ended.")


def _question_of(
    layout_names: Sequence[str], question: Question, *, quiet: bool
) -> Question:
    """The question that the first layout of a folder of results was found for.

    What the command line says counts more; so do all of its words about the scene,
    where it has any. `question` itself where no layout lies in such a folder. Raises
    InputError if the folder's question cannot be read, or has a network, which is a
    program.
    """
    from ..jobs.verify import asked_question
    from ..results.folders import LAYOUT_FILE, MARKER
    from .numbers import question_words

    folders = [
        Path(name).parent
        for name in layout_names
        if Path(name).name in (LAYOUT_FILE, MARKER)
    ]
    for folder in folders:
        found = asked_question(folder)
        if found is None:
            continue
        given = {name for name in _ASKED if options.is_given(name)}
        if given.intersection(options.OF_SCENE):
            given.update(options.OF_SCENE)
        taken = {
            name: getattr(found, name) for name in _TAKEN_OVER if name not in given
        }
        opened = replace(question, **taken)
        if ".onnx" in taken.get("detector", ""):
            expected = "it on the command line: a network is a program"
            where = f"{folder / MARKER}: detector"
            raise InputError(where, found.detector, expected)
        if opened != question and not quiet:
            said = tr(
                "The page uses the question of {folder}: {options}",
                folder=folder,
                options=question_words(opened),
            )
            tell(said, err=True)
        return opened
    return question


def _map_file(question: Question) -> "MapFile | None":
    """The map that a question's scene is cut out of, with its options; None: it names a scene."""
    from geometry.scene_sources import has_scene

    from .files import MapFile

    path = Path(question.scene)
    if not path.is_file() or has_scene(path):
        return None
    known = ("sites", "sites_crs", "keeps_left")
    options = {
        key: value for key, value in map_options(question).items() if key in known
    }
    return MapFile(path=path, name=path.name, options=options)


def _begun_plan(
    layout_names: Sequence[str], save: Path | None, scene: "Scene"
) -> "Plan":
    """The first plan: the saved one, then layouts that it does not have yet.

    Parameters
    ----------
    layout_names : sequence of str
        Of ``--layout``.
    save : Path, optional
        Of ``--save``; it may not exist yet.
    scene : Scene
        In which all must be mountable.

    Raises
    ------
    InputError
        One cannot be read, or not be mounted in this scene.
    """
    from geometry.opening import read_bytes
    from placement.layout import check_layout, find_layout

    from .numbers import key_of
    from .plan import MAX_UNITS, Variant, check_count
    from .plan_files import MAX_PLAN_BYTES, Plan, check_plan, read_plan

    begun = Plan(variants=())
    if save is not None and save.exists():
        begun = read_plan(read_bytes(save, max_bytes=MAX_PLAN_BYTES), str(save))
        begun = check_plan(begun, scene)
    known = {key_of(variant.units) for variant in begun.variants}
    variants = [variant for variant in begun.variants if variant.units]
    for name in layout_names:
        layout = find_layout(name, "--layout", scene=scene)
        check_count(len(layout.units), f"--layout {name}: units", MAX_UNITS)
        check_layout(layout, scene)
        if key_of(layout.units) not in known:
            variants.append(Variant(name=layout.name, units=layout.units))
        if name.endswith(".json"):
            opened = read_plan(read_bytes(Path(name), max_bytes=MAX_PLAN_BYTES), name)
            existing = (*opened.existing, *_existing_beside(name, layout))
            begun = replace(
                begun,
                poles=(*begun.poles, *opened.poles),
                existing=(*begun.existing, *existing),
            )
    return replace(begun, variants=tuple(variants))


def _existing_beside(name: str, layout: "Layout") -> "list[CandidatePose]":
    """Units of a folder's layout that exist, as the summary beside its file says."""
    from geometry.opening import read_text
    from geometry.text_formats import parse_json

    from ..results.folders import LAYOUT_FILE, MARKER
    from .plan_files import read_existing

    summary = Path(name).with_name(MARKER)
    if Path(name).name != LAYOUT_FILE or not summary.is_file():
        return []
    # That it is an object was seen when its question was read.
    document = parse_json(read_text(summary, "JSON"), str(summary), "a summary")
    return read_existing(document, layout.units, str(summary))


def _redirect(address: str, folder: Path) -> str:
    """Address of a file that leads to the page and that only its owner can read.

    Everybody on the machine can read command lines: the token is not for them.
    """
    from geometry.writing import write_atomically

    path = folder / "open.html"
    page = (
        '<!DOCTYPE html><meta charset="utf-8"><title>place-rsus plan</title>'
        '<meta name="referrer" content="no-referrer">'
        f'<meta http-equiv="refresh" content="0; url={address}">'
        f'<a href="{address}">To the page</a>\n'
    )
    write_atomically(path, page, is_private=True)
    return path.as_uri()
