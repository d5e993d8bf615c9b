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
from functools import cache
from importlib.resources import files
from itertools import count
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from geometry.errors import InputError, MissingExtraError, Unquoted, refuse
from geometry.phrases import Phrase

from ..language import mark, tr, tr_error, words_of
from ..report.page import page_environment
from ..scene import CAUSES
from ..scene.pictures import junction_chooser
from .numbers import evaluate_command, layout_text
from .plan import MAX_IMAGE_BYTES, MAX_PLAN_BYTES, build_background, read_plan
from .session import MAX_MAP_BYTES, MapFile, Session
from .tasks import Cancelled, TaskError

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
_WIDEST_PX = 640  # of a picture that is drawn while a camera is turned
_EACH = ("problem", "notice", "view")  # messages of which not only the newest counts
_MAX_WAITING = 2000  # messages for a browser that does not read
_CLOSED_CODES = (1000, 1001, 1005)  # the page was closed or is loaded again; others: it was lost
_PATIENCE_S = 2.0  # until a server has ended
LINGER_S = 8.0
"""After the last page was closed: it may be loaded again."""
LINGER_LOST_S = 180.0
"""After the connection to the last page was lost: the page tries again as long as it is open."""
_MAP_SUFFIXES = (".osm", ".osm.pbf", ".pbf", ".osm.gz", ".osm.bz2", ".xodr", ".zip")
_IMAGES = "img-src 'self' data: blob:"
_STRICT = (
    f"default-src 'none'; script-src 'self'; style-src 'self'; {_IMAGES}; connect-src 'self'; "
    "frame-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)
# The player's page is one file, as the report is: its own scripts and styles stand in it.
_INLINE = (
    f"default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; {_IMAGES}; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'self'"
)

_POLICY = "content-security-policy"
_GUARDED = {
    "x-content-type-options": "nosniff",
    "referrer-policy": "no-referrer",
    "cross-origin-resource-policy": "same-origin",
    "cache-control": "no-store",
}


def allowed_hosts(host: str, port: int) -> frozenset[str] | None:
    """Values of the header Host that are answered; None: any, where all interfaces listen."""
    if host in ("0.0.0.0", "::"):
        return None
    names = {host, "127.0.0.1", "localhost"} if host == "127.0.0.1" else {host}
    return frozenset(f"{name}:{port}" for name in names)


class Guard:
    """Answers only who has the token, by this very address, from a page of this very server."""

    def __init__(self, app: ASGIApp, *, token: str, hosts: frozenset[str] | None) -> None:
        self._app, self._token, self._hosts = app, token, hosts

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on, or refuse it."""
        problem = "" if scope["type"] == "lifespan" else self._problem(scope)
        if not problem:
            await self._app(scope, receive, send)
        elif scope["type"] == "websocket":
            await send({"type": "websocket.close", "code": 1008, "reason": problem})
        else:
            await Response(f"{problem}\n", 403, media_type="text/plain")(scope, receive, send)

    def _problem(self, scope: Scope) -> str:
        headers = Headers(scope=scope)
        host, origin = headers.get("host", ""), headers.get("origin", "")
        if self._hosts is not None and host not in self._hosts:
            return tr("another host")
        is_read = scope["type"] == "http" and scope["method"] in ("GET", "HEAD")
        if (origin or not is_read) and origin != f"http://{host}":
            return tr("another origin")
        token = scope["path"].split("/")[1] if scope["path"].startswith("/") else ""
        if not secrets.compare_digest(token.encode(), self._token.encode()):
            return tr("no such page; the address is the one that place-rsus plan has printed")
        return ""


_SAID = re.compile(r'\btr(?:n\(("(?:[^"\\]|\\.)*"), |\()("(?:[^"\\]|\\.)*")')


@cache
def page_messages() -> list[tuple[str, str]]:
    """What the page's scripts say by ``tr``, or by ``trn`` for one and for many (else "")."""
    scripts = (text.decode() for name, (text, _) in page_files().items() if name.endswith(".js"))
    said = (found.groups('""') for script in scripts for found in _SAID.finditer(script))
    return sorted({(json.loads(one), json.loads(many)) for one, many in said})


def page_html() -> str:
    """The page in the language that is spoken, with all that its scripts say."""
    source = (files("experiments.planner") / "page" / "index.html.j2").read_text(encoding="utf-8")
    page: str = page_environment().from_string(source).render(own_words=words_of(page_messages()))
    return page


@cache
def page_files() -> dict[str, tuple[bytes, str]]:
    """Files of the page by name: content and media type; ``shared.js`` has the report's scripts."""
    page = files("experiments.planner") / "page"
    kinds = {".css": "text/css", ".js": "text/javascript"}
    found = {
        item.name: (item.read_bytes(), kinds[Path(item.name).suffix])
        for item in page.iterdir()
        if Path(item.name).suffix in kinds
    }
    report = files("experiments.report") / "templates"
    scripts = ("words.js", "run_numbers.js", "plan_drawing.js")
    shared = [(report / name).read_bytes() for name in scripts]
    exported = b"export { element, drawGround, drawScale, addPatterns, MARKS, bodyCorners, "
    exported += b"wedgeCorners, points, unpackBits, stretches, seconds, say, inWords };\n"
    of_maps = files("experiments.scene")
    script = (of_maps / "junction_map.js").read_bytes() + b"\nexport { openJunctionMap };\n"
    found["junction_map.js"] = (script, kinds[".js"])
    found["junction_map.css"] = ((of_maps / "junction_map.css").read_bytes(), kinds[".css"])
    found["shared.js"] = (b"\n".join([*shared, exported]), "text/javascript")
    return found


class Pages:
    """Answers to addresses below the token."""

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
            Route("/background", self._answer(self._background), methods=["GET", "POST"]),
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
        """An answer, or the sentence that says why there is none."""

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
        tiles = self._session.tiles
        policy = _STRICT.replace(_IMAGES, f"{_IMAGES} {tiles.origin}") if tiles else _STRICT
        return Response(page_html(), media_type="text/html", headers={_POLICY: policy})

    async def _file(self, request: Request) -> Response:
        found = page_files().get(request.path_params["name"])
        if found is None:
            return Response(tr("no such file") + "\n", 404, media_type="text/plain")
        return Response(found[0], media_type=found[1])

    async def _live(self, socket: WebSocket) -> None:
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
        code = 1006
        try:
            for number in count(1):
                text = await socket.receive_text()
                try:
                    if len(text) > _MAX_MESSAGE_BYTES:
                        refuse(mark("message"), Phrase("{n} bytes", n=len(text)), mark("fewer"))
                    self._session.handle(text.encode())
                except InputError as error:
                    listen({"type": "problem", "text": tr_error(error)})
                listen({"type": "heard", "number": number})
        except WebSocketDisconnect as ended:
            code = ended.code
        except (RuntimeError, KeyError):  # it is closed already, or bytes came in place of text
            pass
        finally:
            self._session.leave(listen, is_lost=code not in _CLOSED_CODES)
            sender.cancel()

    async def _layout(self, request: Request) -> Response:
        text = layout_text(self._session.history.state, self._session.setting.scene)
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
        return JSONResponse(await self._session.private_view(request.query_params.get("unit", "")))

    async def _background(self, request: Request) -> Response:
        """The image below the plan; by POST another one, or with an empty body none."""
        session = self._session
        name = unquote(request.headers.get("x-file-name", ""))[:200]
        if request.method == "POST" and name:  # it says itself, or a world file, where it lies
            path = await self._received(request, _plain_name(name, Path(name).suffix))
            world, crs = (request.headers.get(f"x-{key}", "")[:500] for key in ("world", "crs"))
            if world:
                path.with_suffix(".wld").write_text("\n".join(world.split()))
            try:
                session.lay_background(await session.call("lay_raster", str(path), crs))
            except TaskError as error:
                raise TaskError(str(error).replace(str(path), name)) from None
            finally:
                _remove(path)
            return JSONResponse({})
        if request.method == "POST":
            content = await _body(request, MAX_IMAGE_BYTES)
            points = request.headers.get("x-points", "")[:2000].encode("latin-1", "replace")
            session.lay_background(
                build_background(content, points, mark("image")) if content else None
            )
            return JSONResponse({})
        background = session.workspace.background
        if background is None:
            return Response(tr("no image") + "\n", 404, media_type="text/plain")
        return Response(background.image, media_type=background.media_type)

    async def _explain(self, request: Request) -> Response:
        return JSONResponse(await self._of_run("explain", request))

    async def _seen(self, request: Request) -> Response:
        """What a camera sees while it is aimed, small; or a problem, which is no fault of the page.

        When it is answered, another one may be wanted, or the unit or the run be gone.
        """
        values = request.query_params
        width_px = min(max(_whole_number(values, "width", _WIDEST_PX), 1), _WIDEST_PX)
        frame = _whole_number(values, mark("frame"), -1)
        try:
            found = await self._session.camera_picture(
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
        asked = self._session.layout(), values.get("unit", ""), values.get("run", ""), frame
        picture = await self._session.call("picture", *asked)
        return Response(picture, media_type="image/jpeg")

    async def _report(self, request: Request) -> Response:
        asked = self._session.layout(), evaluate_command(self._session.work.question)
        content = await self._session.call("report", *asked, is_long=True)
        return _download(content, "report.zip", "application/zip")

    async def _sheet(self, request: Request) -> Response:
        content = await self._session.call("sheet", self._session.layout(), is_long=True)
        return _download(content, "mounting.pdf", "application/pdf")

    async def _open(self, request: Request) -> Response:
        """Open a layout or a plan, or survey a map or a scene, by the suffix of its name."""
        name = unquote(request.headers.get("x-file-name", ""))[:200]
        lower = name.lower()
        if lower.endswith(".json"):
            plan = read_plan(await _body(request, MAX_PLAN_BYTES), name)
            self._session.open_plan(plan, Path(name).stem)
            return JSONResponse({"opened": [variant.name for variant in plan.variants]})
        suffix = next((end for end in _MAP_SUFFIXES if lower.endswith(end)), None)
        if suffix is None:
            known = ", ".join([".json", *_MAP_SUFFIXES])
            raise InputError(mark("file"), name, Phrase("a name that ends in {ends}", ends=known))
        path = await self._received(request, _plain_name(name, suffix))
        before = self._session.map_file
        try:
            file = await self._session.open_file(MapFile(path=path, name=name))
        except BaseException as error:
            _remove(path)
            if isinstance(error, TaskError):
                raise TaskError(str(error).replace(str(path), name)) from None
            raise
        if before is not None and before.path.parent.parent == self._session.work.scratch:
            _remove(before.path)  # one at a time is stored
        return _to_choose_from(file)

    async def _junctions(self, request: Request) -> Response:
        """Junctions of the map that the scene is of, or that was sent last."""
        file = self._map_file()
        return _to_choose_from(await self._session.open_file(file) if not file.found else file)

    def _map_file(self) -> MapFile:
        if self._session.map_file is None:
            refuse(mark("map"), mark("none"), mark("one that was dropped on the page before"))
        return self._session.map_file

    async def _import(self, request: Request) -> Response:
        """Go on at a junction of the map that was sent last, or in that scene."""
        sent, session = self._map_file(), self._session
        junction = (await _body(request, _MAX_NAME_BYTES)).decode("utf-8", errors="replace")
        try:
            if sent.found.get("isScene"):
                await session.open_scene(str(sent.path))
                session.map_file = None  # the session's file from here on
            else:
                names = {one["id"]: one["name"] for one in sent.found.get("junctions", ())}
                if junction not in names:
                    raise InputError(
                        mark("junction"), junction, Phrase("one of {names}", names=sent.name)
                    )
                path = str(session.work.scratch / f"scene-{next(self._numbers)}")
                await session.open_scene(path, names[junction], of=sent, junction=junction)
        except TaskError as error:
            plain = tr(CAUSES[error.cause]) if error.cause in CAUSES else str(error)
            raise TaskError(plain.replace(str(sent.path), sent.name)) from None
        return JSONResponse({"scene": session.workspace.title})

    async def _received(self, request: Request, name: str) -> Path:
        """A file of the session with the map that is sent, in a folder of its own."""
        path = self._session.work.scratch / f"received-{next(self._numbers)}" / name
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
    brief = {key: file.found[key] for key in ("name", "isScene", "junctions")}
    chooser = {} if file.found["isScene"] else {"chooser": junction_chooser(file.found)}
    return JSONResponse({"map": file.name, **brief, **chooser})


def _whole_number(values: Mapping[str, str], name: str, default: int) -> int:
    try:
        return int(values.get(name, str(default))[:9])
    except ValueError:
        raise InputError(name, values[name], mark("a whole number")) from None


async def _chunks(request: Request, max_bytes: int) -> AsyncIterator[bytes]:
    """The body of a request in parts; InputError if there is more of it."""
    n_bytes = 0
    async for chunk in request.stream():
        n_bytes += len(chunk)
        if n_bytes > max_bytes:
            refuse(
                mark("file"), Phrase("more than {n:,} bytes", n=max_bytes), mark("a smaller one")
            )
        yield chunk


async def _body(request: Request, max_bytes: int) -> bytes:
    return b"".join([chunk async for chunk in _chunks(request, max_bytes)])


def _remove(received: Path) -> None:
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
    """Send what waits; of several numbers or states that wait only the newest."""
    while True:
        messages = [await waiting.get()]
        while not waiting.empty():
            messages.append(waiting.get_nowait())
        newest = {message["type"]: index for index, message in enumerate(messages)}
        for index, message in enumerate(messages):
            if message["type"] in _EACH or newest[message["type"]] == index:
                await socket.send_text(json.dumps(message, separators=(",", ":"), allow_nan=False))
        if is_lost.is_set():
            await socket.close(1013)
            return


def _download(content: bytes, name: str, kind: str) -> Response:
    disposition = {"content-disposition": f'attachment; filename="{name}"'}
    return Response(content, media_type=kind, headers=disposition)


def build_app(session: Session, *, token: str, hosts: frozenset[str] | None) -> ASGIApp:
    """The application of a session; every address begins with the token."""

    @asynccontextmanager
    async def life(app: Starlette) -> Any:
        session.start()
        yield
        session.stop()

    inner = Starlette(routes=[Mount(f"/{token}", routes=Pages(session).routes())], lifespan=life)
    return Guard(inner, token=token, hosts=hosts)


class RunningServer:
    """A server in a thread of its own: the main thread waits, and is free to be interrupted.

    Unless it `keeps_open`, it ends by itself some seconds after the last page was closed. Its
    `address` is that of the page, with its token.
    """

    def __init__(
        self, make_session: Callable[[], Session], *, host: str, port: int, keeps_open: bool = True
    ) -> None:
        self.keeps_open = keeps_open
        try:
            self._socket = socket.create_server((host, port))
        except (OSError, OverflowError) as error:
            where = getattr(error, "strerror", None) or error
            raise InputError("--port", Unquoted(f"{host}:{port}: {where}"), "a free port") from None
        self.port: int = self._socket.getsockname()[1]
        self.host = host
        self.token = secrets.token_urlsafe(24)
        shown = "127.0.0.1" if host in ("0.0.0.0", "::") else host
        self.address = f"http://{shown}:{self.port}/{self.token}/"
        self._make_session = make_session
        self.session: Session | None = None
        self._server: uvicorn.Server | None = None
        self._thread = threading.Thread(target=self._run, name="plan", daemon=True)
        self._is_up = threading.Event()
        self._error: BaseException | None = None

    def start(self) -> None:
        """Serve from here on."""
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
        """End it and every process that it has started; what could not be saved, in words."""
        if self._server is not None:
            self._server.should_exit = self._server.force_exit = True
        if self.session is not None:
            self.session.stop()
        self._thread.join(_PATIENCE_S)
        with suppress(OSError):
            self._socket.close()
        return "" if self.session is None else self.session.save_plan()

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
        self._is_up.set()  # the socket takes connections already
        watching = asyncio.create_task(self._end_when_alone(self.session, self._server))
        await self._server.serve(sockets=[self._socket])
        watching.cancel()

    async def _end_when_alone(self, session: Session, server: uvicorn.Server) -> None:
        while not self.keeps_open:
            await asyncio.sleep(0.5)
            if session.left_at_s is None:  # nobody came yet, or somebody is here
                continue
            waits_s = LINGER_LOST_S if session.is_lost else LINGER_S
            if time.monotonic() - session.left_at_s > waits_s:
                server.should_exit = True
                return
