"""Where directions are drawn from: the luminance of the interpolated map, times the sine of its latitude.

Mitsuba's `Hierarchical2D` draws from a bilinear function on an even grid of nodes. The rows of a lat-long map are
centred in their band of latitude, so a grid of the rows and the two poles is not even: the outermost bands are
half as high. In the coordinate t = 0 … height + 1, 0 and height + 1 being the poles and k the centre of row k − 1, it is.
`V` is the module of types of one Mitsuba variant, `size` the map's (height, width).
"""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from envcal.mitsuba.loading import Float32, Float64


def nodes(luminance: Float32) -> Float32:
    """Return luminance · sin θ at the nodes [height + 2, width + 1]; the poles are 0, the last column is the first."""
    height, width = luminance.shape
    sine = np.sin((np.arange(height) + 0.5) * (np.pi / height)).astype(np.float32)
    out = np.zeros((height + 2, width + 1), np.float32)
    np.multiply(luminance, sine[:, None], out=out[1:-1, :-1])
    out[:, -1] = out[:, 0]
    if not out.any():
        out[1:-1] = sine[:, None]
    return out


def luminance_of_rgb(rgb: Float32) -> Float32:
    """Return Y [height, width] of linear sRGB, but at least a thousandth of the largest component.

    A saturated colour may leave sRGB, and its luminance be tiny or negative; it shines nevertheless, so it is drawn.
    """
    luminance = rgb @ np.array([0.212671, 0.715160, 0.072169], np.float32)
    return np.maximum(luminance, 1e-3 * np.abs(rgb).max(axis=2)).astype(np.float32)


def observer_weights(wavelengths_nm: Float64) -> Float64:
    """Return ȳ Δλ of the CIE 1931 observer, as Mitsuba has it; only sampling rests on it."""
    observer: Any = mi.cie1931_y
    values = [np.ravel(observer(float(wavelength)))[0] for wavelength in wavelengths_nm]
    return np.array(values, np.float64) * np.diff(wavelengths_nm)[0]


def mean_emission(emission: Float64, slot: Any, scale: Float32) -> Float32:
    """Return the emission [wavelengths] of the whole map, 1 at most, of emissions [slots, wavelengths] by slot and scale.

    A little of every wavelength is in it: a later change of the emissions is then still sampled without bias.
    """
    share = np.bincount(slot.ravel(), weights=scale.ravel(), minlength=len(emission))
    mean = share @ emission if share.any() else emission.mean(axis=0)
    return np.asarray(mean / max(mean.max(), 1e-30) + 1e-3, np.float32)


def draw_place(V: Any, warp: Any, size: tuple[int, int], sample: Any, active: Any) -> tuple[Any, Any, Any]:
    """Return u (not yet wrapped into 0 … 1), v and the density over the sphere, without its 1 / sin θ."""
    height, width = size
    at, density = warp.sample(V.Point2f(sample), [], active)
    row, rows = at.y * (height + 1), float(height)
    above, below = dr.maximum(1 - row, 0), dr.maximum(row - rows, 0)
    v = (row - 0.5 + 0.5 * (above - below)) * (1 / rows)
    return at.x + 0.5 / width, v, density * _row_density(V, height, (above > 0) | (below > 0))


def density(V: Any, warp: Any, size: tuple[int, int], u: Any, v: Any, active: Any) -> Any:
    """Return the density of a place over the sphere, without its 1 / sin θ: what `draw_place` draws by."""
    height, width = size
    at, rows = u - 0.5 / width, float(height)
    row = v * rows + 0.5
    above, below = dr.maximum(1 - row, 0), dr.maximum(row - rows, 0)
    row += below - above
    found = warp.eval(V.Point2f(at - dr.floor(at), row * (1 / (rows + 1))), [], active)
    return found * _row_density(V, height, (above > 0) | (below > 0))


def _row_density(V: Any, height: int, polar: Any) -> Any:
    """Return d(row)/dv over 2π²(height + 1); the polar half rows count for a whole one."""
    k = height / ((height + 1) * 2 * np.pi**2)
    return dr.select(polar, V.Float(2 * k), V.Float(k))


def draw_wavelengths(V: Any, distribution: Any, sample: Any) -> tuple[Any, Any]:
    """Return wavelengths and 1 / their densities."""
    shifted = V.sample_shifted(sample)
    drawn, weights = [], []
    for k in range(len(shifted)):
        wavelength, found = distribution.sample_pdf(shifted[k])
        drawn.append(wavelength)
        weights.append(dr.select(found > 0, dr.rcp(found), 0.0))
    return type(shifted)(drawn), V.UnpolarizedSpectrum(weights)
