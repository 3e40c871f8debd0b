"""From coefficients to radiance and back to RGB: what a renderer, a file writer or a test needs.

Radiance at λ is scale · E(λ) · S(c0 λ² + c1 λ + c2). The code here shares nothing with the solver in
`pixels.py`: it reads coefficients for λ in nm, sums XYZ over the grid, and goes to RGB last, so that a round trip tests
both.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from uplift import UpliftError
from uplift.spectrum import Float64, Observer, RGBSpace
from uplift.spectrum import observer as default_observer

_RUN = 1024  # pixels that a thread takes at a time


def spectra_of(
    coefficients: npt.NDArray[np.floating],
    scale: npt.NDArray[np.floating],
    emission_index: npt.NDArray[np.integer],
    emissions: npt.ArrayLike,
    wavelengths_nm: npt.ArrayLike,
    *,
    observer: Observer | None = None,
    dtype: type[np.float32] | type[np.float64] = np.float64,
) -> npt.NDArray[np.floating]:
    """Return radiance [..., M] at `wavelengths_nm` [M], in any order and number.

    Parameters
    ----------
    coefficients, scale, emission_index
        Shapes (..., 3), (...), (...), as `Uplifted` has them; any part of a map will do, so call it by rows
        to save memory.
    emissions
        Shape (K, N): the lights on the grid of `observer` (default: `observer()`). Between its wavelengths
        they are linear, outside of it zero.
    dtype
        Of the result, np.float32 or np.float64; computed in float64.

    Raises UpliftError if shapes disagree or an index has no emission.
    """
    grid = (observer if observer is not None else default_observer()).wavelengths_nm
    lights = np.asarray(emissions, dtype=np.float64)
    wavelengths = np.ascontiguousarray(wavelengths_nm, dtype=np.float64)
    if wavelengths.ndim != 1:
        raise UpliftError(f"spectra_of: wavelengths of shape {wavelengths.shape}; expected a list of nm")
    shape, flat = _flat("spectra_of", coefficients, scale, emission_index, lights, grid.size)
    sampled = np.stack([np.interp(wavelengths, grid, light, left=0.0, right=0.0) for light in lights])
    out = np.empty((flat[1].size, wavelengths.size), dtype)
    _radiance(*flat, sampled, wavelengths, grid[[0, -1]], out)
    return out.reshape((*shape, wavelengths.size))


def rgb_of(
    coefficients: npt.NDArray[np.floating],
    scale: npt.NDArray[np.floating],
    emission_index: npt.NDArray[np.integer],
    emissions: npt.ArrayLike,
    *,
    observer: Observer,
    space: RGBSpace,
) -> Float64:
    """Return linear RGB [..., 3] in `space` of spectra [...], by the sum over the observer's grid.

    Arguments as in `spectra_of`. Raises UpliftError if shapes disagree or an index has no emission.
    """
    lights = np.asarray(emissions, dtype=np.float64)
    shape, flat = _flat("rgb_of", coefficients, scale, emission_index, lights, observer.wavelengths_nm.size)
    out = np.empty((flat[1].size, 3))
    responses = lights[:, None, :] * observer.cmfs.T * observer.step_nm
    grid = observer.wavelengths_nm.copy()
    _sum(*flat, np.ascontiguousarray(responses), grid, grid[[0, -1]], space.rgb_from_xyz.copy(), out)
    return out.reshape((*shape, 3))


_Flat = tuple[Float64, Float64, npt.NDArray[np.int64]]


def _flat(
    place: str,
    coefficients: npt.NDArray[np.floating],
    scale: npt.NDArray[np.floating],
    emission_index: npt.NDArray[np.integer],
    lights: Float64,
    size: int,
) -> tuple[tuple[int, ...], _Flat]:
    """Check what both functions are given; return the pixels' shape, and them in a row."""
    c, s, k = np.asarray(coefficients), np.asarray(scale), np.asarray(emission_index)
    if c.shape != (*s.shape, 3) or s.shape != k.shape or k.dtype.kind not in "ui":
        raise UpliftError(
            f"{place}: coefficients {c.shape}, scale {s.shape} and emission index {k.shape} of {k.dtype} disagree; "
            "expected [..., 3], [...] and integers [...]"
        )
    if lights.ndim != 2 or lights.shape[1] != size:
        raise UpliftError(
            f"{place}: emissions of shape {lights.shape}; expected [K, {size}], on the observer's grid. "
            "illuminants.measured_emission brings a spectrum to it"
        )
    if k.size and not 0 <= int(k.min()) <= int(k.max()) < len(lights):
        raise UpliftError(
            f"{place}: emission indices run from {k.min()} to {k.max()}, but there are {len(lights)} emissions"
        )
    flat = (
        np.ascontiguousarray(c.reshape(-1, 3), dtype=np.float64),
        np.ascontiguousarray(s.reshape(-1), dtype=np.float64),
        np.ascontiguousarray(k.reshape(-1), dtype=np.int64),
    )
    return s.shape, flat


@njit(cache=True, error_model="numpy")
def _sigmoid(x):  # type: ignore[no-untyped-def]
    """Return S(x) with full relative precision where it is small, and its limits at ±∞."""
    root = np.sqrt(1.0 + x * x)
    dark = 0.5 / (root * (root + abs(x)))
    return dark if x < 0.0 else 1.0 - dark


@njit(cache=True, error_model="numpy")
def _summit(c0, c1, c2, ends):  # type: ignore[no-untyped-def]
    """Return (middle, c0, c1, c2) of the same polynomial in λ − middle, at its summit within the wavelengths.

    In λ the terms of a narrow peak cancel to a millionth of their size; products with the middle, a multiple of a
    quarter of a nanometre, are exact in halves of a float64 (Dekker 1971), and so is nearly everything here.
    """
    middle = min(ends[1], max(ends[0], -0.5 * c1 / c0)) if c0 != 0.0 else ends[0]
    # A black pixel has c2 = −∞, and needs no middle.
    if not (np.isfinite(c2) and np.isfinite(middle)):
        return 0.0, c0, c1, c2
    middle = np.rint(4.0 * middle) * 0.25
    h = 134217729.0 * c0
    high0 = h - (h - c0)
    h = 134217729.0 * c1
    high1 = h - (h - c1)
    low0, low1 = c0 - high0, c1 - high1
    b = (c1 + 2.0 * high0 * middle) + 2.0 * low0 * middle
    p, q = high0 * middle * middle, high1 * middle
    s = p + q
    v = s - p
    e = (p - (s - v)) + (q - v)
    z = s + c2
    v = z - s
    e += (s - (z - v)) + (c2 - v)
    return middle, c0, b, z + (e + (low0 * middle * middle + low1 * middle))


@njit(cache=True, error_model="numpy", parallel=True)
def _radiance(coefficients, scale, index, sampled, wavelengths, ends, out):  # type: ignore[no-untyped-def]
    for p in prange(scale.size):
        middle, c0, c1, c2 = _summit(coefficients[p, 0], coefficients[p, 1], coefficients[p, 2], ends)
        for i in range(wavelengths.size):
            d = wavelengths[i] - middle
            x = (c0 * d + c1) * d + c2
            out[p, i] = scale[p] * sampled[index[p], i] * _sigmoid(x)


@njit(cache=True, error_model="numpy", fastmath={"reassoc", "contract"})
def _tristimulus(response, reflectance):  # type: ignore[no-untyped-def]
    """Return the sums of the rows of `response` [3, N] times `reflectance` [N], in whatever order is fastest."""
    X = Y = Z = 0.0
    for i in range(reflectance.size):
        X += response[0, i] * reflectance[i]
        Y += response[1, i] * reflectance[i]
        Z += response[2, i] * reflectance[i]
    return X, Y, Z


@njit(cache=True, error_model="numpy", parallel=True)
def _sum(coefficients, scale, index, responses, wavelengths, ends, rgb_from_xyz, out):  # type: ignore[no-untyped-def]
    for run in prange((scale.size + _RUN - 1) // _RUN):
        # Wavelengths do not depend on one another until they are summed: roots and quotients are taken several at a time.
        reflectance = np.empty(wavelengths.size)
        for p in range(run * _RUN, min(scale.size, (run + 1) * _RUN)):
            middle, c0, c1, c2 = _summit(coefficients[p, 0], coefficients[p, 1], coefficients[p, 2], ends)
            for i in range(wavelengths.size):
                d = wavelengths[i] - middle
                reflectance[i] = _sigmoid((c0 * d + c1) * d + c2)
            X, Y, Z = _tristimulus(responses[index[p]], reflectance)
            for channel in range(3):
                row = rgb_from_xyz[channel]
                out[p, channel] = scale[p] * (row[0] * X + row[1] * Y + row[2] * Z)
