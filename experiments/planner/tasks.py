"""Tasks that take long, in a process that can be ended: evaluation, advice, reports, imports."""

import asyncio
import io
import multiprocessing
import warnings
import zipfile
from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from pyproj.exceptions import CRSError

from geometry.errors import InputError, check_one_of, refuse
from geometry.files import reading
from geometry.frames import parse_crs
from geometry.maps.georeferences import transform
from geometry.phrases import Phrase
from geometry.scene import Site
from geometry.scene_files import has_scene, load_scene, save_scene
from placement.candidates import CandidatePose, build_grid, own_models
from placement.compute import Compute, Progress
from placement.evaluation import Evaluation
from placement.evaluator import evaluate_layout, with_sight
from placement.explain.tolerances import find_tolerances
from placement.explain.unavoided import Look, find_reasons
from placement.imaging import to_jpeg
from placement.layout import Layout
from placement.pipeline import assemble
from placement.question import Question
from placement.retrofit import LEAST_GAIN, Advice, Adviser
from placement.setting import Setting, build_setting
from scenarios.confirmation import is_in_time

from ..language import language, localized, mark, set_language, tr, tr_error
from ..parts.explanation import cause
from ..parts.player import interactive_part, party_records, run_record
from ..progress import StageProgress, follow_parent
from ..report.page import page_environment
from ..results.numbers import euros, percent
from ..scene import cause_of
from .numbers import evaluated_numbers, key_of
from .plan import Background, Lie, LiePoint, with_poles

_MAX_EVALUATIONS = 40
_AERIAL_M, _FINEST_M = 150.0, 0.1  # of an image: to each side of the junction, and a pixel
_MORE, _IN_ALL = mark("{amount} more"), mark("{amount} in all")  # what an answer costs
_REQUESTS = ("next", "complete", "re-aim", "cheapest", "why-not")


@dataclass(frozen=True, slots=True, kw_only=True)
class Work:
    """The question of a session, and where and how it is computed."""

    question: Question  # Its scene is a path that the server chose
    # Folder of this session, removed at its end; detections of units are cached there
    scratch: Path
    compute: Compute  # Its cache has tables of whole grids


class Tasks:
    """All about one setting that takes longer than a drag may; built in the process."""

    def __init__(self, work: Work, progress: Progress) -> None:
        self._work, self._progress = work, progress
        self._compute = replace(work.compute, progress=progress)
        self._of_units = replace(self._compute, cache_folder=work.scratch / "views")
        self._evaluations: OrderedDict[tuple[object, ...], Evaluation] = OrderedDict()
        self._adviser: Adviser | None = None
        self._poles: tuple[Site, ...] = ()
        self._chosen: tuple[str, list[Any]] = work.question.sensors, []
        self._map: tuple[tuple[object, ...], Any] = (), None  # that was read last, with its options

    @cached_property
    def setting(self) -> Setting:
        """Scene and runs, as ``evaluate`` builds them."""
        self._progress(mark("setting"), 0, 0)
        question = self._work.question
        setting = build_setting(question, load_scene(question.scene), compute=self._compute)
        return with_sight(setting, compute=self._compute)

    def open_setting(self) -> Setting:
        """The setting itself, for the server."""
        return self.setting

    def evaluate(self, layout: Layout) -> dict[str, Any]:
        """Numbers of a layout, the same as ``evaluate`` gives."""
        return evaluated_numbers(self._evaluation(layout), self.setting)

    def _evaluation(self, layout: Layout) -> Evaluation:
        key = (layout.name, *key_of(layout.units))
        if key not in self._evaluations:
            self._evaluations[key] = evaluate_layout(layout, self.setting, compute=self._of_units)
            while len(self._evaluations) > _MAX_EVALUATIONS:
                self._evaluations.popitem(last=False)
        self._evaluations.move_to_end(key)
        return self._evaluations[key]

    def watch(self, layout: Layout, run_id: str) -> str:
        """A page that plays runs of a layout, the one asked for first: the report's own player."""
        self._run_index(run_id)
        evaluation = self._evaluation(layout)
        part = interactive_part(self.setting, {layout.name: evaluation}, first_runs=(run_id,))
        source = (Path(__file__).parent / "page" / "watch.html.j2").read_text(encoding="utf-8")
        template = page_environment().from_string(source)
        page: str = template.render(interactive=part, title=run_id)
        return page

    def explain(self, layout: Layout, run_id: str) -> dict[str, Any]:
        """Why units do not detect the road user of a run early enough: who hides whom, when."""
        index = self._run_index(run_id)
        setting, evaluation = self.setting, self._evaluation(layout)
        axis, latency_s = setting.axis, setting.rule.latency_s
        frames, last_s = axis.frames_of(index), float(axis.last_brake_time_s[index])
        time_s = axis.time_s[frames]
        counts = np.asarray(is_in_time(time_s, last_s, latency_s=latency_s))
        looks = []
        for unit in layout.units:
            detected = evaluation.units[unit.id].detected[frames]
            missed = np.flatnonzero(counts & ~detected)
            if len(missed):
                looks.append(Look(unit=unit, run_index=index, frame_index=missed))
        n_in_time = int(counts.sum())
        units = []
        reasons = find_reasons(setting, looks, compute=self._of_units)
        for look, why in zip(looks, reasons, strict=True):
            words = [{"words": cause(one), "cause": one.cause, "frames": one.frames} for one in why]
            n_detected = n_in_time - len(look.frame_index)
            units.append({"unit": look.unit.id, "detected": n_detected, "reasons": words})
        shown = [{"index": n, "time": localized(f"{at_s:.1f} s")} for n, at_s in enumerate(time_s)]
        played = {layout.name: evaluation}
        return {
            **{"run": run_id, "inTime": n_in_time, "frames": shown, "units": units},
            **{
                "record": run_record(setting.runs[index], index, played),
                "parties": party_records(played),
            },
        }

    def _run_index(self, run_id: str) -> int:
        if run_id not in self.setting.axis.run_ids:
            raise InputError(mark("run"), run_id, mark("a run of this plan"))
        return self.setting.axis.run_ids.index(run_id)

    def picture(self, layout: Layout, unit_id: str, run_id: str, frame: int) -> bytes:
        """Picture of a camera in a frame of a run, as JPEG."""
        from placement.evaluator.pictures import find_frame, find_viewpoint, render
        from placement.imaging import Picture

        run = self.setting.runs[self._run_index(run_id)]
        frame = find_frame(run, frame)
        viewpoint = find_viewpoint(layout, unit_id, run, frame)
        seen = render(self.setting.scene, run, frame, viewpoint, compute=self._of_units)
        if not isinstance(seen, Picture):
            raise InputError(mark("unit"), unit_id, mark("a camera: a LiDAR takes no picture"))
        return to_jpeg(seen.rgb)

    def lay_raster(self, path: str, crs: str) -> Background:
        """The part of an aerial image that lies around the junction, north up.

        `crs` is the reference system of a world file next to it. Raises InputError: it does not say
        where it lies, or lies elsewhere.
        """
        try:
            import rasterio
            from rasterio.vrt import WarpedVRT
        except ImportError:
            expected = mark("rasterio to read it: pip install place-rsus[terrain]")
            raise InputError(path, Phrase("an image with a place"), expected) from None
        scene, file = self.setting.scene, Path(path)
        expected = mark("an image of the junction in 8 bits per colour that says where it lies")
        driver = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG"}.get(file.suffix.lower(), "GTiff")
        unplaced = rasterio.errors.NotGeoreferencedWarning
        with (
            reading(file, expected, rasterio.errors.RasterioError, CRSError),
            rasterio.Env(GDAL_PAM_ENABLED="NO"),
            warnings.catch_warnings(action="ignore", category=unplaced),
            rasterio.open(path, driver=driver) as raster,
        ):
            grid, own = raster.transform, raster.crs.to_wkt() if raster.crs else crs
            is_coloured = raster.dtypes[0] == "uint8" and raster.colorinterp[0].name != "palette"
            if grid.is_identity or not (own and scene.crs and is_coloured):
                refuse(path, mark("another one, or a scene at no place"), expected)
            edges = [(x, y) for x in (0, raster.width) for y in (0, raster.height)]
            corners_m = transform([grid @ edge for edge in edges], own, scene.crs)
            low_m, high_m = corners_m.min(axis=0), corners_m.max(axis=0)
            step_m = max(float(high_m[0] - low_m[0]) / raster.width, _FINEST_M)
            centre_m = scene.outline_m.mean(axis=0)
            west, south = np.maximum(low_m, centre_m - _AERIAL_M).tolist()
            east, north = np.minimum(high_m, centre_m + _AERIAL_M).tolist()
            if not (west < east and south < north):
                refuse(path, mark("an image of elsewhere"), expected)
            width, height = (int(np.ceil(span / step_m)) for span in (east - west, north - south))
            has_alpha = any(band.name == "alpha" for band in raster.colorinterp)
            with WarpedVRT(
                raster,
                src_crs=parse_crs(own).to_wkt(),
                crs=parse_crs(scene.crs).to_wkt(),
                transform=rasterio.Affine(step_m, 0.0, west, 0.0, -step_m, north),
                **{"width": width, "height": height, "add_alpha": not has_alpha},
            ) as part:
                rgb = part.read([1, 2, 3] if raster.count >= 3 else [1, 1, 1])
                rgb[:, part.dataset_mask() == 0] = 255
        points = (
            LiePoint(0.0, 0.0, west, north),
            LiePoint(width, height, west + width * step_m, north - height * step_m),
        )
        lie = Lie(width_px=width, height_px=height, points=points)
        return Background(lie=lie, image=to_jpeg(np.moveaxis(rgb, 0, -1)))

    def choose(self, sensors: str, poles: tuple[Site, ...] = ()) -> None:
        """Models that advice may mount, with commas between (none: the grid's), and own poles."""
        chosen = sensors, [(pole.id, *pole.position_m) for pole in poles]
        if chosen != self._chosen:
            own_models(sensors)  # names are checked now
            self._chosen, self._poles, self._adviser = chosen, poles, None

    def advise(
        self, units: Sequence[CandidatePose], request: str, *, n_units: int = 0, site: str = ""
    ) -> list[dict[str, Any]]:
        """Answers to a request, each with its units and a sentence."""
        check_one_of("request", request, _REQUESTS)
        adviser = self._advise()
        if request == "next":
            return [_answer(tr("The best next unit"), adviser.best_next(units), costs=_MORE)]
        if request == "complete":
            advice = adviser.complete(units, n_units=n_units)
            return [_answer(tr("Completed to {n}", n=n_units), advice, costs=_MORE)]
        if request == "re-aim":
            return [_answer(tr("All re-aimed, poles kept"), adviser.re_aim(units), costs="")]
        if request == "cheapest":
            advice = adviser.cheapest(units)
            return [_answer(tr("The cheapest that keeps this"), advice, costs=_IN_ALL)]
        one_more, instead = adviser.why_not(units, site)
        best = tr("The best {n} with {site}", n=len(units), site=site)
        return [
            _answer(tr("One more unit at {site}", site=site), one_more, costs=_MORE),
            _answer(best, instead, costs=_IN_ALL),
        ]

    def _advise(self) -> Adviser:
        if self._adviser is None:
            nothing: dict[str, Any] = {"budget": None, "budget_cost": None, "target": ""}
            nothing |= {"survive": "0", "min_case_apr": 0.0}
            question = replace(self._work.question, sensors=self._chosen[0], **nothing)
            scene = with_poles(self.setting.scene, self._poles)
            setting = replace(self.setting, scene=scene)
            assembly = assemble(question, setting=setting, counts_money=True, compute=self._compute)
            self._adviser = Adviser(assembly, build_grid(question))
        return self._adviser

    def report(self, layout: Layout, command: str) -> bytes:
        """The folder that ``evaluate --out`` writes, as a ZIP file."""
        from ..jobs.evaluation import run_evaluation

        folder = self._work.scratch / "report"
        run_evaluation(
            self._work.question,
            layout=layout,
            out=folder,
            compute=self._of_units,
            command=command,
            progress=_Forwarding(self._progress),
        )
        buffer = io.BytesIO()
        with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
            for path in sorted(folder.rglob("*")):
                if path.is_file():
                    archive.write(path, path.relative_to(folder))
        return buffer.getvalue()

    def sheet(self, layout: Layout) -> bytes:
        """The mounting sheet, a PDF with a page for each unit."""
        from ..parts.sheet import mounting_sheet

        self._progress(mark("tolerances"), 0, 0)
        tolerances = find_tolerances(self.setting, layout.units, compute=self._of_units)
        self._progress(mark("draw the sheet"), 0, 0)
        return mounting_sheet(layout, self.setting, tolerances, compute=self._of_units)

    def survey(self, path: str, keeps_left: bool | None = None) -> dict[str, Any]:
        """Contents of a file: its junctions on a map, to choose from; none in a scene.

        `keeps_left`: the side of the road, by default what the map says. Raises InputError.
        """
        from ..scene.pictures import junction_map

        self._progress(mark("read"), 0, 0)
        if has_scene(Path(path)):
            return {"name": load_scene(path).name, "isScene": True, "junctions": []}
        maps, junctions = self._read_map(path, keeps_left)
        if not junctions:
            refuse(maps[0].name, mark("no junction"), mark("a map in which roads meet"))
        return {"name": maps[0].name, "isScene": False, **junction_map(maps, junctions)}

    def _read_map(self, path: str, keeps_left: bool | None) -> Any:
        """A map and its junctions, which are remembered: one of them is cut out next."""
        from geometry.maps.importing import ReadingOptions, read_maps

        if self._map[0] != (path, keeps_left):
            self._map = (), None
            reading = ReadingOptions(keeps_left=keeps_left)
            read = read_maps([Path(path)], reading, progress=self._progress)
            self._map = (path, keeps_left), read
        return self._map[1]

    def import_junction(
        self,
        path: str,
        junction: str,
        out: str,
        sites: str = "auto",
        keeps_left: bool | None = None,
    ) -> None:
        """Cut a junction out of a map, into a folder; `sites` is as of ``--sites``."""
        from geometry.maps.importing import ImportOptions, choose_junction, cut_scene

        maps, junctions = self._read_map(path, keeps_left)
        chosen = choose_junction(maps[0], junctions, name=junction)
        imported = cut_scene(maps, chosen, ImportOptions(sites=sites), progress=self._progress)
        Path(out).mkdir()
        save_scene(Path(out), imported.scene, sources=imported.sources)


class _Forwarding(StageProgress):
    """Stages of a job of the command line, shown on the page."""

    def __init__(self, progress: Progress) -> None:
        super().__init__()
        self._to = progress

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Pass a stage on."""
        super().__call__(stage, done, total)
        self._to(stage, done, total)


def _answer(title: str, advice: Advice, *, costs: str) -> dict[str, Any]:
    """An answer as the page shows it: units, numbers in words, and the proof."""
    after, before = advice.after, advice.before
    share = tr("APR {apr}", apr=percent(after.apr))
    if before is not None:
        is_same = abs(after.apr - before.apr) <= LEAST_GAIN
        than = tr("as much as now") if is_same else tr("now {amount}", amount=percent(before.apr))
        share += f" ({than})"
    price = tr(costs, amount=euros(after.cost_eur)) if costs else ""
    if costs == _IN_ALL and before is not None:
        price += " (" + tr("now {amount}", amount=euros(before.cost_eur)) + ")"
    gained = ", ".join(filter(None, [share, price]))
    return {
        "title": title,
        "words": tr(
            "On the detection table: {gained}; {proof}.", gained=gained, proof=_proof(advice)
        ),
        "apr": percent(after.apr),
        "bound": percent(advice.bound),
        "isProven": advice.is_proven,
        "units": advice.units,
    }


def _proof(advice: Advice) -> str:
    """The proof of an answer in words; bounds are those of the detection table."""
    if advice.n_compared:
        return tr("the best of {n} tried, all that there are", n=advice.n_compared)
    if advice.is_all_proven:
        return tr("proven: nothing of its kind is better")
    first = None if advice.certificate is None else advice.certificate.stages[0]
    if first is not None and first.name == "cost_eur":
        known = (
            tr(
                "proven: none costs less; of those with the same price not all "
                "were compared in time"
            ),
            tr(
                "not proven in the time given: nothing for less than {bound} is possible there",
                bound=euros(first.bound),
            ),
        )
    else:
        known = (
            tr(
                "proven: no APR is higher; of those with the same APR not all were compared in time"
            ),
            tr(
                "not proven in the time given: no APR above {bound} is possible there",
                bound=percent(advice.bound),
            ),
        )
    return known[0] if advice.is_proven else known[1]


OnProgress = Callable[[str, int, int], None]


class TaskError(RuntimeError):
    """A task that could not be done, in a sentence for the page; with its cause, if it has one.

    The cause is one of ``experiments.scene.CAUSES``: why a junction cannot be planned.
    """

    def __init__(self, text: str, cause: str = "") -> None:
        super().__init__(text)
        self.cause = cause


class DiedError(TaskError):
    """The process ended while it worked, and nobody had asked for it."""


class Cancelled(RuntimeError):
    """The process was ended while it worked."""


class Worker:
    """Runs methods of :class:`Tasks` in a second process, which starts when it is needed."""

    def __init__(self, work: Work) -> None:
        self._work = work
        self._process: Any = None
        self._connection: Connection | None = None
        self._turn = asyncio.Lock()
        self.is_busy = False

    async def call(self, method: str, *args: Any, on_progress: OnProgress, **kwargs: Any) -> Any:
        """Result of a method; waits for its turn.

        Raises TaskError: the method refused what it was given, or something went wrong that nobody
        foresaw. DiedError: its process ended by itself or was killed, for example because memory
        ran out. Cancelled: :meth:`stop` was called meanwhile.
        """
        loop = asyncio.get_running_loop()

        def tell(stage: str, done: int, total: int) -> None:
            loop.call_soon_threadsafe(on_progress, stage, done, total)

        async with self._turn:
            self.is_busy = True
            try:
                connection = self._start()
                kind, value = await asyncio.to_thread(
                    _exchange, connection, (method, args, kwargs), tell
                )
            finally:
                self.is_busy = False
        if kind == "done":
            return value
        if kind == "ended":
            was_stopped = self._connection is not connection
            self.stop()
            if was_stopped:
                raise Cancelled
            raise DiedError(
                tr("the process that did it ({name}) was ended from outside", name=method)
            )
        raise TaskError(*value)

    def stop(self) -> None:
        """End the process, whatever it does; the next call starts another one."""
        process, self._process = self._process, None
        connection, self._connection = self._connection, None
        if process is not None:
            process.terminate()
            process.join(timeout=2.0)
            if process.is_alive():
                process.kill()
                process.join()
        if connection is not None and not self.is_busy:  # else its reader sees the end and closes
            connection.close()

    def _start(self) -> Connection:
        if self._process is None or self._connection is None or not self._process.is_alive():
            context = multiprocessing.get_context("spawn")
            ours, theirs = context.Pipe()
            given = theirs, self._work, language()
            self._process = context.Process(target=_serve, args=given, daemon=False)
            self._process.start()
            theirs.close()
            self._connection = ours
        return self._connection


def _exchange(connection: Connection, request: Any, tell: OnProgress) -> tuple[str, Any]:
    """Send a request and wait for its answer; ("ended", None) where the process ends."""
    try:
        connection.send(request)
        while True:
            kind, value = connection.recv()
            if kind != "progress":
                return kind, value
            tell(*value)
    except (EOFError, OSError):
        connection.close()
        return "ended", None


def _serve(connection: Connection, work: Work, code: str) -> None:
    """Main function of the process, in a language: tasks until the pipe is closed."""
    follow_parent()
    set_language(code)
    tasks = Tasks(work, lambda *stage: connection.send(("progress", stage)))
    while True:
        try:
            method, args, kwargs = connection.recv()
        except EOFError:
            return
        try:
            answer = ("done", getattr(tasks, method)(*args, **kwargs))
        except InputError as error:
            answer = ("refused", (tr_error(error), cause_of(error)))
        except Exception as error:
            text = f"{type(error).__name__}: {' '.join(str(error).split())[:300]}"
            answer = ("failed", (text,))
        connection.send(answer)
