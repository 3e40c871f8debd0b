"""Demosaicing: exact where the image allows it, bounded where it does not."""

from typing import Any

import cv2
import numba
import numpy as np
import numpy.typing as npt
import pytest

from calibrate import CalibrateError
from calibrate.demosaic import METHODS, demosaic, lost_pixels, spread
from calibrate.demosaic.scale import to_light, to_log
from calibrate.exposure import BAYER_PATTERNS

Image = npt.NDArray[np.float32]

# Two rows and columns beside the border see reflected samples, which bend a ramp.
INSIDE = (slice(2, -2), slice(2, -2))
# float32 keeps 24 bits; one rounding of the sample, one of the result.
ROUNDING = 2.0**-22
# A polynomial to 1e-7, and a few roundings.
FLOAT32 = 4e-7


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
    image = demosaic(mosaic, cfa, method="malvar")
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
    malvar = demosaic(sampled(image, cfa), cfa, method="malvar")
    np.testing.assert_array_equal(malvar[INSIDE], image[INSIDE])
    # In the logarithmic scale a straight line is a curve; what is left of it is small where the line is not steep.
    # The border's reflection bends the line for as far as the method reaches.
    gentle = image + np.float32(1000)
    inside = np.s_[7:-7, 7:-7]
    np.testing.assert_allclose(demosaic(sampled(gentle, cfa), cfa)[inside], gentle[inside], rtol=5e-4)


@pytest.mark.parametrize("cfa", BAYER_PATTERNS)
def test_measured_samples_pass_through_untouched(cfa: str) -> None:
    mosaic = (10 ** np.random.default_rng(5).uniform(-4, 4, (30, 31))).astype(np.float32)
    image = demosaic(mosaic, cfa)
    mine = own_sample((30, 31), cfa)
    np.testing.assert_array_equal(image[mine], mosaic.ravel())


@pytest.mark.parametrize("method", METHODS)
def test_scaling_the_light_scales_the_image(method: Any) -> None:
    mosaic = np.random.default_rng(7).standard_normal((20, 22)).astype(np.float32)
    brighter = demosaic(mosaic * np.float32(1024), "GBRG", method=method)
    np.testing.assert_array_equal(brighter, demosaic(mosaic, "GBRG", method=method) * 1024)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("cfa", BAYER_PATTERNS)
def test_nothing_rings_beside_a_lamp_of_a_hundred_thousand_to_one(cfa: str, method: Any) -> None:
    rng = np.random.default_rng(9)
    image = rng.uniform(0.5, 1.0, (40, 40, 3))
    image[10:20, 12:23] *= 1e5
    image[30, 30] *= 1e5
    mosaic = sampled(image, cfa)
    result = demosaic(mosaic, cfa, method=method)
    mine = own_sample(mosaic.shape, cfa)
    for colour in range(3):
        padded = np.pad(np.where(mine[..., colour], mosaic, np.nan), 1, mode="reflect")
        around = np.lib.stride_tricks.sliding_window_view(padded, (3, 3))
        smallest, largest = np.nanmin(around, axis=(2, 3)), np.nanmax(around, axis=(2, 3))
        assert np.all(result[..., colour] >= smallest)
        assert np.all(result[..., colour] <= largest)


@pytest.mark.parametrize(("method", "rounding"), [("malvar", 0.0), ("edges", 1e-5)])
def test_flipping_the_mosaic_flips_the_image_and_the_pattern(method: Any, rounding: float) -> None:
    mosaic = np.random.default_rng(11).random((24, 26)).astype(np.float32)

    def flipped(axes: Any, cfa: str) -> Image:
        return demosaic(np.ascontiguousarray(mosaic[axes]), cfa, method=method)[axes]

    image = demosaic(mosaic, "RGGB", method=method)
    np.testing.assert_allclose(flipped(np.s_[:, ::-1], "GRBG"), image, rtol=rounding)
    np.testing.assert_allclose(flipped(np.s_[::-1], "GBRG"), image, rtol=rounding)
    np.testing.assert_allclose(flipped(np.s_[::-1, ::-1], "BGGR"), image, rtol=rounding)


@pytest.mark.parametrize(("method", "reach"), [("malvar", 2), ("edges", 7)])
def test_a_lost_sample_is_missing_only_where_it_is_nearest(method: Any, reach: int) -> None:
    mosaic = np.random.default_rng(13).random((24, 24)).astype(np.float32)
    whole = demosaic(mosaic, "RGGB", method=method)
    mosaic[12, 12] = np.nan  # a red site
    image = demosaic(mosaic, "RGGB", method=method)
    red_reach = np.zeros((24, 24), np.bool_)
    red_reach[11:14, 11:14] = True
    np.testing.assert_array_equal(np.isnan(image[..., 0]), red_reach)
    assert not np.isnan(image[..., 1:]).any()
    np.testing.assert_array_equal(lost_pixels(image), red_reach)
    if method == "malvar":
        # The other colours there are the plain mean of their neighbours: the Laplacian of red is not known.
        near = [mosaic[11, 12], mosaic[13, 12], mosaic[12, 11], mosaic[12, 13]]
        assert image[12, 12, 1] == pytest.approx(np.mean(near))
    # Nothing changes farther away than the method reaches, but for the toe of the logarithm, which is a median.
    far = np.ones((24, 24), np.bool_)
    far[12 - reach : 13 + reach, 12 - reach : 13 + reach] = False
    np.testing.assert_allclose(image[far], whole[far], rtol=0.0 if method == "malvar" else 0.02)


@pytest.mark.parametrize("place", range(4))
def test_each_colour_is_missing_where_a_nearest_sample_of_it_is(place: int) -> None:
    mosaic = np.random.default_rng(place).random((12, 12)).astype(np.float32)
    mosaic[4 + place // 2, 4 + place % 2] = np.nan
    by_edges, by_malvar = (np.isnan(demosaic(mosaic, "GRBG", method=method)) for method in ("edges", "malvar"))
    np.testing.assert_array_equal(by_edges, by_malvar)


def disc(colour: tuple[float, float, float], ratio: float) -> npt.NDArray[np.float64]:
    """A lamp `ratio` times as bright as what is around it, with a rim as soft as a good lens makes it."""
    y, x = np.mgrid[0:60, 0:60]
    edge = np.clip(15.3 - np.hypot(y - 29.7, x - 30.2), 0, 1)
    inside = cv2.GaussianBlur(edge, (0, 0), 0.5)
    return 0.01 * (1 + (ratio - 1) * inside)[..., None] * np.asarray(colour)


@pytest.mark.parametrize("ratio", [30.0, 1e3, 1e5])
def test_a_lamps_rim_has_the_lamps_colour_and_less_fringe_than_with_linear_filters(ratio: float) -> None:
    image = disc((0.6, 1.0, 0.4), ratio)
    fringe = {}
    for method in METHODS:
        result = demosaic(sampled(image, "RGGB"), "RGGB", method=method)[4:-4, 4:-4]
        off = np.log(result[..., ::2] / result[..., 1:2]) - np.log(np.array([0.6, 0.4]))
        fringe[method] = float(np.sqrt(np.mean(off**2)))
    assert fringe["edges"] < 0.5 * fringe["malvar"]


@pytest.mark.parametrize("method", METHODS)
def test_the_number_of_threads_changes_no_bit(method: Any) -> None:
    mosaic = (10 ** np.random.default_rng(5).uniform(-4, 4, (64, 70))).astype(np.float32)
    together = demosaic(mosaic, "RGGB", method=method)
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        np.testing.assert_array_equal(demosaic(mosaic, "RGGB", method=method), together)
    finally:
        numba.set_num_threads(threads)


# Other arrangements

X_TRANS = "GBGGRGRGRBGBGBGGRGGRGGBGBGBRGRGRGGBG"


def test_a_six_by_six_pattern_keeps_its_samples_and_their_range() -> None:
    rng = np.random.default_rng(1)
    image = rng.uniform(0.1, 1.0, (3,)).astype(np.float32) * np.ones((24, 31, 3), np.float32)
    pattern = np.array(list(X_TRANS)).reshape(6, 6)
    colours = np.tile(pattern, (5, 6))[:24, :31]
    index = np.array([["RGB".index(c) for c in row] for row in colours])
    flat = np.take_along_axis(image, index[..., None], axis=2)[..., 0]
    np.testing.assert_array_equal(demosaic(flat, X_TRANS), image)
    noisy = (flat * 10 ** rng.uniform(-3, 3, flat.shape)).astype(np.float32)
    result = demosaic(noisy, X_TRANS)
    np.testing.assert_array_equal(np.take_along_axis(result, index[..., None], axis=2)[..., 0], noisy)
    for k in range(3):
        padded = np.pad(np.where(index == k, noisy, np.nan), 2, mode="reflect")
        around = np.lib.stride_tricks.sliding_window_view(padded, (5, 5))
        assert np.all(result[..., k] >= np.nanmin(around, axis=(2, 3)))
        assert np.all(result[..., k] <= np.nanmax(around, axis=(2, 3)))


def test_a_six_by_six_pattern_misses_a_colour_beside_a_lost_sample() -> None:
    mosaic = np.ones((12, 12), np.float32)
    mosaic[6, 7] = np.nan  # blue
    image = demosaic(mosaic, X_TRANS)
    missing = np.isnan(image)
    assert not missing[..., :2].any()
    np.testing.assert_array_equal(np.argwhere(missing[..., 2]).min(axis=0), [5, 6])
    np.testing.assert_array_equal(np.argwhere(missing[..., 2]).max(axis=0), [7, 8])


def test_a_sensor_without_filters_and_a_linear_frame_pass_through() -> None:
    mosaic = np.random.default_rng(3).random((6, 9)).astype(np.float32)
    mosaic[2, 4] = np.inf
    grey = demosaic(mosaic, "W")
    linear = demosaic(mosaic, "RGB")
    mosaic[2, 4] = np.nan
    np.testing.assert_array_equal(grey, np.repeat(mosaic[..., None], 3, axis=2))
    np.testing.assert_array_equal(linear, mosaic.reshape(6, 3, 3))


def test_the_spread_is_that_of_the_nearest_samples() -> None:
    deviation = np.random.default_rng(4).uniform(1, 2, (10, 12)).astype(np.float32)
    out = spread(deviation, "RGGB")
    np.testing.assert_array_equal(out[own_sample((10, 12), "RGGB")], deviation.ravel())
    assert out.min() >= 1
    assert out.max() <= 2
    assert spread(deviation, "W").shape == (10, 12, 3)
    assert spread(deviation, "RGB").shape == (10, 4, 3)


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


def test_a_method_that_does_not_exist_is_refused() -> None:
    with pytest.raises(CalibrateError, match=r"`merge\.demosaic`"):
        demosaic(np.ones((8, 8), np.float32), "RGGB", method="ahd")  # type: ignore[arg-type]


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


def test_the_logarithmic_scale_and_its_inverse_are_as_good_as_float32() -> None:
    x = np.concatenate([-np.geomspace(1e7, 1e-4, 3000), [0.0], np.geomspace(1e-6, 1e9, 9000)]).astype(np.float32)
    logarithm = np.empty_like(x)
    to_log(x, np.float32(0.5), logarithm)
    exact = np.arcsinh(x.astype(np.float64) / 2)
    np.testing.assert_allclose(logarithm, exact, rtol=FLOAT32, atol=FLOAT32)
    light = logarithm.copy()
    to_light(light, np.float32(2))
    # A rounding of a logarithm of 20 is that of the light times 20.
    np.testing.assert_allclose(light, x, rtol=20 * FLOAT32, atol=FLOAT32)


@pytest.mark.parametrize("cfa", ["RGGB", "GBRG"])
def test_no_tile_shows_in_the_image(cfa: str) -> None:
    motif = (10 ** np.random.default_rng(3).normal(0, 0.8, (32, 32))).astype(np.float32)
    image = demosaic(np.tile(motif, (5, 34)), cfa)
    inside = image[32:-32, 32:-32]
    np.testing.assert_array_equal(inside, np.tile(inside[:32, :32], (3, 32, 1)))
