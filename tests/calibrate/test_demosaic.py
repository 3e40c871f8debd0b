"""Demosaicing: exact where the image allows it, bounded where it does not."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from calibrate import CalibrateError
from calibrate.demosaic import demosaic, lost_pixels
from calibrate.exposure import BAYER_PATTERNS

Image = npt.NDArray[np.float32]

# Two rows and columns beside the border see reflected samples, which bend a ramp.
INSIDE = (slice(2, -2), slice(2, -2))
# float32 keeps 24 bits; one rounding of the sample, one of the result.
ROUNDING = 2.0**-22


def sampled(image: npt.NDArray[Any], cfa: str) -> Image:
    mosaic = np.empty(image.shape[:2], np.float32)
    for k, colour in enumerate(cfa):
        places = np.s_[k // 2 :: 2, k % 2 :: 2]
        mosaic[places] = image[..., "RGB".index(colour)][places]
    return mosaic


def own_sample(shape: tuple[int, int], cfa: str) -> npt.NDArray[np.bool_]:
    mask = np.zeros((*shape, 3), np.bool_)
    for k, colour in enumerate(cfa):
        mask[k // 2 :: 2, k % 2 :: 2, "RGB".index(colour)] = True
    return mask


def slow_malvar(mosaic: Image, cfa: str, y: int, x: int, colour: int) -> float:
    """The paper's 5×5 filters (figure 2), written out; held between the nearest samples of the colour."""
    cross = {(-2, 0): -1, (2, 0): -1, (0, -2): -1, (0, 2): -1, (0, 0): 4, (-1, 0): 2, (1, 0): 2, (0, -1): 2, (0, 1): 2}
    row = {(0, 0): 5, (0, -1): 4, (0, 1): 4, (0, -2): -1, (0, 2): -1, (-2, 0): 0.5, (2, 0): 0.5}
    row |= {(dy, dx): -1 for dy in (-1, 1) for dx in (-1, 1)}
    corners = {(0, 0): 6.0, (-2, 0): -1.5, (2, 0): -1.5, (0, -2): -1.5, (0, 2): -1.5}
    corners |= {(dy, dx): 2 for dy in (-1, 1) for dx in (-1, 1)}

    def colour_at(j: int, i: int) -> int:
        return "RGB".index(cfa[2 * (j % 2) + i % 2])

    here = colour_at(y, x)
    if here == colour:
        return float(mosaic[y, x])
    if colour == 1:
        kernel = cross
    elif here != 1:
        kernel = corners
    elif colour_at(y, x + 1) == colour:
        kernel = row
    else:
        kernel = {(dx, dy): v for (dy, dx), v in row.items()}
    value = sum(v * float(mosaic[y + dy, x + dx]) for (dy, dx), v in kernel.items()) / 8
    near = [
        float(mosaic[y + dy, x + dx]) for dy in (-1, 0, 1) for dx in (-1, 0, 1) if colour_at(y + dy, x + dx) == colour
    ]
    return min(max(value, min(near)), max(near))


@pytest.mark.parametrize("cfa", BAYER_PATTERNS)
def test_the_filters_are_those_of_the_paper_held_between_the_nearest_samples(cfa: str) -> None:
    mosaic = np.random.default_rng(3).random((10, 11)).astype(np.float32)
    image = demosaic(mosaic, cfa)
    for y in range(2, 8):
        for x in range(2, 9):
            for colour in range(3):
                expected = np.float32(slow_malvar(mosaic, cfa, y, x, colour))
                assert image[y, x, colour] == pytest.approx(expected, rel=ROUNDING)


@pytest.mark.parametrize("cfa", BAYER_PATTERNS)
def test_a_constant_image_comes_out_exact_up_to_the_border(cfa: str) -> None:
    image = np.broadcast_to(np.float32([0.1, 700.0, 3e-6]), (13, 16, 3))
    np.testing.assert_array_equal(demosaic(sampled(image, cfa), cfa), image)


@pytest.mark.parametrize("cfa", BAYER_PATTERNS)
def test_linear_ramps_of_each_colour_come_out_exact(cfa: str) -> None:
    y, x = np.mgrid[0:20, 0:24]
    image = np.stack([3 * x + y, 40 - x + 2 * y, 7 * x - 5 * y + 200], axis=-1).astype(np.float32)
    np.testing.assert_array_equal(demosaic(sampled(image, cfa), cfa)[INSIDE], image[INSIDE])


@pytest.mark.parametrize("cfa", BAYER_PATTERNS)
def test_measured_samples_pass_through_untouched(cfa: str) -> None:
    mosaic = (10 ** np.random.default_rng(5).uniform(-4, 4, (30, 31))).astype(np.float32)
    image = demosaic(mosaic, cfa)
    mine = own_sample((30, 31), cfa)
    np.testing.assert_array_equal(image[mine], mosaic.ravel())


def test_scaling_the_light_scales_the_image() -> None:
    mosaic = np.random.default_rng(7).standard_normal((20, 22)).astype(np.float32)
    np.testing.assert_array_equal(demosaic(mosaic * np.float32(1024), "GBRG"), demosaic(mosaic, "GBRG") * 1024)


@pytest.mark.parametrize("cfa", BAYER_PATTERNS)
def test_nothing_rings_beside_a_lamp_of_a_hundred_thousand_to_one(cfa: str) -> None:
    rng = np.random.default_rng(9)
    image = rng.uniform(0.5, 1.0, (40, 40, 3))
    image[10:20, 12:23] *= 1e5
    image[30, 30] *= 1e5
    mosaic = sampled(image, cfa)
    result = demosaic(mosaic, cfa)
    mine = own_sample(mosaic.shape, cfa)
    for colour in range(3):
        padded = np.pad(np.where(mine[..., colour], mosaic, np.nan), 1, mode="reflect")
        around = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
        smallest, largest = np.nanmin(around, axis=(2, 3)), np.nanmax(around, axis=(2, 3))
        assert np.all(result[..., colour] >= smallest)
        assert np.all(result[..., colour] <= largest)


def test_flipping_the_mosaic_flips_the_image_and_the_pattern() -> None:
    mosaic = np.random.default_rng(11).random((24, 26)).astype(np.float32)
    image = demosaic(mosaic, "RGGB")
    np.testing.assert_array_equal(demosaic(mosaic[:, ::-1], "GRBG")[:, ::-1], image)
    np.testing.assert_array_equal(demosaic(mosaic[::-1], "GBRG")[::-1], image)
    np.testing.assert_array_equal(demosaic(mosaic[::-1, ::-1], "BGGR")[::-1, ::-1], image)


def test_a_lost_sample_is_missing_only_where_it_is_nearest() -> None:
    mosaic = np.random.default_rng(13).random((16, 16)).astype(np.float32)
    whole = demosaic(mosaic, "RGGB")
    mosaic[8, 8] = np.nan  # a red site
    image = demosaic(mosaic, "RGGB")
    red_reach = np.zeros((16, 16), np.bool_)
    red_reach[7:10, 7:10] = True
    np.testing.assert_array_equal(np.isnan(image[..., 0]), red_reach)
    assert not np.isnan(image[..., 1:]).any()
    np.testing.assert_array_equal(lost_pixels(image), red_reach)
    # The other colours there are the plain mean of their neighbours: the Laplacian of red is not known.
    assert image[8, 8, 1] == pytest.approx(np.mean([mosaic[7, 8], mosaic[9, 8], mosaic[8, 7], mosaic[8, 9]]))
    # Nothing changes farther away than the filter reaches.
    far = np.ones((16, 16), np.bool_)
    far[6:11, 6:11] = False
    np.testing.assert_array_equal(image[far], whole[far])


def test_a_mask_loses_samples_as_nan_does_and_leaves_the_mosaic_alone() -> None:
    mosaic = np.random.default_rng(17).random((12, 14)).astype(np.float32)
    lost = np.zeros(mosaic.shape, np.bool_)
    lost[5, 6:9] = True
    kept = mosaic.copy()
    by_mask = demosaic(mosaic, "GRBG", lost=lost)
    np.testing.assert_array_equal(mosaic, kept)
    np.testing.assert_array_equal(by_mask, demosaic(np.where(lost, np.float32(np.nan), mosaic), "GRBG"))
    np.testing.assert_array_equal(by_mask, demosaic(np.where(lost, np.float32(np.inf), mosaic), "GRBG"))


@pytest.mark.parametrize("shape", [(4, 4), (5, 7), (7, 4)])
def test_small_and_odd_mosaics_keep_their_pattern_to_the_border(shape: tuple[int, int]) -> None:
    image = np.broadcast_to(np.float32([1, 2, 3]), (*shape, 3))
    for cfa in BAYER_PATTERNS:
        np.testing.assert_array_equal(demosaic(sampled(image, cfa), cfa), image)


@pytest.mark.parametrize(
    ("mosaic", "cfa", "lost", "said"),
    [
        (np.ones((8, 8), np.float32), "RGBG", None, "'RGBG'; one of"),
        (np.ones((8, 8, 3), np.float32), "RGGB", None, "not an image"),
        (np.ones((3, 8), np.float32), "RGGB", None, "at least 4×4"),
        (np.ones((8, 8), np.float32), "RGGB", np.zeros((8, 9), np.bool_), "they must agree"),
    ],
)
def test_what_is_no_mosaic_is_refused(mosaic: Image, cfa: str, lost: npt.NDArray[np.bool_] | None, said: str) -> None:
    with pytest.raises(CalibrateError, match=said):
        demosaic(mosaic, cfa, lost=lost)
