"""Radiance at wavelengths of one's own for each ray: what a spectral renderer asks of an environment map."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from uplift import UpliftError
from uplift.spectrum import Float64, Observer


def radiance_at(
    coefficients: npt.NDArray[np.floating],
    scale: npt.NDArray[np.floating],
    emission_index: npt.NDArray[np.integer],
    emissions: npt.ArrayLike,
    wavelengths_nm: npt.NDArray[np.floating],
    *,
    observer: Observer,
) -> Float64:
    """Return the radiance [..., M] of pixels [...] at `wavelengths_nm` [..., M], other ones for each.

    Parameters
    ----------
    coefficients, scale, emission_index
        Shapes (..., 3), (...), (...): those of the texels that the rays meet, as `Uplifted` has them. Between texels
        interpolate what this returns, never the coefficients.
    emissions
        Shape (K, N): the lights on the grid of `observer`. Between its wavelengths they are linear, and so is what is
        returned for a grey pixel; outside of it they are zero.

    For one list of wavelengths there is `radiance.spectra_of`.

    Raises UpliftError if shapes disagree or an index has no emission. A wavelength that is NaN has radiance 0.
    """
    c, s, k = np.asarray(coefficients), np.asarray(scale), np.asarray(emission_index)
    lights, asked = np.asarray(emissions, dtype=np.float64), np.asarray(wavelengths_nm, dtype=np.float64)
    if asked.ndim == 0 or (asked.ndim == 1 and s.ndim > 0):
        raise UpliftError(
            f"radiance_at: wavelengths of shape {asked.shape} for pixels of shape {s.shape}; expected {(*s.shape, 'M')}, some for "
            f"each pixel. For one list of wavelengths use radiance.spectra_of: spectra_of(..., [550.0], observer=observer)"
        )
    if c.shape != (*s.shape, 3) or s.shape != k.shape or k.dtype.kind not in "ui" or asked.shape[:-1] != s.shape:
        raise UpliftError(
            f"radiance_at: coefficients {c.shape}, scale {s.shape}, emission index {k.shape} of {k.dtype} and wavelengths "
            f"{asked.shape} disagree; expected [..., 3], [...], integers [...] and [..., M]"
        )
    size = observer.wavelengths_nm.size
    if lights.ndim != 2 or lights.shape[1] != size:
        raise UpliftError(
            f"radiance_at: emissions of shape {lights.shape}; expected [K, {size}], on the observer's grid. "
            "illuminants.measured_emission brings a spectrum to it"
        )
    if k.size and not 0 <= int(k.min()) <= int(k.max()) < len(lights):
        raise UpliftError(
            f"radiance_at: emission indices run from {k.min()} to {k.max()}, but there are {len(lights)} emissions"
        )
    out = np.empty((s.size, asked.shape[-1]))
    _sample(
        np.ascontiguousarray(c.reshape(-1, 3), dtype=np.float64),
        np.ascontiguousarray(s.reshape(-1), dtype=np.float64),
        np.ascontiguousarray(k.reshape(-1), dtype=np.int64),
        np.ascontiguousarray(lights),
        np.ascontiguousarray(asked.reshape(out.shape)),
        float(observer.wavelengths_nm[0]),
        observer.step_nm,
        out,
    )
    return out.reshape(asked.shape)


@njit(cache=True, error_model="numpy", parallel=True)
def _sample(coefficients, scale, index, emissions, wavelengths, first, step, out):  # type: ignore[no-untyped-def]
    last = emissions.shape[1] - 1
    for p in prange(scale.size):
        c0, c1, c2 = coefficients[p, 0], coefficients[p, 1], coefficients[p, 2]
        for i in range(wavelengths.shape[1]):
            wavelength = wavelengths[p, i]
            place = (wavelength - first) / step
            if not (0.0 <= place <= last) or scale[p] == 0.0:
                out[p, i] = 0.0
                continue
            left = min(int(place), last - 1)
            share = place - left
            light = (1.0 - share) * emissions[index[p], left] + share * emissions[index[p], left + 1]
            x = (c0 * wavelength + c1) * wavelength + c2
            root = np.sqrt(1.0 + x * x)
            dark = 0.5 / (root * (root + abs(x)))  # S(−|x|), without the loss of 1 − …
            out[p, i] = scale[p] * light * (dark if x < 0.0 else 1.0 - dark)
