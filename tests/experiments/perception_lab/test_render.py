"""``place-rsus render``."""

from pathlib import Path

import numpy as np
import pytest
from command_results import answer, refusal
from kept_backdrops import kept_backdrop
from PIL import Image

from experiments.export.watched import find_run
from experiments.perception_lab.drawing import instance_colours
from geometry.errors import InputError
from geometry.study_scene import load_study_scene
from placement.evaluator.pictures import find_frame

ASKED = {
    "--layout": "carlancap-12",
    "--run": "CPNC-50/east/40",
    "--frame": "-13",
    "--unit": "RSU3",
}


@pytest.fixture
def run_render(run, monkeypatch):
    """Runs the command with a backdrop that was drawn before."""
    monkeypatch.setattr("placement.imaging.picture.build_backdrop", kept_backdrop)

    def run_command(**changes):
        asked = ASKED | {f"--{key}": value for key, value in changes.items()}
        return run("render --quiet", *(word for pair in asked.items() for word in pair))

    return run_command


# Quickly: tests/placement/imaging and the sheet of tests/experiments/test_language.py
@pytest.mark.long
def test_three_images_are_written_and_the_vru_is_told(run_render):
    out = answer(run_render())
    stem = "results/renders/CPNC-50_east_40_day_frame-69_RSU3"
    files = [Path(f"{stem}{kind}.png") for kind in ("", "-instances", "-depth")]
    lines = out.splitlines()

    assert lines[:3] == [f"Written to {file}." for file in files]

    colours, instances, depth = (np.array(Image.open(file)) for file in files)
    assert colours.shape == instances.shape == (1080, 1920, 3)
    assert depth.shape == (1080, 1920)
    assert depth.dtype == np.uint16

    vru = instance_colours(("vru",))[0]
    rows, columns = np.nonzero((instances == vru).all(axis=2))

    assert len(rows) > 100
    assert lines[3].startswith(
        f"VRU: in view, visible box x {columns.min()} to {columns.max() + 1}, "
        f"y {rows.min()} to {rows.max() + 1} px"
    )
    # 24 m ahead and 6 m to the side of the camera, 8 m below it: about 30 m of depth.
    assert 2000 < np.median(depth[rows, columns]) < 3500

    sky = (instances == 0).all(axis=2)
    assert (depth[sky] == 0).all()


# Quickly: test_three_images_are_written_and_the_vru_is_told
@pytest.mark.long
def test_the_vut_looks_ahead_and_a_jpeg_is_smaller(run_render):
    answer(
        run_render(
            unit="VUT",
            out="look.jpg",
            weather="fog",
            seed="2",
        )
    )
    assert Path("look.jpg").read_bytes().startswith(b"\xff\xd8")
    assert Path("look.jpg").stat().st_size < 400_000
    assert Path("look-instances.png").exists()
    assert Path("look-depth.png").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"run": "CPNC-50/east"},
            "--run: got 'CPNC-50/east'; expected case/approach/speed or",
        ),
        ({"run": "CPXX/east/40"}, "--run CPXX/east/40: cases: got 'CPXX'; expected"),
        (
            {"weather": "snow"},
            "--weather: got 'snow'; expected one of day, fog, night, rain",
        ),
        (
            {"frame": "82"},
            "--frame: got 82; expected 0 to 81, or -82 to -1 from the end of CPNC-5",
        ),
        (
            {"unit": "RSU12"},
            "--unit: got 'RSU12'; expected one of RSU0, RSU1, RSU2, RSU3,",
        ),
        (
            {"out": "look.bmp"},
            "--out: got 'look.bmp'; expected a name that ends in .png, .jpg,",
        ),
        ({"seed": "-1"}, "--seed: got '-1'; expected a whole number, at least 0"),
    ],
)
def test_what_cannot_be_rendered_is_one_line(run_render, changes, message):
    line = refusal(run_render(**changes))
    assert line.startswith(f"{message}")
    assert list(Path().iterdir()) == []


def test_a_folder_that_is_not_there_is_one_line(run_render):
    assert refusal(run_render(out="no/look.png")).startswith(
        "--out: got no/look.png: No such file or directory; expected"
    )


def test_frames_count_from_both_ends():
    run = find_run("CPNC-50/east/40", load_study_scene())
    assert find_frame(run, -1) == len(run.time_s) - 1
    assert run.time_s[find_frame(run, -1)] == 0.0
    assert find_frame(run, 0) == 0
    with pytest.raises(InputError):
        find_frame(run, len(run.time_s))


def test_the_weather_of_the_id_holds_unless_another_is_given():
    scene = load_study_scene()
    assert find_run("CBNA/east/60", scene).weather == "day"
    for run_id in (
        "CPLA-50/north-15/33",
        "CPLA-50/north+0/25/night",
        "CPLA-50/north/25",
    ):
        assert find_run(run_id, scene).id == run_id
    assert find_run("CBNA/east/60/rain", scene).weather == "rain"
    assert find_run("CBNA/east/60/rain", scene, weather="fog").weather == "fog"


def test_colours_of_things_differ_and_the_vrus_is_the_lightest():
    names = tuple(f"thing-{index}" for index in range(80)) + ("vut", "vru")
    colours = instance_colours(names).astype(float)
    assert len(np.unique(colours, axis=0)) == len(names) + 1

    grey = colours @ [0.2126, 0.7152, 0.0722]
    assert grey.argmax() == names.index("vru")
    assert (colours[-1] == 0.0).all()


@pytest.mark.long
def test_a_lidar_writes_points_that_others_can_read(run, tmp_path):
    import trimesh

    command = "render --layout carlancap-12 --run CBLA/west/50 --frame -11"
    cloud = tmp_path / "a.ply"
    raw = tmp_path / "a.bin"
    out = answer(run(command, "--unit VUT-LIDAR --out", cloud, "--quiet"))
    points = trimesh.load(cloud).vertices

    assert out.splitlines()[0] == f"Written to {cloud}."
    assert out.splitlines()[1].endswith(f" of {len(points)} points.")

    answer(run(command, "--unit vut-lidar --out", raw, "--quiet"))
    numbers = np.fromfile(raw, dtype="<f4").reshape(-1, 4)

    assert numbers[:, :3] == pytest.approx(np.asarray(points), abs=1e-4)
    assert ((numbers[:, 3] > 0.0) & (numbers[:, 3] <= 1.0)).all()

    code, _, error = run(
        command, "--unit VUT-LIDAR --out", tmp_path / "a.png", "--quiet"
    )
    assert code == 2
    assert error.endswith("expected a name that ends in .ply, .bin\n")
