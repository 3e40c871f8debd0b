"""A lens's fall-off is measured on a flat field and taken out, by channel."""

from fractions import Fraction

import numpy as np
import pytest

from calibrate import CalibrateError
from calibrate.exposure import FrameInfo
from calibrate.lens import Vignetting, measure_vignetting, remove_vignetting

FALL: Vignetting = ((-0.5, 0.2, -0.1), (-0.4, 0.1, 0.0), (-0.6, 0.3, -0.15))
SHAPE = (192, 288)


def light(shape: tuple[int, int], fall: Vignetting) -> np.ndarray:
    """The polynomial written out pixel by pixel's coordinates."""
    y, x = np.mgrid[0 : shape[0], 0 : shape[1]] + 0.5
    r2 = ((y - shape[0] / 2) ** 2 + (x - shape[1] / 2) ** 2) / ((shape[0] / 2) ** 2 + (shape[1] / 2) ** 2)
    return np.stack([1 + a * r2 + b * r2**2 + c * r2**3 for a, b, c in fall], axis=-1)


def info(cfa: str) -> FrameInfo:
    return FrameInfo(
        "flat.dng", Fraction(1, 10), 100.0, 8.0, "Maker One", "", SHAPE[1], SHAPE[0], cfa,
        (512.0,) * len(cfa), (16383.0,) * len(cfa), 14,
    )  # fmt: skip


def flat(cfa: str, level: float = 0.7, fall: Vignetting = FALL) -> np.ndarray:
    rng = np.random.default_rng(1)
    seen = level * light(SHAPE, fall)
    if cfa == "RGB":
        mosaic = seen.reshape(SHAPE[0], -1)
    elif cfa == "W":
        mosaic = seen[..., 1]
    else:
        mosaic = np.empty(SHAPE)
        for k, colour in enumerate(cfa):
            mosaic[k // 2 :: 2, k % 2 :: 2] = seen[k // 2 :: 2, k % 2 :: 2, "RGB".index(colour)]
    counts = 512 + mosaic * 15871 + 40 * rng.standard_normal(mosaic.shape)
    return np.clip(np.rint(counts), 0, 16383).astype(np.uint16)


def test_the_fall_off_is_taken_out_by_channel_and_the_middle_is_kept() -> None:
    image = light(SHAPE, FALL).astype(np.float32)
    image[3, 4, 1] = np.nan
    out = remove_vignetting(image, FALL)
    assert np.isnan(out[3, 4, 1])
    np.testing.assert_allclose(out[np.isfinite(out)], 1, rtol=1e-5)
    assert np.all(image[96, 144] == pytest.approx(1, abs=1e-3))


@pytest.mark.parametrize("cfa", ["RGGB", "GBRG", "W", "RGB"])
def test_a_flat_field_gives_the_fall_off_of_each_channel(cfa: str) -> None:
    found = measure_vignetting(flat(cfa), info(cfa))
    true = (FALL[1],) * 3 if cfa == "W" else FALL
    # 40 counts of noise in cells of 64 photosites: 5 counts of 11 000.
    np.testing.assert_allclose(light(SHAPE, found), light(SHAPE, true), rtol=2e-3)


def test_a_flat_field_that_is_none_is_refused() -> None:
    with pytest.raises(CalibrateError, match="a stop below clipping"):
        measure_vignetting(flat("RGGB", level=1.2), info("RGGB"))
    with pytest.raises(CalibrateError, match="a stop below clipping"):
        measure_vignetting(flat("RGGB", level=0.01), info("RGGB"))
    shadowed = flat("RGGB")
    shadowed[:, :60] //= 2
    with pytest.raises(CalibrateError, match="evenly lit surface"):
        measure_vignetting(shadowed, info("RGGB"))
    with pytest.raises(CalibrateError, match="too small"):
        measure_vignetting(flat("RGGB")[:40, :40], info("RGGB"))


def test_a_polynomial_that_leaves_no_light_is_refused() -> None:
    with pytest.raises(CalibrateError, match=r"`merge\.vignetting`"):
        remove_vignetting(np.ones((8, 8, 3), np.float32), ((-1.5, 0.0, 0.0),) * 3)
