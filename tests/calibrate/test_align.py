"""Frames that moved are found to a twentieth of a photosite; frames that did not are left alone."""

import dataclasses
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt
import pytest

from calibrate import CalibrateError
from calibrate.align import AlignedFrame, find_displacements, shifted
from calibrate.merge import Asked, measure_bracket, merge_mosaics
from tests.calibrate.brackets import TIMES, WHITE, Frame, photograph

SHAPE = (400, 520)
MARGIN = 40
OVER = 4
CLIP = np.array([WHITE] * 4)


def place(seed: int, shape: tuple[int, int] = SHAPE) -> npt.NDArray[np.float32]:
    """A scene of hills and boxes over some decades, four times as fine as the photosites."""
    rng = np.random.default_rng(seed)
    height, width = ((n + 2 * MARGIN) * OVER for n in shape)
    coarse = rng.standard_normal((height // 128 + 2, width // 128 + 2)).astype(np.float32)
    hills = cv2.resize(cv2.GaussianBlur(coarse, (0, 0), 1.5), (width, height), interpolation=cv2.INTER_CUBIC)
    hills = (hills - hills.min()) / (hills.max() - hills.min())
    image = 10 ** (-2.5 + 3.0 * hills)
    for _ in range(150):
        x, y = rng.integers(0, width), rng.integers(0, height)
        w, h = rng.integers(20, 300, 2)
        image[y : y + h, x : x + w] *= 10 ** rng.uniform(-0.6, 0.6)
    return cv2.GaussianBlur(image, (0, 0), 2.0)


def seen(scene: npt.NDArray[np.float32], rows: float, columns: float, shape: tuple[int, int] = SHAPE) -> Any:
    """What the photosites see of a scene from a place that is off by some quarters of a photosite."""
    y, x = round((MARGIN + rows) * OVER), round((MARGIN + columns) * OVER)
    part = scene[y : y + OVER * shape[0], x : x + OVER * shape[1]].astype(np.float64)
    return part.reshape(shape[0], OVER, shape[1], OVER).mean(axis=(1, 3))


def handheld(seed: int, most: float) -> tuple[list[Frame], list[tuple[float, float]]]:
    rng = np.random.default_rng(seed)
    scene = place(seed)
    shifts = [tuple(np.round(rng.uniform(-most, most, 2) * OVER) / OVER) for _ in TIMES[1:5]]
    frames = []
    for n, (time, shift) in enumerate(zip(TIMES[1:5], shifts, strict=True)):
        (frame,) = photograph(seen(scene, *shift), [time], seed=10 * seed + n)
        frame.info = dataclasses.replace(frame.info, name=f"{n}.dng")
        frames.append(frame)
    return frames, shifts


def errors(seed: int, most: float) -> list[float]:
    frames, shifts = handheld(seed, most)
    found = find_displacements(frames, measure_bracket(frames, Asked()).exposures)
    (reference,) = [n for n, d in enumerate(found) if d.shift == (0.0, 0.0)]
    return [
        float(np.hypot(*(np.array(d.shift) - (np.array(shifts[reference]) - np.array(shifts[n])))))
        for n, d in enumerate(found)
        if n != reference
    ]


def test_shifts_up_to_thirty_photosites_are_found() -> None:
    # One scene; the median of many is below.
    assert max(errors(2, 21.0)) < 0.2


@pytest.mark.slow
def test_shifts_are_found_to_a_twentieth_in_many_scenes() -> None:
    off = [e for seed in (1, *range(3, 11)) for e in errors(seed, 21.0)]
    assert np.median(off) < 0.05


def tripod(seed: int) -> list[Frame]:
    """Small frames of one place under clouds that drift."""
    shape = (240, 320)
    still = seen(place(seed, shape), 0, 0, shape)
    clouds = np.random.default_rng(seed).standard_normal(shape)
    frames = []
    for n, time in enumerate(TIMES[1:5]):
        drift = cv2.GaussianBlur(np.roll(clouds, 4 * n, axis=1), (0, 0), 6)
        image = still.copy()
        image[:90] *= (1 + 0.6 * drift / np.abs(drift).max())[:90]
        (frame,) = photograph(image, [time], seed=100 * seed + n)
        frame.info = dataclasses.replace(frame.info, name=f"{n}.dng")
        frames.append(frame)
    return frames


def moved(seed: int) -> int:
    frames = tripod(seed)
    return sum(d.moved for d in find_displacements(frames, measure_bracket(frames, Asked()).exposures))


def test_a_set_from_a_tripod_under_drifting_clouds_is_not_moved() -> None:
    assert sum(moved(seed) for seed in range(2)) == 0


@pytest.mark.slow
def test_fifty_sets_from_a_tripod_are_not_moved() -> None:
    assert sum(moved(seed) for seed in range(50)) == 0


def test_a_scene_without_structure_is_not_moved() -> None:
    frames = photograph(np.full((240, 320), 0.05), TIMES[1:4], seed=1)
    found = find_displacements(frames, measure_bracket(frames, Asked()).exposures)
    assert not any(d.moved for d in found)


def test_a_frame_of_another_scene_is_refused_by_name() -> None:
    frames, _ = handheld(4, 5.0)
    strangers, _ = handheld(54, 5.0)
    mixed = [*frames[:3], strangers[3]]
    with pytest.raises(CalibrateError) as caught:
        find_displacements(mixed, measure_bracket(mixed, Asked()).exposures)
    (line,) = str(caught.value).splitlines()
    assert line.startswith("3.dng: has nothing in common with 2.dng, its neighbour in exposure: 0 of ")
    assert line.endswith("Take the one that shows something else out of the bracket, or set `merge.align: false`.")


def test_an_even_shift_moves_the_counts_themselves() -> None:
    mosaic = np.random.default_rng(1).integers(500, 16000, (20, 24), dtype=np.uint16)
    out = shifted(mosaic, (4.0, -2.0), clip=CLIP, step=2)
    np.testing.assert_array_equal(out[:16, 2:], mosaic[4:, :-2])
    assert np.all(out[16:] == 65535)
    assert np.all(out[:, :2] == 65535)


def test_a_fraction_of_a_shift_is_exact_on_what_a_cubic_can_follow() -> None:
    y, x = np.mgrid[0:40, 0:50].astype(float)
    colours = np.where((np.mgrid[0:40, 0:50].sum(axis=0)) % 2 == 0, 0.0, 3000.0)  # two colours of a checkerboard

    def surface(y: Any, x: Any) -> Any:
        return 4000 + 30 * y - 20 * x + 1.5 * x * x / 10

    mosaic = np.rint(surface(y, x) + colours).astype(np.uint16)
    for shift in ((0.4, -0.7), (3.3, 1.0), (-2.6, -0.25)):
        out = shifted(mosaic, shift, clip=CLIP, step=2)
        inside = np.s_[8:-8, 8:-8]
        expected = surface(y + shift[0], x + shift[1]) + colours
        # Two roundings to whole counts, of the samples and of the result.
        np.testing.assert_allclose(out[inside], expected[inside], atol=1.3)


def test_what_leans_on_a_clipped_sample_counts_as_clipped() -> None:
    mosaic = np.full((20, 20), 1000, np.uint16)
    mosaic[10, 10] = 16383
    out = shifted(mosaic, (0.5, 0.5), clip=CLIP, step=2)
    lost = np.argwhere(out[6:-6, 6:-6] == 65535) + 6
    # Only the grid of its own colour, within the reach of the cubic.
    assert np.all(lost % 2 == 0)
    assert len(lost) == 16
    assert np.all((out == 1000) | (out == 65535))


def test_moved_frames_are_merged_to_the_place_of_the_reference() -> None:
    frames, shifts = handheld(4, 10.0)
    measured = measure_bracket(frames, Asked())
    found = find_displacements(frames, measured.exposures)
    placed = [
        AlignedFrame(f, d.shift, e.clip) if d.moved else f
        for f, d, e in zip(frames, found, measured.exposures, strict=True)
    ]
    (reference,) = [n for n, d in enumerate(found) if d.shift == (0.0, 0.0)]
    truth = seen(place(4), *shifts[reference])
    inside = np.s_[20:-20, 20:-20]

    def error(merged: Any) -> float:
        return float(np.nanmean(np.abs(np.log(np.maximum(merged.mosaic, 1e-4) / truth))[inside]))

    aligned = error(merge_mosaics(placed, measured=measure_bracket(placed, Asked()), defects=False))
    assert aligned < 0.35 * error(merge_mosaics(frames, measured=measured, defects=False))


def test_frames_that_cannot_be_aligned_are_refused() -> None:
    frames = photograph(np.full((240, 320), 0.05), TIMES[1:3], seed=1)
    exposures = measure_bracket(frames).exposures
    for f in frames:
        f.info = dataclasses.replace(f.info, cfa="RGB")
    with pytest.raises(CalibrateError, match=r"`merge\.align: false`"):
        find_displacements(frames, exposures)
    small = photograph(np.full((60, 320), 0.05), TIMES[1:3], seed=1)
    with pytest.raises(CalibrateError, match="at least 128"):
        find_displacements(small, exposures)
