"""Pictures of the evaluator's frames, for detectors that look at them."""

from collections.abc import Callable, Sequence
from concurrent.futures import CancelledError
from threading import Lock

import numpy as np

from geometry.actors import PlacedActor
from geometry.poses import Pose, to_world
from geometry.scene import Scene
from geometry.sensors import CameraModel
from geometry.weather import pick_weather
from scenarios.runs import Run

from ..detectors.evidence import Image
from ..imaging import Backdrop, build_backdrop, draw_picture
from .vut_camera import VutCamera

PictureOfFrame = Callable[[int], Image]


class PictureSource:
    """Draws a frame when it is asked for; what stands still is prepared once per obstruction.

    Attributes
    ----------
    n_drawn : int
        Pictures so far.
    """

    def __init__(self, scene: Scene, runs: Sequence[Run], *, seed: int) -> None:
        self._scene, self._runs, self._seed = scene, runs, seed
        self._start = np.concatenate([[0], np.cumsum([len(run.time_s) for run in runs])])
        self._backdrops: dict[tuple[object, ...], Backdrop] = {}
        self._lock = Lock()
        self._is_closed = False
        self.n_drawn = 0

    def close(self) -> None:
        """Draw no more: whoever asks for another picture is stopped."""
        self._is_closed = True

    def from_roadside(self, pose: Pose, camera: CameraModel) -> PictureOfFrame:
        """Pictures of a fixed camera.

        Parameters
        ----------
        pose : Pose
            World frame.
        camera : CameraModel
            What is mounted.

        Returns
        -------
        picture : callable
            From a frame of all runs, end to end, to its image.
        """
        return lambda frame: self._draw(frame, pose, camera, with_vut=True)

    def from_vut(self, mount: VutCamera) -> PictureOfFrame:
        """Pictures of the VUT's own camera; see :meth:`from_roadside`."""

        def picture(frame: int) -> Image:
            run, index = self._find(frame)
            pose = vut_camera_pose(mount, run, index)
            return self._draw(frame, pose, mount.camera, with_vut=False)

        return picture

    def _find(self, frame: int) -> tuple[Run, int]:
        run_index = int(np.searchsorted(self._start, frame, side="right")) - 1
        return self._runs[run_index], frame - int(self._start[run_index])

    def _draw(self, frame: int, pose: Pose, camera: CameraModel, *, with_vut: bool) -> Image:
        if self._is_closed:
            raise CancelledError
        run, index = self._find(frame)
        picture = draw_picture(
            self._backdrop(run.obstruction),
            run,
            index,
            pose,
            camera,
            weather=pick_weather(run.weather, "run: weather"),
            with_vut=with_vut,
            seed=self._seed,
        )
        with self._lock:
            self.n_drawn += 1
        return picture.rgb

    def _backdrop(self, obstruction: tuple[PlacedActor, ...]) -> Backdrop:
        key = tuple(parked.key for parked in obstruction)
        with self._lock:
            if key not in self._backdrops:
                self._backdrops[key] = build_backdrop(self._scene, obstruction)
            return self._backdrops[key]


def vut_camera_pose(mount: VutCamera, run: Run, frame_index: int) -> Pose:
    """Where the VUT's camera is and looks in a frame of a run, world frame."""
    on_vut = mount.pose_on(run.encounter.vut)
    yaw_deg = float(run.vut_yaw_deg[frame_index])
    vut = Pose(position_m=np.append(run.vut_position_m[frame_index], 0.0), yaw_deg=yaw_deg)
    return Pose(
        position_m=to_world(on_vut.position_m[None], vut)[0],
        yaw_deg=yaw_deg + on_vut.yaw_deg,
        pitch_deg=on_vut.pitch_deg,
    )
