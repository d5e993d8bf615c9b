"""A response table fitted to detections that were drawn from a known one."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.random import default_rng
from numpy.testing import assert_allclose
from scipy.special import ndtr
from scipy.stats import multivariate_normal

from geometry.errors import InputError
from placement.detectors import load_planning_detector
from placement.detectors.evidence import linked_noise
from placement.detectors.fitting import (
    Sightings,
    fit_lasting_share,
    fit_response,
    joint_normal,
)

N_TRACKS = 250
N_FRAMES = 30
TRUTH = replace(
    load_planning_detector("response"),
    seen_share=[0.0, 0.25, 0.5, 0.75, 1.0],
    recall=[0.0, 0.3, 0.6, 0.9, 0.95],
    height_half_px=35.0,
    height_steepness=4.0,
    min_box_height_px=1.0,
    class_factor=[1.0, 0.8, 0.9, 0.7, 1.0],
    cyclist_end_on=0.7,
    frame_correlation=0.6,
    box_noise_share=0.04,
)


SOME = np.arange(0, 2400)  # the first tracks


def drawn(truth=TRUTH, *, seed=1, classes=(0, 1, 2, 3, 4), contrasts=(0.1, 0.3, 1.0)):
    """Sightings of many road users that come nearer, drawn from a table."""
    rng = default_rng(seed)
    n = N_TRACKS * N_FRAMES
    tracks = np.arange(N_TRACKS)
    track = np.repeat(tracks, N_FRAMES)
    frames = np.arange(N_FRAMES)
    frame = np.tile(frames, N_TRACKS)
    low = np.log(12)
    high = np.log(180)
    first_px = np.exp(rng.uniform(low, high, N_TRACKS))
    track_shares = rng.uniform(0.0, 1.8, N_TRACKS)
    scatter = rng.normal(0, 0.05, n)
    shares = track_shares[track] + scatter
    box_error = np.full((n, 4), np.nan)
    sightings = Sightings(
        height_px=first_px[track] * (1 + 0.01 * frame),
        seen_share=np.clip(shares, 0.0, 1.0),
        contrast=rng.choice(contrasts, N_TRACKS)[track],
        aspect_deg=rng.uniform(0.0, 90.0, N_TRACKS)[track],
        vru_class=rng.choice(classes, N_TRACKS)[track],
        is_found=np.zeros(n, dtype=bool),
        box_error=box_error,
        track=track,
        frame=frame,
    )
    position = frame + track * (N_FRAMES + 1)
    noise = linked_noise(position, truth.frame_correlation, rng)
    evidence = sightings.evidence()
    probability = truth.probability(evidence)
    is_found = ndtr(noise) < probability
    error = rng.normal(0.0, truth.box_noise_share, (n, 4))
    error[~is_found] = np.nan
    return replace(sightings, is_found=is_found, box_error=error)


@pytest.mark.long
@pytest.mark.parametrize("share", [0.0, 0.4])
def test_the_share_that_lasts_for_a_track_is_found(share):
    """Noise drawn as a sampled world draws it, of tracks that are found as often as
    missed.
    """
    rng = default_rng(2)
    sightings = drawn()
    before = sightings.track * (N_FRAMES + 1)
    position = sightings.frame + before
    linked = linked_noise(position, 0.5, rng)
    track_noise = rng.standard_normal(N_TRACKS)
    lasts = track_noise[sightings.track]
    lasting_part = np.sqrt(share)
    linked_part = np.sqrt(1.0 - share)
    noise = lasting_part * lasts + linked_part * linked
    track_probability = rng.uniform(0.3, 0.9, N_TRACKS)
    probability = track_probability[sightings.track]
    seen = replace(sightings, is_found=ndtr(noise) < probability)

    fitted = fit_lasting_share(seen, probability, draws=100)

    assert fitted.low <= share <= fitted.high
    assert fitted.value == pytest.approx(share, abs=0.1)
    assert fitted.high - fitted.low < 0.35


@pytest.mark.long
def test_without_consecutive_frames_nothing_is_known_of_what_lasts():
    frames = np.arange(N_FRAMES)
    frame = np.tile(200 * frames, N_TRACKS)
    sightings = replace(drawn(), frame=frame)
    half = np.full(len(sightings), 0.5)

    with pytest.raises(
        InputError, match=r"^frames: got none consecutive; expected consecutive "
    ):
        fit_lasting_share(sightings, half, draws=2)


@pytest.fixture(scope="module")
def fit():
    """The response fitted to the frames drawn from the truth."""
    return fit_response(drawn(), name="mine", draws=8)


@pytest.mark.long
def test_the_table_that_was_drawn_from_is_found_again(fit):
    found = fit.detector
    truth = np.interp(found.seen_share, TRUTH.seen_share, TRUTH.recall)

    assert_allclose(found.recall, truth, atol=0.09)
    assert_allclose(found.class_factor, TRUTH.class_factor, atol=0.1)
    assert found.height_half_px == pytest.approx(35.0, rel=0.1)
    assert found.height_steepness == pytest.approx(4.0, rel=0.2)
    assert found.cyclist_end_on == pytest.approx(0.7, abs=0.15)
    assert found.frame_correlation == pytest.approx(0.6, abs=0.08)
    assert found.box_noise_share == pytest.approx(0.04, rel=0.1)
    assert found.name == "mine"


@pytest.mark.long
def test_calibration_counts_every_frame_and_fits(fit):
    n_frames = sum(group.frames for group in fit.calibration)
    n_found = sum(group.found for group in fit.calibration)

    assert n_frames == fit.frames == N_TRACKS * N_FRAMES
    assert n_found == fit.found

    for group in fit.calibration:
        assert group.recall.value == pytest.approx(group.expected, abs=0.12)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["height", "seen", "class", "aspect", "contrast"])
def test_groups_count_every_frame_once(fit, kind):
    n_frames = sum(group.frames for group in fit.groups[kind])
    n_found = sum(group.found for group in fit.groups[kind])

    assert n_frames == fit.frames
    assert n_found == fit.found


@pytest.mark.long
def test_intervals_hold_their_figures(fit):
    for interval in fit.intervals.values():
        assert interval.low <= interval.value <= interval.high
    assert fit.intervals["height_half_px"].low < fit.intervals["height_half_px"].high


@pytest.mark.long
def test_classes_and_light_that_never_appear_are_as_built_in():
    sightings_drawn = drawn(classes=(0,), contrasts=(1.0,))
    sightings = sightings_drawn.take(SOME)
    built_in = load_planning_detector("response")

    fit = fit_response(sightings, name="a", draws=0)
    found = fit.detector
    names = [group.name for group in fit.groups["class"]]

    assert_allclose(found.class_factor, 1.0)
    assert not fit.is_contrast_fitted
    assert found.contrast_half == pytest.approx(built_in.contrast_half)
    assert found.contrast_steepness == pytest.approx(built_in.contrast_steepness)
    assert names == ["pedestrian"]


@pytest.mark.long
def test_frames_that_are_not_consecutive_tell_no_correlation():
    sightings = drawn().take(SOME)
    spread = replace(sightings, frame=2 * sightings.frame)
    fitted = fit_response(spread, name="a", draws=0)

    assert fitted.detector.frame_correlation == 0.0


@pytest.mark.parametrize("kept", [10, 400])
def test_too_few_frames_are_refused(kept):
    kept_rows = np.arange(kept)
    sightings = drawn().take(kept_rows)
    box_error = np.full((kept, 4), np.nan)
    nothing = replace(
        sightings,
        is_found=np.zeros(kept, dtype=bool),
        box_error=box_error,
    )

    with pytest.raises(
        InputError, match=rf"got {kept}, 0 of them found; expected at least 50"
    ):
        fit_response(nothing, name="a")


@pytest.mark.parametrize("correlation", [0.0, 0.3, 0.9, 0.98])
def test_joint_probabilities_are_those_of_scipy(correlation):
    first = np.array([-2.0, 0.0, 0.5, 1.5])
    second = np.array([0.3, 0.0, -1.0, 1.4])
    covariance = [[1.0, correlation], [correlation, 1.0]]
    law = multivariate_normal(cov=covariance)
    pairs = zip(first, second, strict=True)
    expected = [law.cdf(pair) for pair in pairs]
    joint = joint_normal(first, second, correlation)

    assert_allclose(joint, expected, atol=1e-5)
