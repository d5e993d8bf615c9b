"""Numbers of what is shown: at once by the detection table, then by the evaluator."""

import asyncio
from collections.abc import Callable

from placement.candidates import CandidatePose

from ..language import mark, tr, tr_error
from .browsers import Browsers, variants_message
from .files import save_plan
from .numbers import coverage_record, errors_record, key_of
from .plan import Variant
from .proposals import Proposals
from .worker import Cancelled, DiedError, TaskError
from .workers import Workers
from .workspace import Shown, Workspace

# How long nothing must change before the evaluator is asked
_REST_S = 0.3


class Counting:
    """Two loops that tell the browsers numbers.

    :meth:`count` follows every change; when its numbers are told, the plan rests, and
    :meth:`judge` saves it and asks the evaluator.

    Parameters
    ----------
    current : callable
        What is shown by now.
    browsers : Browsers
        Are told the numbers.
    workers : Workers
        Have the evaluator.
    proposals : Proposals
        Are evaluated, too, after the variants.
    """

    def __init__(
        self,
        current: Callable[[], Shown],
        *,
        browsers: Browsers,
        workers: Workers,
        proposals: Proposals,
    ) -> None:
        self._current = current
        self._browsers = browsers
        self._workers = workers
        self._proposals = proposals
        # There is something to count
        self.changed = asyncio.Event()
        # There may be something to judge
        self.rests = asyncio.Event()
        self.shows_coverage = False
        self.shows_errors = False

    # ---------- by the detection table

    async def count(self) -> None:
        """Tell numbers of the newest state, at once; the evaluator's where they are known.

        It never ends by itself. Of changes that come while it counts, only the newest
        is counted.
        """
        while True:
            await self.changed.wait()
            self.changed.clear()
            workspace = self._current().workspace
            # The first count casts rays that all others need.
            if workspace.live.n_casts == 0:
                await self._prepare_rays(workspace)
            shown = self._current()
            # Another scene was opened meanwhile
            if shown.workspace is not workspace:
                self.changed.set()
                continue
            try:
                await self._count(shown)
            except Cancelled:
                return
            except Exception as error:  # the next change may be one that can be counted
                reason = tr_error(error)
                self._browsers.notice(tr("no numbers: {reason}", reason=reason))
            self.rests.set()

    async def _prepare_rays(self, workspace: Workspace) -> None:
        """Do what the first count takes long for, and say so."""
        self._browsers.tell_stage("rays", mark("prepare the rays"))
        units = self._current().first_units()
        await asyncio.to_thread(workspace.numbers_by_table, units)
        self._browsers.tell_stage("rays", "")

    async def _count(self, shown: Shown) -> None:
        """Tell numbers of a revision, and its layers if nothing newer is there."""
        workspace = shown.workspace
        units = shown.units
        key = key_of(units)
        numbers = workspace.known.get(key)
        if numbers is None:
            numbers = await asyncio.to_thread(workspace.numbers_by_table, units)
        private = await asyncio.to_thread(workspace.private_areas, units)
        # The evaluator may have been no slower.
        numbers = workspace.known.get(key, numbers)
        message = {"type": "numbers", "revision": shown.revision, **numbers, **private}
        self._browsers.send(message)
        self._browsers.send(variants_message(self._current()))
        if self.shows_coverage and not self.changed.is_set():
            found = await asyncio.to_thread(coverage_record, shown.setting.scene, units)
            self._browsers.send(
                {"type": "coverage", "revision": shown.revision, **found}
            )
        if self.shows_errors and not self.changed.is_set():
            setting = shown.setting
            found = await asyncio.to_thread(
                errors_record, setting.scene, units, setting.detector
            )
            self._browsers.send({"type": "errors", "revision": shown.revision, **found})

    # ---------- by the evaluator

    async def judge(self) -> None:
        """Save what rests, and evaluate all layouts that are shown: the newest first.

        It never ends by itself. A change interrupts it after the layout at which it
        works.
        """
        while True:
            await self.rests.wait()
            self.rests.clear()
            await asyncio.sleep(_REST_S)
            # Somebody drags: pixels would be asked for what nobody looks at any longer.
            if self.rests.is_set() or self.changed.is_set():
                continue
            shown = self._current()
            self._browsers.notice(save_plan(shown))
            # A change ends the round: the newest layout comes first in the next one.
            for units in self._unknown(shown):
                await self._evaluate(units)
                if self.rests.is_set():
                    break

    def _unknown(self, shown: Shown) -> list[tuple[CandidatePose, ...]]:
        """Layouts that are shown and not evaluated yet, the one that is worked on first."""
        layouts = [shown.units]
        layouts += [variant.units for variant in shown.state.variants]
        layouts += self._proposals.layouts()
        # So that the car's own sensors are known
        layouts.append(shown.first_units())
        by_key = {key_of(units): units for units in layouts if units}
        workspace = shown.workspace
        done = workspace.known.keys() | workspace.failed.keys()
        return [units for key, units in by_key.items() if key not in done]

    async def _evaluate(self, units: tuple[CandidatePose, ...]) -> None:
        """Evaluate a layout in the scene that is shown now, and tell what is found.

        A layout at which the evaluator's process died is tried once more, by a new
        process.
        """
        workspace = self._current().workspace
        key = key_of(units)
        layout = Variant(name="plan", units=units).layout(workspace.setting.scene)
        tell = self._browsers.stages("evaluator")
        tell(mark("evaluate"), 0, 0)
        try:
            numbers = await self._workers.evaluator.call(
                "evaluate", layout, on_progress=tell
            )
        except Cancelled:
            return
        except TaskError as error:
            if isinstance(error, DiedError) and key not in workspace.died:
                workspace.died.add(key)
                self._browsers.notice(tr("{reason}; trying again", reason=error))
                self.rests.set()
                return
            workspace.failed[key] = str(error)
            self._browsers.notice(tr("not evaluated: {reason}", reason=error))
            return
        finally:
            tell("", 0, 0)
        # They hold for this scene, whatever is shown by now: Undo may lead back to it.
        workspace.learn(units, numbers)
        shown = self._current()
        # Another scene was opened meanwhile
        if shown.workspace is not workspace:
            return
        if key == key_of(shown.units):
            private = await asyncio.to_thread(workspace.private_areas, units)
            message = {
                "type": "numbers",
                "revision": shown.revision,
                **numbers,
                **private,
            }
            self._browsers.send(message)
        # Units may have been changed while private areas were looked for.
        shown = self._current()
        self._browsers.send(variants_message(shown))
        self._browsers.send(self._proposals.message(shown))
