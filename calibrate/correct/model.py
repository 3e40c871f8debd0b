"""The matrix, and with it the light on every patch.

No chart is lit evenly, and a plain fit takes the fall-off of the light for a property of the camera. So the light s is estimated
too, as exp of a plane over the chart with the mean 0 (two numbers more; the idea is that of G. D. Finlayson, M. Mohammadzadeh
Darrodi and M. Mackiewicz, "The alternating least squares technique for nonuniform intensity color correction", 2015;
here by Gauss–Newton on the plane, with the colours solved within). A plane that is fitted together with a 3×3 matrix takes up in turn
what the matrix misses of the camera: under a light of 2000 K a fall-off of 4 % where there is none. So the plane is always fitted
with a root-polynomial, which misses half as much, and the matrix then in that light. Both scale with the light, so that a fall-off, however
strong, changes the estimate by itself and nothing else. Mean error of the recovered CCT of the chart's light in %, over 52
cameras and an ideal D65 lamp, for even light assumed / the plane with the matrix / with the root-polynomial:
illuminant A 2.6 / 1.9 / 2.2, LED-B3 1.6 / 1.6 / 1.6, FL2 3.0 / 2.9 / 3.0, 2000 K 1.7 / 2.6 / 1.6. With a fall-off of 20 % across the
chart the first becomes 4.1 under illuminant A and 14 under 2000 K, the others stay. A Luther camera is recovered exactly either way.

Weights: ``"linear"``, w = 1, counts radiance; ``"lightness"``, w = Y^(−4/3), counts an error as CIELAB does (its cube root has the
slope Y^(−2/3)) and is steadier without the plane, but leaves 4–5 % in the CCT of warm lights where ``"linear"`` leaves 2. All rows
of M share the weights, so the result does not depend on the space in which the residual is counted. A colour that stands on the
chart n times counts 1/n each time (an SG is framed by 44 whites, greys and blacks, which would outweigh its colours); all of
them tell the fall-off.

A white-preserving fit (G. D. Finlayson and M. S. Drew, "Constrained least-squares regression in color spaces", 1997) takes
M c_w = t_w as an equality and the rest by least squares.

The root-polynomial of degree 2 (G. D. Finlayson, M. Mackiewicz and A. Hurlbert, "Color Correction Using Root-Polynomial
Regression", 2015) adds √rg, √gb, √rb to r, g, b: every term scales as the exposure does, so unlike a plain
polynomial it means the same at every exposure. Degree 3 over-fits 24 patches and is not offered.
"""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from calibrate.difference import delta_e_2000, lab_from_xyz

Floats = npt.NDArray[np.float64]

# Published colours nearer than this (CIEDE2000) are one that stands there several times; those of a Classic are 7 apart.
_SAME_COLOUR: Final = 2.0
_MOST_STEPS: Final = 12
_DIFFERENCE: Final = 1e-5


@dataclass(frozen=True, slots=True, eq=False)
class ChartFit:
    """What is fitted to which colours: the problem, without a choice of patches.

    `camera` [N, 3] is camera RGB, `terms` [N, T] what the matrix multiplies (the same, or `root_terms` of it), `target` [N, 3] the
    published XYZ, `weights` [N], `held` [N] the patches whose mean is met exactly, `places` [N, 2] those on the
    chart, or [N, 0] where the light is even.
    """

    camera: Floats
    terms: Floats
    target: Floats
    weights: Floats
    held: npt.NDArray[np.bool_]
    places: Floats

    def solved(self, kept: npt.NDArray[np.bool_]) -> tuple[Floats, Floats]:
        """Return the matrix [3, T] fitted to the `kept` patches, and the light on every patch [N]."""
        light = self._light(kept)
        even = self.terms / light[:, None]
        return least_squares(even[kept], self.target[kept], self.weights[kept], self.held[kept]), light

    def _light(self, kept: npt.NDArray[np.bool_]) -> Floats:
        """Return the light on every patch [N], exp(places · slope); even if `places` has no columns."""
        slope = np.zeros(self.places.shape[1])
        if not len(slope):
            return np.ones(len(self.places))
        terms, target, places = root_terms(self.camera)[kept], self.target[kept], self.places[kept]
        root = np.sqrt(self.weights[kept])[:, None]

        def residual(at: Floats) -> Floats:
            even = terms * np.exp(-(places @ at))[:, None]
            matrix = least_squares(even, target, self.weights[kept], self.held[kept])
            return np.asarray(((even @ matrix.T - target) * root).ravel())

        # Gauss–Newton on two slopes: from even light it converges in three to five steps, quadratically.
        for _ in range(_MOST_STEPS):
            tangents = [
                (residual(slope + _DIFFERENCE * axis) - residual(slope - _DIFFERENCE * axis)) / (2 * _DIFFERENCE)
                for axis in np.eye(len(slope))
            ]
            step = np.linalg.lstsq(np.stack(tangents, axis=1), -residual(slope), rcond=None)[0]
            # At most half an e-fold a step, so that a hopeless chart cannot send the exponent off.
            slope = slope + np.clip(step, -0.5, 0.5)
            if np.abs(step).max() < 1e-10:
                break
        return np.asarray(np.exp(self.places @ slope))


def stands_once(xyz: Floats) -> Floats:
    """Return one over how often the colour of each patch [N, 3] stands on the chart."""
    lab = lab_from_xyz(xyz)
    alike = delta_e_2000(np.repeat(lab, len(lab), axis=0), np.tile(lab, (len(lab), 1))) < _SAME_COLOUR
    return np.asarray(1.0 / alike.reshape(len(lab), -1).sum(axis=1))


def root_terms(camera: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return r, g, b, √rg, √gb, √br [..., 6] of camera RGB [..., 3]; a root of what noise made negative is 0."""
    positive = np.maximum(camera, 0)
    mixed = np.sqrt(positive * np.roll(positive, -1, axis=-1))
    return np.concatenate([camera, mixed], axis=-1)


def least_squares(
    camera: Floats,
    target: Floats,
    weights: Floats,
    held: npt.NDArray[np.bool_],
) -> Floats:
    """Least squares for target = M camera; the mean of the `held` patches exactly (none held: unconstrained)."""
    root = np.sqrt(weights)[:, None]
    if not held.any():
        return np.asarray(np.linalg.lstsq(camera * root, target * root, rcond=None)[0].T)
    white_in, white_out = camera[held].mean(axis=0), target[held].mean(axis=0)
    # M = white_out whiteᵀ/|white|² + K Nᵀ, N spanning the plane perpendicular to the white: any K keeps the white.
    fixed = np.outer(white_out, white_in) / (white_in @ white_in)
    normal = np.linalg.svd(white_in[None, :])[2][1:].T
    free = np.linalg.lstsq(camera @ normal * root, (target - camera @ fixed.T) * root, rcond=None)[0].T
    return np.asarray(fixed + free @ normal.T)
