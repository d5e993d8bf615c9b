"""How sure an answer of the optimiser is, in words; and aerial images at their
place.
"""

import io
import warnings
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image

from experiments.planner.tasks import Tasks, Work, _proof
from geometry.errors import InputError
from geometry.frames import transform
from geometry.study_scene import load_study_scene
from placement.compute import Compute
from placement.layout import Certificate, Stage
from placement.optimiser import PlacementValue
from placement.question import Question
from placement.retrofit import Advice

VALUE = PlacementValue(*[0.8] * len(PlacementValue._fields))


def advice(*stages, n_compared=0):
    """Advice with a certificate of stages: name, bound, gap."""
    made = [
        Stage(
            name=name,
            objective=1.0,
            bound=bound,
            gap=gap,
            seconds=0.0,
        )
        for name, bound, gap in stages
    ]
    if made:
        certificate = Certificate(stages=tuple(made), solver="")
    else:
        certificate = None
    return Advice(
        units=(),
        before=None,
        after=VALUE,
        certificate=certificate,
        n_compared=n_compared,
    )


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (advice(n_compared=7), "the best of all 7 possible ones"),
        (advice(("apr", 0.9, 0.0)), "proven: nothing of its kind is better"),
        (
            advice(("apr", 0.9, 0.0), ("mean_margin_s", 2.0, 0.5)),
            (
                "proven: no APR is higher; not all with the same APR were compared in "
                "time"
            ),
        ),
        (
            advice(("cost_eur", 4040.0, 0.0), ("apr", 0.9, 0.5)),
            (
                "proven: none costs less; not all with the same price were compared in "
                "time"
            ),
        ),
        (
            advice(("apr", 0.837, 0.1)),
            (
                "not proven in the time given; it is only proven that no APR exceeds"
                " 83.7 %"
            ),
        ),
        (
            advice(("cost_eur", 4040.0, 0.1)),
            (
                "not proven in the time given; it is only proven that none costs less"
                " than 4,040 EUR"
            ),
        ),
    ],
)
def test_the_words_say_what_is_proven(given, said):
    assert _proof(given) == said


# ---------- aerial images

UTM = "EPSG:32632"


def aerial(path, *, driver, step_m=0.25, turn_deg=0.0, **more):
    """An image of 60 m around the junction, dark but for four coloured squares, and its
    grid.
    """
    rasterio = pytest.importorskip(
        "rasterio", reason="place-rsus[terrain] is not installed"
    )
    scene = load_study_scene()
    middle = transform(scene.outline_m.mean(axis=0), scene.crs, UTM)
    size = round(60.0 / step_m)
    grid = (
        rasterio.Affine.translation(*middle)
        @ rasterio.Affine.rotation(turn_deg)
        @ rasterio.Affine.scale(step_m, -step_m)
        @ rasterio.Affine.translation(-0.5 * size, -0.5 * size)
    )
    pixels = np.full((3, size, size), 40, dtype=np.uint8)
    squares = {(0.25, 0.25): 0, (0.75, 0.25): 1, (0.25, 0.75): 2}
    for (across, down), band in squares.items():
        rows, columns = (
            slice(int(p * size) - 6, int(p * size) + 6) for p in (down, across)
        )
        pixels[band, rows, columns] = 250
    about = {
        "count": 3,
        "width": size,
        "height": size,
        "dtype": "uint8",
        **more,
    }
    with (
        warnings.catch_warnings()
    ):  # one that says not where it lies is written on purpose
        warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)
        with rasterio.open(path, "w", driver=driver, **about) as raster:
            raster.write(pixels)
    places = {band: grid @ (p[0] * size, p[1] * size) for p, band in squares.items()}
    return grid, {
        band: transform(place, UTM, scene.crs) for band, place in places.items()
    }


def assert_lies_right(background, places):
    """Each square is where the map says, and of its colour."""
    pixels = np.array(Image.open(io.BytesIO(background.image)), dtype=int)
    first, second = background.lie.points
    assert pixels.shape[:2] == (background.lie.height_px, background.lie.width_px)
    for band, (east_m, north_m) in places.items():
        column = (east_m - first.east_m) / (second.east_m - first.east_m) * second.x_px
        row = (north_m - first.north_m) / (second.north_m - first.north_m) * second.y_px
        red_green_blue = pixels[int(row), int(column)]
        assert red_green_blue[band] > 180
        assert np.delete(red_green_blue, band).max() < 110


def tasks_of(folder):
    """Tasks at the study's junction."""
    work = Work(question=Question(), scratch=folder, compute=Compute())
    tasks = Tasks(work, lambda stage, done, total: None)
    tasks.setting = SimpleNamespace(scene=load_study_scene())
    return tasks


@pytest.mark.parametrize("turn_deg", [0.0, 20.0])
def test_an_aerial_image_lies_where_it_says(tmp_path, turn_deg):
    path = tmp_path / "aerial.tif"
    grid, _ = aerial(path, driver="GTiff", turn_deg=turn_deg)
    with pytest.raises(InputError, match="georeferenced image of the junction"):
        tasks_of(tmp_path).lay_raster(str(path), UTM)

    _, places = aerial(
        path,
        driver="GTiff",
        turn_deg=turn_deg,
        crs=UTM,
        transform=grid,
    )
    assert_lies_right(tasks_of(tmp_path).lay_raster(str(path), ""), places)


def test_an_image_with_a_world_file_lies_where_that_says(tmp_path):
    path = tmp_path / "aerial.png"
    grid, places = aerial(path, driver="PNG")
    x, y = grid @ (0.5, 0.5)  # a world file has the middle of the first pixel
    world = [grid.a, grid.d, grid.b, grid.e, x, y]
    beside = path.with_suffix(".wld")
    beside.write_text("\n".join(map(str, world)))

    assert_lies_right(tasks_of(tmp_path).lay_raster(str(path), UTM), places)
    for crs, said in (
        ("EPSG:0", "systems that pyproj knows"),
        ("", "georeferenced image of the junction"),
    ):
        with pytest.raises(InputError, match=said):
            tasks_of(tmp_path).lay_raster(str(path), crs)

    world[4] += 5000.0
    beside.write_text("\n".join(map(str, world)))
    with pytest.raises(InputError, match="an image of another place"):
        tasks_of(tmp_path).lay_raster(str(path), UTM)

    beside.write_text("1 2 3")
    with pytest.raises(InputError, match="georeferenced image of the junction"):
        tasks_of(tmp_path).lay_raster(str(path), UTM)
