"""Tasks that take longer than a drag may: evaluation, advice, reports, imports.

:mod:`.worker` runs them in a process that can be ended.
"""

import io
import zipfile
from collections import OrderedDict
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from geometry.errors import InputError, check_one_of, refuse
from geometry.scene import Site
from geometry.scene_files import save_scene
from geometry.scene_sources import has_scene, load_scene
from placement.candidates import CandidatePose, build_grid, own_models
from placement.compute import Compute, Progress
from placement.evaluation import Evaluation
from placement.evaluator import evaluate_layout, with_sight
from placement.evaluator.picture_sources import to_jpeg
from placement.explain.tolerances import find_tolerances
from placement.explain.unavoided import Look, find_reasons
from placement.layout import Layout
from placement.pipeline import assemble
from placement.question import Question
from placement.retrofit import LEAST_GAIN, Advice, Adviser
from placement.setting import Setting, build_setting
from scenarios.confirmation import is_in_time

from ..language import localized, mark, tr
from ..parts.explanation import cause
from ..parts.player import interactive_part, party_records, run_record
from ..progress import StageProgress
from ..report.page import page_environment
from ..results.numbers import euros, percent
from .aerial_images import lay_raster
from .background import Background
from .numbers import evaluated_numbers, key_of
from .poles import with_poles

_MAX_EVALUATIONS = 40
# What an answer costs
_MORE = mark("{amount} more")
_IN_ALL = mark("{amount} in all")
_REQUESTS = ("next", "complete", "re-aim", "cheapest", "why-not")


@dataclass(frozen=True, slots=True, kw_only=True)
class Work:
    """The question of a session, and where and how it is computed.

    Attributes
    ----------
    question : Question
        Its scene is a path that the server chose.
    scratch : Path
        Folder of this session, removed at its end; detections of units are cached
        there.
    compute : Compute
        Its cache has tables of whole grids.
    """

    question: Question
    scratch: Path
    compute: Compute


class Tasks:
    """All about one setting that takes longer than a drag may; built in the process.

    Its methods are called by their names, see :meth:`.worker.Worker.call`.

    Parameters
    ----------
    work : Work
        The question, and where and how it is computed.
    progress : Progress
        Is told the stages of each task.
    """

    def __init__(self, work: Work, progress: Progress) -> None:
        self._work = work
        self._progress = progress
        self._compute = replace(work.compute, progress=progress)
        self._of_units = replace(self._compute, cache_folder=work.scratch / "views")
        self._evaluations: OrderedDict[tuple[object, ...], Evaluation] = OrderedDict()
        self._adviser: Adviser | None = None
        self._poles: tuple[Site, ...] = ()
        # Sensors and poles that were chosen last
        self._chosen: tuple[str, list[Any]] = (work.question.sensors, [])
        # The one read last, by path and side
        self._maps: dict[tuple[object, ...], Any] = {}

    @cached_property
    def setting(self) -> Setting:
        """Scene and runs, as ``evaluate`` builds them."""
        self._progress(mark("setting"), 0, 0)
        question = self._work.question
        setting = build_setting(
            question, load_scene(question.scene), compute=self._compute
        )
        return with_sight(setting, compute=self._compute)

    def open_setting(self) -> Setting:
        """The setting itself, for the server: the message where it cannot be built is told once."""
        return self.setting

    def evaluate(self, layout: Layout) -> dict[str, Any]:
        """Numbers of a layout, the same as ``evaluate`` gives."""
        return evaluated_numbers(self._evaluation(layout), self.setting)

    def _evaluation(self, layout: Layout) -> Evaluation:
        """Evaluation of a layout; the newest ones are remembered."""
        # The name stands in the record of an evaluation.
        key = (layout.name, *key_of(layout.units))
        if key not in self._evaluations:
            self._evaluations[key] = evaluate_layout(
                layout, self.setting, compute=self._of_units
            )
            while len(self._evaluations) > _MAX_EVALUATIONS:
                self._evaluations.popitem(last=False)
        self._evaluations.move_to_end(key)
        return self._evaluations[key]

    def watch(self, layout: Layout, run_id: str) -> str:
        """A page that plays runs of a layout, the one asked for first: the report's own player."""
        self._run_index(run_id)
        evaluation = self._evaluation(layout)
        part = interactive_part(
            self.setting, {layout.name: evaluation}, first_runs=(run_id,)
        )
        source = (Path(__file__).parent / "page" / "watch.html.j2").read_text(
            encoding="utf-8"
        )
        template = page_environment().from_string(source)
        page: str = template.render(interactive=part, title=run_id)
        return page

    def explain(self, layout: Layout, run_id: str) -> dict[str, Any]:
        """Why units do not detect the road user of a run early enough.

        Parameters
        ----------
        layout : Layout
            The units.
        run_id : str
            The run.

        Returns
        -------
        dict
            For the page: how many frames are in time; for each unit how many of them it
            detects, and what keeps it from the others; the run and its parties to draw
            them.

        Raises
        ------
        InputError
            There is no such run.
        """
        index = self._run_index(run_id)
        setting = self.setting
        evaluation = self._evaluation(layout)
        axis = setting.axis
        frames = axis.frames_of(index)
        time_s = axis.time_s[frames]
        last_s = float(axis.last_brake_time_s[index])
        counts = np.asarray(
            is_in_time(time_s, last_s, latency_s=setting.rule.latency_s)
        )
        # Frames that came early enough, and in which the unit did not detect anybody
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
            words = []
            for reason in why:
                record = {
                    "words": cause(reason),
                    "cause": reason.cause,
                    "frames": reason.frames,
                }
                words.append(record)
            n_detected = n_in_time - len(look.frame_index)
            units.append(
                {"unit": look.unit.id, "detected": n_detected, "reasons": words}
            )
        shown = []
        for number, at_s in enumerate(time_s):
            shown.append({"index": number, "time": localized(f"{at_s:.1f} s")})
        played = {layout.name: evaluation}
        return {
            "run": run_id,
            "inTime": n_in_time,
            "frames": shown,
            "units": units,
            "record": run_record(setting.runs[index], index, played),
            "parties": party_records(played),
        }

    def _run_index(self, run_id: str) -> int:
        """Index of a run; InputError: there is none of that id."""
        if run_id not in self.setting.axis.run_ids:
            raise InputError(mark("run"), run_id, mark("a run of this plan"))
        return self.setting.axis.run_ids.index(run_id)

    def picture(self, layout: Layout, unit_id: str, run_id: str, frame: int) -> bytes:
        """Picture of a camera in a frame of a run, as JPEG.

        Raises InputError if there is no such unit, run or frame, or the unit is a
        LiDAR.
        """
        from placement.evaluator.pictures import find_frame, find_viewpoint, render
        from placement.imaging import RenderedPicture

        run = self.setting.runs[self._run_index(run_id)]
        frame = find_frame(run, frame)
        viewpoint = find_viewpoint(layout, unit_id, run, frame)
        seen = render(self.setting.scene, run, frame, viewpoint, compute=self._of_units)
        if not isinstance(seen, RenderedPicture):
            raise InputError(
                mark("unit"), unit_id, mark("a camera: a LiDAR takes no picture")
            )
        return to_jpeg(seen.rgb)

    def lay_raster(self, path: str, crs: str) -> Background:
        """The part of an aerial image that lies around the junction, north up.

        `crs` is the reference system of a world file next to it. Raises InputError: it
        does not say where it lies, or lies elsewhere.
        """
        return lay_raster(path, crs, self.setting.scene)

    def choose(self, sensors: str, poles: tuple[Site, ...] = ()) -> None:
        """Choose what advice may mount, from the next advice on.

        Parameters
        ----------
        sensors : str
            Models with commas between; none: the grid's.
        poles : tuple of Site
            Of one's own, beside the scene's sites.

        Raises
        ------
        InputError
            A model is not known.
        """
        chosen = (sensors, [(pole.id, *pole.position_m) for pole in poles])
        if chosen != self._chosen:
            # Names are checked now
            own_models(sensors)
            self._chosen = chosen
            self._poles = poles
            self._adviser = None

    def advise(
        self,
        units: Sequence[CandidatePose],
        request: str,
        *,
        n_units: int = 0,
        site: str = "",
        existing: Collection[str] = (),
    ) -> list[dict[str, Any]]:
        """Answers to a request, each with its units and a sentence.

        Parameters
        ----------
        units : sequence of CandidatePose
            What is mounted.
        request : str
            "next", "complete", "re-aim", "cheapest" or "why-not".
        n_units : int
            With "complete": units in all.
        site : str
            With "why-not": where nothing is mounted.
        existing : collection of str
            Ids of units that are mounted already: they cost nothing.

        Raises
        ------
        InputError
            The request is none of these, or cannot be met.
        """
        check_one_of("request", request, _REQUESTS)
        adviser = self._advise()
        if request == "next":
            advice = adviser.best_next(units)
            return [_answer(tr("The best next unit"), advice, costs=_MORE)]
        if request == "complete":
            advice = adviser.complete(units, n_units=n_units)
            return [_answer(tr("Completed to {n}", n=n_units), advice, costs=_MORE)]
        if request == "re-aim":
            advice = adviser.re_aim(units)
            return [_answer(tr("All re-aimed, poles kept"), advice, costs="")]
        if request == "cheapest":
            advice = adviser.cheapest(units, paid=existing)
            return [
                _answer(
                    tr("The cheapest with at least this APR"), advice, costs=_IN_ALL
                )
            ]
        one_more, instead = adviser.why_not(units, site, paid=existing)
        best = tr("The best {n} with {site}", n=len(units), site=site)
        return [
            _answer(tr("One more unit at {site}", site=site), one_more, costs=_MORE),
            _answer(best, instead, costs=_IN_ALL),
        ]

    def _advise(self) -> Adviser:
        """The optimiser for the sensors and poles that are chosen; remembered for these."""
        if self._adviser is None:
            sensors, _ = self._chosen
            # Requests say themselves what is sought: not a budget, not a target.
            question = replace(
                self._work.question,
                sensors=sensors,
                budget=None,
                budget_cost=None,
                target="",
                survive="0",
                min_case_apr=0.0,
            )
            scene = with_poles(self.setting.scene, self._poles)
            setting = replace(self.setting, scene=scene)
            assembly = assemble(
                question, setting=setting, counts_money=True, compute=self._compute
            )
            self._adviser = Adviser(assembly, build_grid(question))
        return self._adviser

    def report(
        self, layout: Layout, command: str, existing: Collection[str] = ()
    ) -> bytes:
        """The folder that ``evaluate --out`` writes, as a ZIP file.

        Parameters
        ----------
        layout : Layout
            What is reported.
        command : str
            With which the reader makes it again.
        existing : collection of str
            Ids of units that are mounted already.
        """
        from ..jobs.evaluation import run_evaluation

        folder = self._work.scratch / "report"
        run_evaluation(
            self._work.question,
            layout=layout,
            existing=existing,
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

    def sheet(self, layout: Layout, existing: Collection[str] = ()) -> bytes:
        """The mounting sheet, a PDF with a page for each unit.

        `existing` are ids of units that are mounted already.
        """
        from ..parts.sheet import mounting_sheet

        self._progress(mark("tolerances"), 0, 0)
        tolerances = find_tolerances(self.setting, layout.units, compute=self._of_units)
        self._progress(mark("draw the sheet"), 0, 0)
        return mounting_sheet(
            layout,
            self.setting,
            tolerances,
            existing=existing,
            compute=self._of_units,
        )

    def survey(self, path: str, keeps_left: bool | None = None) -> dict[str, Any]:
        """Contents of a file: its junctions on a map, to choose from; none in a scene.

        Parameters
        ----------
        path : str
            The file.
        keeps_left : bool, optional
            The side of the road, by default what the map says.

        Raises
        ------
        InputError
            It cannot be read, or has no junction.
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

        key = (path, keeps_left)
        if key not in self._maps:
            # Before another one takes as much memory
            self._maps.clear()
            reading = ReadingOptions(keeps_left=keeps_left)
            self._maps[key] = read_maps([Path(path)], reading, progress=self._progress)
        return self._maps[key]

    def import_junction(
        self,
        path: str,
        junction: str,
        out: str,
        sites: str = "auto",
        sites_crs: str = "",
        keeps_left: bool | None = None,
    ) -> None:
        """Cut a junction out of a map, into a folder.

        Parameters
        ----------
        path : str
            The map.
        junction : str
            Id of the junction.
        out : str
            The folder, which must not exist yet.
        sites : str
            As of ``--sites``.
        sites_crs : str
            As of ``--sites-crs``.
        keeps_left : bool, optional
            The side of the road, by default what the map says.

        Raises
        ------
        InputError
            There is no such junction, or no scene can be made of it.
        """
        from geometry.maps.importing import ImportOptions, choose_junction, cut_scene

        maps, junctions = self._read_map(path, keeps_left)
        chosen = choose_junction(maps[0], junctions, name=junction)
        options = ImportOptions(sites=sites, sites_crs=sites_crs)
        imported = cut_scene(maps, chosen, options, progress=self._progress)
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
    """An answer as the page shows it: units, numbers in words, and the proof.

    Parameters
    ----------
    title : str
        What was asked for.
    advice : Advice
        The optimiser's answer.
    costs : str
        Message about the price, ``_MORE`` or ``_IN_ALL``; empty: none is told.
    """
    after = advice.after
    before = advice.before
    share = tr("APR {apr}", apr=percent(after.apr))
    if before is not None:
        if abs(after.apr - before.apr) <= LEAST_GAIN:
            than = tr("same as now")
        else:
            than = tr("now {amount}", amount=percent(before.apr))
        share += f" ({than})"
    price = ""
    if costs:
        price = tr(costs, amount=euros(after.cost_eur))
    if costs == _IN_ALL and before is not None:
        price += " (" + tr("now {amount}", amount=euros(before.cost_eur)) + ")"
    gained = ", ".join(filter(None, [share, price]))
    words = tr(
        "On the detection table: {gained}; {proof}.",
        gained=gained,
        proof=_proof(advice),
    )
    return {
        "title": title,
        "words": words,
        "apr": percent(after.apr),
        "bound": percent(advice.bound),
        "isProven": advice.is_proven,
        "units": advice.units,
    }


def _proof(advice: Advice) -> str:
    """The proof of an answer in words; bounds are those of the detection table."""
    if advice.n_compared:
        return tr("the best of all {n} possible ones", n=advice.n_compared)
    if advice.is_all_proven:
        return tr("proven: nothing of its kind is better")
    certificate = advice.certificate
    if certificate is not None and certificate.stages[0].name == "cost_eur":
        if advice.is_proven:
            return tr(
                "proven: none costs less; not all with the same price were compared in "
                "time"
            )
        return tr(
            "not proven in the time given; it is only proven that none costs less "
            "than {bound}",
            bound=euros(certificate.stages[0].bound),
        )
    if advice.is_proven:
        return tr(
            "proven: no APR is higher; not all with the same APR were compared in time"
        )
    return tr(
        "not proven in the time given; it is only proven that no APR exceeds {bound}",
        bound=percent(advice.bound),
    )
