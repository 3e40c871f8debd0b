"""A walking figure is left out of the merge where noise shows it; where nothing moves, every frame counts."""

import dataclasses
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from calibrate import CalibrateError
from calibrate.deghost import find_ghosts
from calibrate.merge import Asked, measure_bracket, merge_mosaics
from tests.calibrate.brackets import TIMES, Frame, photograph, scene

SHAPE = (320, 480)
WALK = np.s_[100:260, 30:470]


def walk(seed: int, figure: float) -> tuple[list[Frame], list[npt.NDArray[np.float64]]]:
    """A figure of some radiance walks to the right, a frame a step."""
    base = scene(SHAPE, seed=seed, low=-2.0, high=1.2)
    texture = 1 + 0.3 * np.random.default_rng(seed).random((160, 50))
    frames, truths = [], []
    for n, time in enumerate(TIMES):
        image = base.copy()
        image[100:260, 40 + 60 * n : 90 + 60 * n] = figure * texture
        (frame,) = photograph(image, [time], seed=10 * seed + n)
        frame.info = dataclasses.replace(frame.info, name=f"{n}.dng")
        frames.append(frame)
        truths.append(image)
    return frames, truths


# What noise alone leaves beyond 3 σ.
CHANCE = 0.0027


def beyond(seed: int, figure: float) -> tuple[float, float]:
    """The share of the walk beyond 3 σ of what the reference saw: of the plain merge, and without what moved."""
    frames, truths = walk(seed, figure)
    measured = measure_bracket(frames, Asked())
    ghosts = find_ghosts(frames, measured.exposures)
    # What the reference clips is taken from a shorter frame, in which the figure stands elsewhere.
    clipped = frames[ghosts.reference].counts >= 16383
    quads = clipped.reshape(160, 2, 240, 2).any(axis=(1, 3))
    clipped = quads.repeat(2, axis=0).repeat(2, axis=1)[WALK]

    def share(masks: Any) -> float:
        merged = merge_mosaics(frames, measured=measured, deviation=True, defects=False, ghosts=masks)
        assert merged.deviation is not None
        z = ((merged.mosaic - truths[ghosts.reference]) / merged.deviation)[WALK]
        return float(np.mean(np.abs(z[~clipped & np.isfinite(z)]) > 3))

    return share(None), share(ghosts.masks)


def test_a_walking_figure_leaves_no_ghost_above_three_sigma() -> None:
    plain, clean = beyond(1, 0.02)
    assert plain > 0.1
    assert clean < CHANCE


@pytest.mark.slow
# As dark as shadow, as bright as what it hides, brighter than what the long frames can tell.
@pytest.mark.parametrize(("seed", "figure"), [(6, 0.005), (3, 0.1), (4, 0.4), (2, 1.5), (5, 5.0)])
def test_no_figure_leaves_a_ghost_whatever_its_brightness(seed: int, figure: float) -> None:
    plain, clean = beyond(seed, figure)
    assert plain > 0.1
    assert clean < CHANCE


@pytest.mark.parametrize("seed", [0])
def test_where_nothing_moves_no_frame_is_left_out(seed: int) -> None:
    frames = photograph(scene(SHAPE, seed=seed), seed=seed)
    measured = measure_bracket(frames, Asked())
    ghosts = find_ghosts(frames, measured.exposures)
    assert ghosts.shares == (0.0,) * len(frames)
    with_masks = merge_mosaics(frames, measured=measured, ghosts=ghosts.masks)
    without = merge_mosaics(frames, measured=measured)
    np.testing.assert_array_equal(with_masks.mosaic, without.mosaic)
    assert with_masks.ghosts is not None
    assert not with_masks.ghosts.any()
    assert without.ghosts is None


def test_nothing_is_lost_by_leaving_frames_out() -> None:
    frames, _ = walk(3, 1.5)
    measured = measure_bracket(frames, Asked())
    ghosts = find_ghosts(frames, measured.exposures)
    merged = merge_mosaics(frames, measured=measured, ghosts=ghosts.masks, defects=False)
    assert merged.lost_count == merge_mosaics(frames, measured=measured, defects=False).lost_count
    assert merged.ghosts is not None
    assert merged.ghosts[WALK].mean() > 0.5
    assert not merged.ghosts[:80].any()
    assert sum(use.ghosts for use in merged.frames) > 1000


def test_odd_sizes_are_compared_to_the_border() -> None:
    frames = photograph(scene((81, 95), seed=4), seed=4)
    ghosts = find_ghosts(frames, measure_bracket(frames, Asked()).exposures)
    assert ghosts.masks[0].shape == (41, 48)
    merged = merge_mosaics(frames, ghosts=ghosts.masks)
    assert merged.ghosts is not None
    assert merged.ghosts.shape == (81, 95)


def test_frames_without_a_two_by_two_pattern_are_refused() -> None:
    frames = photograph(scene((40, 40), seed=4), TIMES[:2])
    exposures = measure_bracket(frames).exposures
    for f in frames:
        f.info = dataclasses.replace(f.info, cfa="RGB")
    with pytest.raises(CalibrateError, match=r"`merge\.deghost: false`"):
        find_ghosts(frames, exposures)
