"""What units see: their views on the ground, pictures of cameras, private places."""

import asyncio
from collections.abc import Callable
from typing import Any

from placement.candidates import CandidatePose

from .browsers import Browsers
from .camera_pictures import live_picture
from .numbers import key_of
from .worker import Cancelled
from .workspace import Key, Shown


class Views:
    """Views of the units that are shown, drawn in threads.

    Parameters
    ----------
    current : callable
        What is shown by now.
    browsers : Browsers
        Are told each view when it is drawn.
    """

    def __init__(self, current: Callable[[], Shown], *, browsers: Browsers) -> None:
        self._current = current
        self._browsers = browsers
        # A unit may look elsewhere
        self.moved = asyncio.Event()
        # Messages by unit, each with the key of the unit's pose and sensor
        self._drawn: dict[str, tuple[Key, dict[str, Any]]] = {}
        self._picture_turn = asyncio.Lock()
        self._newest_picture = object()

    def messages(self) -> list[dict[str, Any]]:
        """Views on the ground that are drawn already."""
        return [message for _, message in self._drawn.values()]

    def clear(self) -> None:
        """Forget all views: they are of another scene."""
        self._drawn.clear()

    async def look(self) -> None:
        """Tell views of all units that are shown; first of those whose rays have been cast."""
        while True:
            await self.moved.wait()
            self.moved.clear()
            while True:
                missing = self._without_view()
                if not missing:
                    break
                workspace = self._current().workspace
                # Rays take most of the time; a unit that has them is drawn at once.
                unit = missing[0]
                for each in missing:
                    if workspace.views.has_rays(each):
                        unit = each
                        break
                found = await asyncio.to_thread(workspace.view_record, unit)
                # Another scene may have been opened meanwhile.
                if workspace is self._current().workspace:
                    message = {"type": "view", **found}
                    self._drawn[unit.id] = key_of([unit]), message
                    self._browsers.send(message)

    def _without_view(self) -> list[CandidatePose]:
        """Units that are shown without their view; views of units that are gone are dropped."""
        units = self._current().units
        ids = {unit.id for unit in units}
        self._drawn = {name: view for name, view in self._drawn.items() if name in ids}
        known = {key for key, _ in self._drawn.values()}
        return [unit for unit in units if key_of([unit]) not in known]

    async def camera_picture(self, unit_id: str, **wanted: Any) -> dict[str, Any]:
        """What a camera sees as the newest state has it.

        Parameters
        ----------
        unit_id : str
            The camera.
        **wanted
            Run, frame and size, as :func:`.camera_pictures.live_picture`
            takes them.

        Returns
        -------
        dict
            Message for the page.

        Raises
        ------
        InputError
            There is no such unit, run or frame.
        Cancelled
            Another one was asked for meanwhile: of those that wait for their turn only
            the newest is drawn.
        """
        asked = object()
        self._newest_picture = asked
        async with self._picture_turn:
            # While this one waited for its turn, another one was asked for.
            if asked is not self._newest_picture:
                raise Cancelled
            shown = self._current()
            unit = shown.unit(unit_id)
            compute = shown.workspace.work.compute
            return await asyncio.to_thread(
                live_picture, unit, shown.setting, compute=compute, **wanted
            )

    async def private_places(self, unit_id: str) -> list[list[int]]:
        """Places of private ground that a unit has in its picture, in centimetres.

        Raises InputError if there is no such unit.
        """
        shown = self._current()
        unit = shown.unit(unit_id)
        return await asyncio.to_thread(shown.workspace.private_places, unit)
