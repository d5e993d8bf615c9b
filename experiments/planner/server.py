"""The planner's page over HTTP: who may ask, what is answered, how it all ends."""

import asyncio
import json
import re
import secrets
import shutil
import socket
import threading
import time
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager, suppress
from itertools import count
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from geometry.errors import InputError, MissingExtraError, Unquoted, refuse
from geometry.phrases import Phrase

from ..language import mark, tr, tr_error
from ..scene import CAUSES
from ..scene.pictures import junction_chooser
from .background import MAX_IMAGE_BYTES, Background, build_background
from .files import MAX_MAP_BYTES, MapFile
from .numbers import evaluate_command
from .page_files import page_files, page_html
from .plan_files import MAX_PLAN_BYTES, layout_text, read_plan
from .session import Session
from .worker import Cancelled, TaskError

try:
    import uvicorn
    from starlette.applications import Starlette
    from starlette.datastructures import Headers
    from starlette.requests import Request
    from starlette.responses import JSONResponse, Response
    from starlette.routing import Mount, Route, WebSocketRoute
    from starlette.types import ASGIApp, Receive, Scope, Send
    from starlette.websockets import WebSocket, WebSocketDisconnect
except ModuleNotFoundError as error:
    raise MissingExtraError(
        f"place-rsus plan needs the package {error.name}: install place-rsus[plan]"
    ) from None

_MAX_MESSAGE_BYTES = 64_000
_MAX_NAME_BYTES = 500
_STOPPED = mark("it was stopped")
# Of a picture that is drawn while a camera is turned
_WIDEST_PX = 640
# Messages of which not only the newest counts
_EACH = ("problem", "notice", "view")
# Messages for a browser that does not read
_MAX_WAITING = 2000
# The page was closed or is loaded again
_CLOSED_CODES = (1000, 1001, 1005)
# As all other codes: the connection to the page was lost
_LOST_CODE = 1006
_LOCAL = "127.0.0.1"
_ALL_INTERFACES = ("0.0.0.0", "::")
# Until a server has ended
_PATIENCE_S = 2.0
LINGER_S = 8.0
"""After the last page was closed: it may be loaded again."""
LINGER_LOST_S = 180.0
"""After the connection to the last page was lost: the page tries again as long as it is open."""
_MAP_SUFFIXES = (".osm", ".osm.pbf", ".pbf", ".xodr", ".zip")
_IMAGES = "img-src 'self' data: blob:"
_STRICT = (
    f"default-src 'none'; script-src 'self'; style-src 'self'; {_IMAGES}; connect-src"
    " 'self'; frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors"
    " 'self'"
)
# The player's page is one file, as the report is: its own scripts and styles stand in
# it.
_INLINE = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline';"
    f" {_IMAGES}; base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)

_POLICY = "content-security-policy"
_GUARDED = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}


def allowed_hosts(host: str, port: int) -> frozenset[str] | None:
    """Values of the header Host that are answered.

    A page from elsewhere may let its own name lead to this address (DNS rebinding); its
    requests have that name in them.

    Parameters
    ----------
    host : str
        Address at which is listened.
    port : int
        And its port.

    Returns
    -------
    frozenset of str or None
        None: any, where all interfaces listen.
    """
    if host in _ALL_INTERFACES:
        return None
    names = {host}
    if host == _LOCAL:
        names.add("localhost")
    return frozenset(f"{name}:{port}" for name in names)


class Guard:
    """Answers only who has the token, by this very address, from a page of this very server.

    Parameters
    ----------
    app : ASGIApp
        Gets the requests that are answered.
    token : str
        With which the path of every address begins.
    hosts : frozenset of str, optional
        As of :func:`allowed_hosts`.
    """

    def __init__(
        self, app: ASGIApp, *, token: str, hosts: frozenset[str] | None
    ) -> None:
        self._app = app
        self._token = token
        self._hosts = hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        problem = ""
        if scope["type"] != "lifespan":
            problem = self._problem(scope)
        if not problem:
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": problem})
        else:
            refusal = Response(f"{problem}\n", 403, media_type="text/plain")
            await refusal(scope, receive, send)

    def _problem(self, scope: Scope) -> str:
        """Why a request is refused; empty: it is answered."""
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        origin = headers.get("origin", "")
        # Another name that leads to this address: see :func:`allowed_hosts`.
        if self._hosts is not None and host not in self._hosts:
            return tr("another host")
        # Pages from elsewhere can send requests here, but not without their origin.
        is_read = scope["type"] == "http" and scope["method"] in ("GET", "HEAD")
        if (origin or not is_read) and origin != f"http://{host}":
            return tr("another origin")
        # Who has the address that was printed has the token.
        token = ""
        if scope["path"].startswith("/"):
            token = scope["path"].split("/")[1]
        if not secrets.compare_digest(token.encode(), self._token.encode()):
            return tr("no such page; use the address that place-rsus plan printed")
        return ""


class Pages:
    """Answers to addresses below the token: each method is one of :meth:`routes`."""

    def __init__(self, session: Session) -> None:
        self._session = session
        self._numbers = count(1)

    def routes(self) -> list[Route | WebSocketRoute]:
        """All of them."""
        return [
            Route("/", self._answer(self._page)),
            Route("/files/{name}", self._answer(self._file)),
            WebSocketRoute("/live", self._live),
            Route("/layout.json", self._answer(self._layout)),
            Route("/plan.json", self._answer(self._plan)),
            Route("/watch", self._answer(self._watch)),
            Route("/explain", self._answer(self._explain)),
            Route("/private", self._answer(self._private)),
            Route(
                "/background", self._answer(self._background), methods=["GET", "POST"]
            ),
            Route("/seen", self._answer(self._seen)),
            Route("/picture", self._answer(self._picture)),
            Route("/report.zip", self._answer(self._report)),
            Route("/sheet.pdf", self._answer(self._sheet)),
            Route("/open", self._answer(self._open), methods=["POST"]),
            Route("/junctions", self._answer(self._junctions)),
            Route("/import", self._answer(self._import), methods=["POST"]),
        ]

    def _answer(
        self, make: Callable[[Request], Awaitable[Response]]
    ) -> Callable[[Request], Awaitable[Response]]:
        """A route's answer, or the sentence that says why there is none.

        Status 400: the request cannot be met. 409: it was stopped.
        """

        async def answer(request: Request) -> Response:
            response: Response
            try:
                response = await make(request)
            except (InputError, TaskError) as error:
                response = JSONResponse({"problem": tr_error(error)}, 400)
            except Cancelled:
                response = JSONResponse({"problem": tr(_STOPPED)}, 409)
            response.headers.setdefault(_POLICY, _STRICT)
            response.headers.update(_GUARDED)
            return response

        return answer

    async def _page(self, request: Request) -> Response:
        policy = _STRICT
        tiles = self._session.tiles
        # The only other server that the page may ask
        if tiles is not None:
            policy = _STRICT.replace(_IMAGES, f"{_IMAGES} {tiles.origin}")
        return Response(page_html(), media_type="text/html", headers={_POLICY: policy})

    async def _file(self, request: Request) -> Response:
        found = page_files().get(request.path_params["name"])
        if found is None:
            return Response(tr("no such file") + "\n", 404, media_type="text/plain")
        content, media_type = found
        return Response(content, media_type=media_type)

    async def _live(self, socket: WebSocket) -> None:
        """Talk to a browser until it leaves: messages to it, requests of it.

        Each request is answered by "heard" with its number, so that the page knows
        which of its changes the newest state has.
        """
        await socket.accept()
        waiting: asyncio.Queue[dict[str, Any]] = asyncio.Queue(_MAX_WAITING)
        is_lost = asyncio.Event()

        def listen(message: dict[str, Any]) -> None:
            try:
                waiting.put_nowait(message)
            except asyncio.QueueFull:  # it joins again and is sent everything
                is_lost.set()

        sender = asyncio.create_task(_send_all(socket, waiting, is_lost))
        self._session.join(listen)
        code = _LOST_CODE
        try:
            for number in count(1):
                text = await socket.receive_text()
                try:
                    self._handle(text)
                except InputError as error:
                    listen({"type": "problem", "text": tr_error(error)})
                listen({"type": "heard", "number": number})
        except WebSocketDisconnect as ended:
            code = ended.code
        except (
            RuntimeError,
            KeyError,
        ):  # it is closed already, or bytes came in place of text
            pass
        finally:
            self._session.browsers.leave(listen, is_lost=code not in _CLOSED_CODES)
            sender.cancel()

    def _handle(self, text: str) -> None:
        """Carry out a request of a browser; InputError: that cannot be done."""
        if len(text) > _MAX_MESSAGE_BYTES:
            refuse(mark("message"), Phrase("{n} bytes", n=len(text)), mark("fewer"))
        self._session.handle(text.encode())

    async def _layout(self, request: Request) -> Response:
        shown = self._session.shown
        text = layout_text(shown.state, shown.setting.scene)
        return _download(text.encode(), "layout.json", "application/json")

    async def _plan(self, request: Request) -> Response:
        return _download(self._session.plan_text(), "plan.json", "application/json")

    async def _of_run(self, task: str, request: Request) -> Any:
        """Result of a task for the run that is asked for."""
        run_id = request.query_params.get("run", "")
        return await self._session.call(task, self._session.layout(), run_id)

    async def _watch(self, request: Request) -> Response:
        page = await self._of_run("watch", request)
        return Response(page, media_type="text/html", headers={_POLICY: _INLINE})

    async def _private(self, request: Request) -> Response:
        unit_id = request.query_params.get("unit", "")
        return JSONResponse(await self._session.views.private_places(unit_id))

    async def _background(self, request: Request) -> Response:
        """The image below the plan; by POST another one, or with an empty body none.

        An image with a file name is a raster that says where it lies; one without is
        sent with two points that lay it.
        """
        if request.method == "POST":
            name = _file_name(request)
            if name:
                laid: Background | None = await self._received_raster(request, name)
            else:
                laid = await _received_image(request)
            self._session.lay_background(laid)
            return JSONResponse({})
        background = self._session.shown.workspace.background
        if background is None:
            return Response(tr("no image") + "\n", 404, media_type="text/plain")
        return Response(background.image, media_type=background.media_type)

    async def _received_raster(self, request: Request, name: str) -> Background:
        """An image that says itself, or by a world file, where it lies. InputError, TaskError."""
        path = await self._received(request, _plain_name(name, Path(name).suffix))
        world = request.headers.get("x-world", "")[:500]
        crs = request.headers.get("x-crs", "")[:500]
        if world:
            path.with_suffix(".wld").write_text("\n".join(world.split()))
        try:
            background: Background = await self._session.call(
                "lay_raster", str(path), crs
            )
        except TaskError as error:
            raise TaskError(str(error).replace(str(path), name)) from None
        finally:
            _remove(path)
        return background

    async def _explain(self, request: Request) -> Response:
        return JSONResponse(await self._of_run("explain", request))

    async def _seen(self, request: Request) -> Response:
        """What a camera sees while it is aimed, small.

        A problem is an answer like others, and no fault of the page: when it is
        answered, another picture may be wanted, or the unit or the run be gone.
        """
        values = request.query_params
        wanted_px = _whole_number(values, "width", _WIDEST_PX)
        width_px = min(max(wanted_px, 1), _WIDEST_PX)
        frame = _whole_number(values, mark("frame"), -1)
        try:
            found = await self._session.views.camera_picture(
                values.get("unit", ""),
                run_id=values.get("run", ""),
                frame=frame,
                width_px=width_px,
                is_smooth=values.get("smooth") != "0",
            )
        except Cancelled:
            found = {"problem": tr(_STOPPED)}
        except InputError as error:
            found = {"problem": tr_error(error)}
        return JSONResponse(found)

    async def _picture(self, request: Request) -> Response:
        values = request.query_params
        frame = _whole_number(values, mark("frame"), -1)
        layout = self._session.layout()
        unit_id = values.get("unit", "")
        run_id = values.get("run", "")
        picture = await self._session.call("picture", layout, unit_id, run_id, frame)
        return Response(picture, media_type="image/jpeg")

    async def _report(self, request: Request) -> Response:
        layout = self._session.layout()
        command = evaluate_command(self._session.shown.workspace.work.question)
        existing = self._session.existing_ids()
        content = await self._session.call(
            "report", layout, command, existing, is_long=True
        )
        return _download(content, "report.zip", "application/zip")

    async def _sheet(self, request: Request) -> Response:
        layout = self._session.layout()
        existing = self._session.existing_ids()
        content = await self._session.call("sheet", layout, existing, is_long=True)
        return _download(content, "mounting.pdf", "application/pdf")

    async def _open(self, request: Request) -> Response:
        """Open a layout or a plan, or survey a map or a scene, by the suffix of its name.

        Raises InputError or TaskError if it cannot be read; nothing is left of it then.
        """
        name = _file_name(request)
        if name.lower().endswith(".json"):
            plan = read_plan(await _body(request, MAX_PLAN_BYTES), name)
            self._session.open_plan(plan, Path(name).stem)
            return JSONResponse({"opened": [variant.name for variant in plan.variants]})
        suffix = _map_suffix(name)
        path = await self._received(request, _plain_name(name, suffix))
        before = self._session.map_file
        # What cannot be read is not stored; messages name the file as its sender does.
        try:
            file = await self._session.open_file(MapFile(path=path, name=name))
        except BaseException as error:
            _remove(path)
            if isinstance(error, TaskError):
                raise TaskError(str(error).replace(str(path), name)) from None
            raise
        scratch = self._session.shown.workspace.work.scratch
        if before is not None and before.path.parent.parent == scratch:
            # One at a time is stored
            _remove(before.path)
        return _to_choose_from(file)

    async def _junctions(self, request: Request) -> Response:
        """Junctions of the map that the scene is of, or that was sent last."""
        file = self._map_file()
        if not file.found:
            file = await self._session.open_file(file)
        return _to_choose_from(file)

    def _map_file(self) -> MapFile:
        """The map that the scene is of, or that was sent last; InputError: there is none."""
        if self._session.map_file is None:
            refuse(
                mark("map"),
                mark("none"),
                mark("one that was dropped on the page earlier"),
            )
        return self._session.map_file

    async def _import(self, request: Request) -> Response:
        """Go on at a junction of the map that was sent last, or in that scene."""
        sent = self._map_file()
        session = self._session
        junction = (await _body(request, _MAX_NAME_BYTES)).decode(
            "utf-8", errors="replace"
        )
        try:
            if sent.found.get("isScene"):
                await session.open_scene(str(sent.path))
                # The session's file from here on
                session.map_file = None
            else:
                names = {
                    one["id"]: one["name"] for one in sent.found.get("junctions", ())
                }
                if junction not in names:
                    expected = Phrase("one of {names}", names=sent.name)
                    raise InputError(mark("junction"), junction, expected)
                path = str(
                    session.shown.workspace.work.scratch
                    / f"scene-{next(self._numbers)}"
                )
                await session.open_scene(
                    path, names[junction], of=sent, junction=junction
                )
        except TaskError as error:
            plain = str(error)
            if error.cause in CAUSES:
                plain = tr(CAUSES[error.cause])
            raise TaskError(plain.replace(str(sent.path), sent.name)) from None
        return JSONResponse({"scene": session.shown.workspace.title})

    async def _received(self, request: Request, name: str) -> Path:
        """Store a file that is sent, in a folder of its own in the session's folder.

        Raises InputError if it is too large; nothing is left of it then.
        """
        path = (
            self._session.shown.workspace.work.scratch
            / f"received-{next(self._numbers)}"
            / name
        )
        path.parent.mkdir()
        try:
            with path.open("wb") as file:
                async for chunk in _chunks(request, MAX_MAP_BYTES):
                    file.write(chunk)
        except BaseException:
            _remove(path)
            raise
        return path


def _to_choose_from(file: MapFile) -> JSONResponse:
    """What is in a file: a scene, or the junctions of a map with the page to choose one."""
    found = file.found
    record = {
        "map": file.name,
        "name": found["name"],
        "isScene": found["isScene"],
        "junctions": found["junctions"],
    }
    if not found["isScene"]:
        record["chooser"] = junction_chooser(found)
    return JSONResponse(record)


def _file_name(request: Request) -> str:
    """Name of the file that a request sends, as its sender has it; empty: none is said."""
    return unquote(request.headers.get("x-file-name", ""))[:200]


def _map_suffix(name: str) -> str:
    """Suffix of a file with a map or a scene; InputError: it has another one."""
    for suffix in _MAP_SUFFIXES:
        if name.lower().endswith(suffix):
            return suffix
    known = ", ".join([".json", *_MAP_SUFFIXES])
    raise InputError(
        mark("file"), name, Phrase("a name that ends in {ends}", ends=known)
    )


async def _received_image(request: Request) -> Background | None:
    """An image with two points that lay it; None of an empty body. Raises InputError."""
    content = await _body(request, MAX_IMAGE_BYTES)
    points = request.headers.get("x-points", "")[:2000].encode("latin-1", "replace")
    if not content:
        return None
    return build_background(content, points, mark("image"))


def _whole_number(values: Mapping[str, str], name: str, default: int) -> int:
    """A number of a request's query; InputError: it is none."""
    try:
        return int(values.get(name, str(default))[:9])
    except ValueError:
        raise InputError(name, values[name], mark("a whole number")) from None


async def _chunks(request: Request, max_bytes: int) -> AsyncIterator[bytes]:
    """The body of a request in parts; InputError if there is more of it than there may be."""
    n_bytes = 0
    async for chunk in request.stream():
        n_bytes += len(chunk)
        if n_bytes > max_bytes:
            got = Phrase("more than {n:,} bytes", n=max_bytes)
            refuse(mark("file"), got, mark("a smaller one"))
        yield chunk


async def _body(request: Request, max_bytes: int) -> bytes:
    """The whole body of a request; InputError if there is more of it."""
    return b"".join([chunk async for chunk in _chunks(request, max_bytes)])


def _remove(received: Path) -> None:
    """Remove a file that was sent, with its folder."""
    shutil.rmtree(received.parent, ignore_errors=True)


def _plain_name(name: str, suffix: str) -> str:
    """A file's own name as one that is safe to write: scenes that are cut from it are named so.

    Examples
    --------
    >>> _plain_name("../My town: north.osm", ".osm")
    'My_town_north.osm'
    """
    stem = re.sub(r"[^\w-]+", "_", Path(name).name[: -len(suffix)]).strip("_")[:60]
    return (stem or "map") + suffix


async def _send_all(
    socket: WebSocket, waiting: asyncio.Queue[dict[str, Any]], is_lost: asyncio.Event
) -> None:
    """Send what waits, until the browser is lost.

    Of several messages of a kind that wait, such as numbers, only the newest is sent;
    but all of those in ``_EACH``.
    """
    while True:
        messages = [await waiting.get()]
        while not waiting.empty():
            messages.append(waiting.get_nowait())
        # Later messages of a kind take the place of earlier ones.
        newest = {message["type"]: index for index, message in enumerate(messages)}
        for index, message in enumerate(messages):
            if message["type"] in _EACH or newest[message["type"]] == index:
                text = json.dumps(message, separators=(",", ":"), allow_nan=False)
                await socket.send_text(text)
        if is_lost.is_set():
            await socket.close(1013)
            return


def _download(content: bytes, name: str, kind: str) -> Response:
    """Contents of a file that the browser saves."""
    disposition = {"content-disposition": f'attachment; filename="{name}"'}
    return Response(content, media_type=kind, headers=disposition)


def build_app(session: Session, *, token: str, hosts: frozenset[str] | None) -> ASGIApp:
    """The application of a session.

    Parameters
    ----------
    session : Session
        Is started and stopped with it.
    token : str
        With which every address begins.
    hosts : frozenset of str or None
        As of :func:`allowed_hosts`.
    """

    @asynccontextmanager
    async def life(app: Starlette) -> Any:
        session.start()
        yield
        session.stop()

    pages = Mount(f"/{token}", routes=Pages(session).routes())
    inner = Starlette(routes=[pages], lifespan=life)
    return Guard(inner, token=token, hosts=hosts)


class RunningServer:
    """A server in a thread of its own: the main thread waits, and is free to be interrupted.

    Its `address` is that of the page, with its token.

    Parameters
    ----------
    make_session : callable
        Makes the session, in the thread of the event loop.
    host : str
        Address to listen at.
    port : int
        0: one that is free.
    keeps_open : bool
        Go on after the last page was closed; else it ends some seconds later.

    Raises
    ------
    InputError
        The port is taken, or none.
    """

    def __init__(
        self,
        make_session: Callable[[], Session],
        *,
        host: str,
        port: int,
        keeps_open: bool = True,
    ) -> None:
        self.keeps_open = keeps_open
        try:
            self._socket = socket.create_server((host, port))
        except (OSError, OverflowError) as error:
            where = getattr(error, "strerror", None) or error
            raise InputError(
                "--port", Unquoted(f"{host}:{port}: {where}"), "a free port"
            ) from None
        self.port: int = self._socket.getsockname()[1]
        self.host = host
        self.token = secrets.token_urlsafe(24)
        shown = host
        if host in _ALL_INTERFACES:
            shown = _LOCAL
        self.address = f"http://{shown}:{self.port}/{self.token}/"
        self._make_session = make_session
        self.session: Session | None = None
        self._server: uvicorn.Server | None = None
        self._thread = threading.Thread(target=self._run, name="plan", daemon=True)
        self._is_up = threading.Event()
        self._error: BaseException | None = None

    def start(self) -> None:
        """Serve from here on.

        Returns when the address is answered. Raises what the session or the server
        cannot begin with.
        """
        self._thread.start()
        self._is_up.wait()
        if self._error is not None:
            self._socket.close()
            raise self._error

    @property
    def is_alive(self) -> bool:
        """True while it serves."""
        return self._thread.is_alive()

    def wait(self) -> None:
        """Wait until it has ended."""
        while self.is_alive:
            self._thread.join(0.5)

    def stop(self) -> str:
        """End the server and every process that it has started; from any thread.

        Returns
        -------
        str
            Why the plan could not be saved, as a sentence; empty: nothing went wrong.
        """
        if self._server is not None:
            # At once: connections to browsers would stay open for ever.
            self._server.should_exit = True
            self._server.force_exit = True
        if self.session is not None:
            self.session.stop()
        self._thread.join(_PATIENCE_S)
        with suppress(OSError):
            self._socket.close()
        if self.session is None:
            return ""
        return self.session.save_plan()

    def _run(self) -> None:
        try:
            asyncio.run(self._serve())
        except BaseException as error:
            self._error = error
        finally:
            self._is_up.set()

    async def _serve(self) -> None:
        self.session = self._make_session()
        hosts = allowed_hosts(self.host, self.port)
        config = uvicorn.Config(
            build_app(self.session, token=self.token, hosts=hosts),
            log_level="critical",
            access_log=False,
            server_header=False,
            ws="websockets-sansio",
            ws_max_size=2 * _MAX_MESSAGE_BYTES,
            timeout_graceful_shutdown=1,
        )
        self._server = uvicorn.Server(config)
        # The socket takes connections already
        self._is_up.set()
        watching = asyncio.create_task(self._end_when_alone(self.session, self._server))
        await self._server.serve(sockets=[self._socket])
        watching.cancel()

    async def _end_when_alone(self, session: Session, server: uvicorn.Server) -> None:
        """End some seconds after the last page was closed.

        A page that is loaded again comes back within these; one whose connection was
        lost tries for minutes.
        """
        while not self.keeps_open:
            await asyncio.sleep(0.5)
            # Nobody came yet, or somebody is here
            if session.browsers.left_at_s is None:
                continue
            waits_s = LINGER_S
            if session.browsers.is_lost:
                waits_s = LINGER_LOST_S
            if time.monotonic() - session.browsers.left_at_s > waits_s:
                server.should_exit = True
                return
