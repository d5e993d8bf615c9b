import numpy as np
import pytest

from experiments.figures.axes import to_png
from experiments.parts.sampled_worlds import build_sampled_record, plot_sampled_apr
from geometry.poses import Pose
from placement.candidates import CandidatePose
from placement.layout import Layout
from placement.sampling.out_of_sample import SampledApr
from placement.sampling.uncertainty import Uncertainty


@pytest.fixture
def judged(frame_axis, camera):
    unit = CandidatePose(
        id="U1",
        site_id="",
        pose=Pose(position_m=[0.0, 0.0, 6.0], yaw_deg=0.0),
        sensor=camera,
    )
    generator = np.random.default_rng(3)
    return [
        SampledApr(
            layout=Layout(name=f"_layout ${number}$", units=(unit,)),
            axis=frame_axis,
            apr_by_sample=generator.uniform(0.2, 0.8, 6),
            avoided_share=np.ones(3),
        )
        for number in range(5)
    ]


def record(judged):
    return build_sampled_record(judged, Uncertainty(), tail=1.0, seed=0)


def dots(axes):
    return [
        (container[0].get_xdata()[0], container[0].get_ydata()[0])
        for container in axes.containers
    ]


def test_each_layout_has_a_dot_at_its_mean(judged):
    axes = plot_sampled_apr(record(judged))
    means = [100.0 * item.estimate.mean for item in judged]
    assert [x for x, _ in dots(axes)] == pytest.approx(means)
    assert [label.get_text() for label in axes.get_yticklabels()] == [
        rf" _layout \${number}\$" for number in range(len(judged))
    ]
    low, high = axes.get_ylim()
    assert low > high  # the first one on top
    assert to_png(axes).startswith(b"\x89PNG")


def test_whiskers_are_the_intervals_and_thin_lines_the_worlds(judged):
    axes = plot_sampled_apr(record(judged[:2]))
    for container, item in zip(axes.containers, judged, strict=False):
        (bar,) = container[2]
        (segment,) = bar.get_segments()
        assert segment[:, 0] == pytest.approx(
            [100.0 * item.estimate.low, 100.0 * item.estimate.high]
        )
    spans = [line.get_segments()[0][:, 0] for line in axes.collections[:1]]
    assert spans[0] == pytest.approx(
        [100.0 * judged[0].apr_by_sample.min(), 100.0 * judged[0].apr_by_sample.max()]
    )
