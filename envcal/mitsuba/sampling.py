"""Where directions are drawn from: the luminance of the interpolated map, times the sine of its latitude.

Mitsuba's `Hierarchical2D` draws from a bilinear function on an even grid of nodes. The rows of a lat-long map are
centred in their band of latitude, so a grid of the rows and the two poles is not even: the outermost bands are
half as high. In the coordinate t = 0 … height + 1, 0 and height + 1 being the poles and k the centre of row k − 1, it is.
"""

from __future__ import annotations

import numpy as np

from envcal.mitsuba.loading import Float32


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
