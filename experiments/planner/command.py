"""``place-rsus plan``: a page in the browser for planning by hand."""

import signal
import tempfile
import webbrowser
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from placement.compute import Compute
from placement.question import Question, map_options

from ..cli import options
from ..cli.running import begin
from ..language import mark, tr
from ..progress import Interrupted, StageProgress, tell

if TYPE_CHECKING:
    from geometry.scene import Scene

    from .plan import Plan
    from .server import RunningServer
    from .session import MapFile

_ASKED = (
    *options.fields_in(options.MOUNTED, but=("keep", "within", "force_site")),
    *("solver", "time_limit_s", "gap"),
    *options.JUDGED,
)
_LOCAL = "127.0.0.1"


@click.command(cls=options.SectionedCommand, epilog=options.EXAMPLES["plan"])
@options.layout_option
@options.from_table("plan")
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

    The page is served from this computer, to this computer alone, and loads nothing from
    elsewhere but the tiles of a server that --tiles names.
    Numbers of a drag are by the detection table; the evaluator's follow, the same as `evaluate`
    gives. The optimiser proposes what to do next. It ends when the page is closed, or by Ctrl-C.
    """
    if host != _LOCAL and not i_know:
        raise click.UsageError(
            f"--host: got {host}; expected --i-know beside it: others could change the plan"
        )
    asked = question
    tile_server = None
    if tiles:  # refused before anything is read
        from .numbers import read_tile_server

        tile_server = read_tile_server(tiles, tiles_attribution)
    question = begin(progress, question, quiet=quiet)
    progress.kept = "nothing was written" if save is None else f"the plan is in {save}"
    from geometry.errors import InputError
    from geometry.files import check_target
    from geometry.scene_files import load_scene
    from placement.evaluator import with_sight
    from placement.question import read_cars
    from placement.setting import build_setting

    from .server import RunningServer
    from .session import Session
    from .tasks import Work

    if save is not None:
        check_target(save)
    if 0.0 < read_cars(question.cars) < 1.0:
        raise InputError("--cars", question.cars, "blind or see: the page tells each run once")
    scene, map_file = load_scene(question.scene), _map_file(asked)
    begun = _begun_plan(layout_names, save, scene)
    progress(mark("setting"), 0, 0)
    setting = with_sight(build_setting(question, scene, compute=compute), compute=compute)
    with tempfile.TemporaryDirectory(prefix="place-rsus-plan-") as folder:
        work = Work(question=question, scratch=Path(folder), compute=compute)
        server = RunningServer(
            lambda: Session(
                work, setting, begun=begun, save=save, map_file=map_file, tiles=tile_server
            ),
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
        ends = (
            tr("Ctrl-C ends it.")
            if server.keeps_open
            else tr("It ends when the page is closed, or Ctrl-C.")
        )
        tell(tr("The page is at {address}", address=server.address) + f"\n{ends}")
        if server.host != _LOCAL:
            tell(
                tr(
                    "--host {host}: whoever has this address can change the plan.", host=server.host
                ),
                err=True,
            )
        if opens:
            webbrowser.open(_redirect(server.address, folder))
        server.wait()
        ended = tr("The page was closed: ended.")
        ended_saved = mark("The page was closed: ended; the plan is in {files}.")
    except Interrupted as interrupted:
        if interrupted.signum != signal.SIGINT:
            raise
        ended = tr("Ended.")
        ended_saved = mark("Ended; the plan is in {files}.")
    finally:
        problem = server.stop()
    if problem:
        tell(f"place-rsus: {problem}", err=True)
    saved = [] if server.session is None else server.session.saved_files()
    if saved:
        ended = tr(ended_saved, files=tr(" and ").join(saved))
    tell(ended)


def _map_file(question: Question) -> "MapFile | None":
    """The map that a question's scene is cut out of, with its options; None: it names a scene."""
    from geometry.scene_files import has_scene

    from .session import MapFile

    path = Path(question.scene)
    if not path.is_file() or has_scene(path):
        return None
    given = map_options(question)
    options = {key: given[key] for key in given.keys() & {"sites", "keeps_left"}}
    return MapFile(path=path, name=path.name, options=options)


def _begun_plan(layout_names: Sequence[str], save: Path | None, scene: "Scene") -> "Plan":
    """The first plan: the saved one, then layouts that it does not have yet."""
    from geometry.files import read_bytes
    from placement.layout import check_layout, find_layout

    from .numbers import key_of
    from .plan import MAX_PLAN_BYTES, MAX_UNITS, Plan, Variant, check_count, check_plan, read_plan

    begun = Plan(variants=())
    if save is not None and save.exists():
        begun = read_plan(read_bytes(save, max_bytes=MAX_PLAN_BYTES), str(save))
        check_plan(begun, scene)
    known = {key_of(variant.units) for variant in begun.variants}
    variants = [variant for variant in begun.variants if variant.units]
    for name in layout_names:
        layout = find_layout(name, "--layout")
        check_count(len(layout.units), f"--layout {name}: units", MAX_UNITS)
        check_layout(layout, scene)
        if key_of(layout.units) not in known:
            variants.append(Variant(name=layout.name, units=layout.units))
        if name.endswith(".json"):
            opened = read_plan(read_bytes(Path(name), max_bytes=MAX_PLAN_BYTES), name)
            begun = replace(begun, poles=(*begun.poles, *opened.poles))
    return replace(begun, variants=tuple(variants))


def _redirect(address: str, folder: Path) -> str:
    """Address of a file that leads to the page and that only its owner can read.

    Everybody on the machine can read command lines: the token is not for them.
    """
    from geometry.files import write_atomically

    path = folder / "open.html"
    page = (
        f'<!DOCTYPE html><meta charset="utf-8"><title>place-rsus plan</title>'
        f'<meta name="referrer" content="no-referrer">'
        f'<meta http-equiv="refresh" content="0; url={address}">'
        f'<a href="{address}">To the page</a>\n'
    )
    write_atomically(path, page, is_private=True)
    return path.as_uri()
