"""Camera RGB to working RGB by a 3×3 matrix, or a root-polynomial, fitted to a colour chart.

The matrix minimises Σ_p w_p |M c_p / s_p − t_p|² over the patches p: c the camera RGB, t the published colours under D65, s
the light that falls on the patch. No chart is lit evenly, and a plain fit takes the fall-off of the light for a property
of the camera. So s is estimated with M, as exp of a plane over the chart with the mean 0 (two numbers more; the idea is that of
G. D. Finlayson, M. Mohammadzadeh Darrodi and M. Mackiewicz, "The alternating least squares technique for nonuniform
intensity color correction", 2015; here by Gauss–Newton on the plane, with M solved within). Measured with an ideal D65
lamp beside the chart, mean error of the recovered CCT of the chart's light in %, over cameras and the four directions of a
fall-off, plain / with the plane: illuminant A, even light 1.8 / 1.7, 20 % fall-off 5.6 / 1.9, 40 % 11 / 2.3; LED-B1 0.8 / 0.8, 6.1
/ 1.0, 12 / 1.6; 2000 K 2.2 / 3.6, 11 / 3.2, 22 / 2.6. A Luther camera is recovered exactly either way.

Weights: ``"linear"``, w = 1, counts radiance; ``"lightness"``, w = Y^(−4/3), counts an error as CIELAB does (its cube root has the
slope Y^(−2/3)) and is steadier without the plane, but leaves 4–5 % in the CCT of warm lights where ``"linear"`` leaves 2. All rows
of M share the weights, so the result does not depend on the space in which the residual is counted.

A white-preserving fit (G. D. Finlayson and M. S. Drew, "Constrained least-squares regression in color spaces", 1997) takes
M c_w = t_w as an equality and the rest by least squares.

The root-polynomial of degree 2 (G. D. Finlayson, M. Mackiewicz and A. Hurlbert, "Color Correction Using Root-Polynomial
Regression", 2015) adds √rg, √gb, √rb to r, g, b: every term scales as the exposure does, so unlike a plain
polynomial it means the same at every exposure. Degree 3 over-fits 24 patches and is not offered. ``"auto"`` takes it where
it predicts patches that it has not seen clearly better than the matrix does (mean CIEDE2000, each left out once).

A colour that stands on the chart n times counts 1/n each time (an SG is framed by 44 whites, greys and blacks, which would
outweigh its colours); all of them tell the fall-off.

Glare and dirt spoil single patches. Those that the others' fit misses by far (see `_OUTLIER_FACTOR`) are left out, and named;
with more than a few of them the chart is refused.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Literal

import cv2
import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.difference import delta_e_2000, lab_from_xyz

if TYPE_CHECKING:
    from calibrate.chart.geometry import Layout
    from calibrate.chart.reference import ChartReference

_UNEVEN_LIGHT: Final = 1.6
_MOST_STEPS: Final = 12
_DIFFERENCE: Final = 1e-5

# A patch is spoilt if the fit of the others misses it by so many times the median, by at least so much (CIEDE2000), and in
# its luminance by this factor. Glare and shadow change how bright a patch is; a matrix that does not suit a pigment under
# a warm light misses its hue.
_OUTLIER_FACTOR: Final = 4.0
_OUTLIER_DELTA_E: Final = 8.0
_OUTLIER_LUMINANCE: Final = 1.25
_MOST_OUTLIERS: Final = 6  # one patch in so many
# So many are tried, those that are missed most: of 140 patches none draws the fit to itself.
_MOST_TRIED: Final = 24
# Published colours nearer than this (CIEDE2000) are one that stands there several times; those of a Classic are 7 apart.
_SAME_COLOUR: Final = 2.0
# The root-polynomial must predict what it has not seen by this part better; it has twice as many numbers to fit.
_CLEARLY_BETTER: Final = 0.85
# A fit as bad as this is none: the largest mean met with cameras of the literature under CIE lamps was 4.3.
_BAD_FIT: Final = 12.0
_POOR_FIT: Final = 6.0

# Rows of a picture whose terms are in memory at the same time.
_ROWS_AT_A_TIME: Final = 256

# From this condition number of the patches' camera RGB on, three channels are in effect two.
_LARGEST_CONDITION: Final = 1e6


@dataclass(frozen=True, slots=True)
class ColourFit:
    """A fitted camera matrix and how well it does, patch by patch.

    `matrix` [3, 3] is RGB_from_camera; for a root-polynomial it is [3, 6] and multiplies (r, g, b, √rg, √gb, √rb).
    `left_out` [N] marks patches that were spoilt and have no part in the fit. `model` is the one that was taken. `delta_e` and `delta_e_loo` [N] are CIEDE2000 under D65 against the reference;
    for the latter each patch is left out of the fit that predicts it. `fitted_rgb` and `target_rgb` [N, 3] are linear
    working RGB, 1 = a perfect white diffuser. `shading` [N] is the relative light on each patch (geometric mean 1), which
    `fitted_rgb` and the differences are free of. `white_preserved` says what was held exactly.
    """

    matrix: npt.NDArray[np.float64]
    delta_e: npt.NDArray[np.float64]
    delta_e_loo: npt.NDArray[np.float64]
    fitted_rgb: npt.NDArray[np.float64]
    target_rgb: npt.NDArray[np.float64]
    shading: npt.NDArray[np.float64]
    names: tuple[str, ...]
    white_preserved: str
    left_out: npt.NDArray[np.bool_]
    model: Literal["linear", "root-polynomial"] = "linear"
    warnings: tuple[str, ...] = ()


def fit_matrix(
    camera_rgb: npt.NDArray[np.float64],
    reference: "ChartReference",
    *,
    rgb_from_xyz: npt.NDArray[np.float64],
    white_preserving: bool = False,
    white: Literal["patch", "neutrals"] = "patch",
    weighting: Literal["linear", "lightness"] = "linear",
    shading: Literal["plane", "none"] = "plane",
    model: Literal["linear", "root-polynomial", "auto"] = "linear",
    spoilt: Literal["leave out", "keep"] = "leave out",
) -> ColourFit:
    """Return the 3×3 matrix that takes the chart as the camera saw it to its published colours.

    The scale is the chart's: a perfect white diffuser at the middle of the chart becomes RGB (1, 1, 1), and the white
    patch its published Y (exactly so if it is preserved, else as well as least squares can).

    Parameters
    ----------
    camera_rgb
        Shape (N, 3), of a Classic (24, 3). Mean camera RGB of each patch, linear, any scale, in the order of `reference`.
    reference
        Published XYZ under D65, Y of a perfect white = 1.
    rgb_from_xyz
        Shape (3, 3). Working RGB of D65 white is (1, 1, 1).
    white_preserving
        Hold a white exactly: the white patch, or with ``white="neutrals"`` the mean of a scale of six greys (steadier
        when the white patch is dirty or shiny).
    weighting
        ``"linear"`` or ``"lightness"``, see the module.
    shading
        ``"plane"`` lets the light fall off across the chart, see the module; ``"none"`` takes it as even.
    model
        ``"linear"``, ``"root-polynomial"``, or ``"auto"``: what predicts unseen patches better, see the module.
    spoilt
        Whether patches that the others' fit misses by far are left out.

    Raises
    ------
    CalibrateError
        If a patch is not finite, the white is not positive, the three channels do not differ, too many patches are spoilt, or
        nothing fits.
    """
    if model not in {"linear", "root-polynomial", "auto"}:
        raise CalibrateError(
            f"correct.fit: {model!r} is unknown; expected 'linear', 'root-polynomial' or 'auto'. Set `correct.fit: linear`."
        )
    camera = np.asarray(camera_rgb, dtype=np.float64)
    _check_patches(camera, reference)
    xyz = np.asarray(reference.XYZ, dtype=np.float64)
    once = _once(xyz)
    weights = {"lightness": once * xyz[:, 1] ** (-4 / 3), "linear": once}.get(weighting)
    if weights is None:
        raise CalibrateError(
            f"correct.weighting: {weighting!r} is unknown; expected 'linear' or 'lightness'. "
            "Set `correct.weighting: linear`."
        )
    if shading not in {"plane", "none"}:
        raise CalibrateError(
            f"correct.shading: {shading!r} is unknown; expected 'plane' or 'none'. Set `correct.shading: plane`."
        )
    held = _held_patches(white_preserving, white, reference.layout)
    places = reference.layout.places if shading == "plane" else np.zeros((len(camera), 0))
    settings = {"weights": weights, "held": held, "places": places}
    fits = {}
    for kind in ("linear", "root-polynomial") if model == "auto" else (model,):
        terms = camera if kind == "linear" else root_terms(camera)
        left_out = np.zeros(len(camera), dtype=np.bool_)
        if spoilt == "leave out":
            left_out = _spoilt_patches(terms, xyz, settings, reference.names)
        fits[kind] = (terms, left_out, *_judged(terms, xyz, settings, ~left_out))
    taken = next(iter(fits))
    if model == "auto" and fits["root-polynomial"][-1].mean() < _CLEARLY_BETTER * fits["linear"][-1].mean():
        taken = "root-polynomial"
    terms, left_out, xyz_from_terms, light, delta_e, delta_e_loo = fits[taken]
    matrix = np.asarray(rgb_from_xyz, dtype=np.float64) @ xyz_from_terms
    return ColourFit(
        matrix=matrix,
        delta_e=delta_e,
        delta_e_loo=delta_e_loo,
        fitted_rgb=terms / light[:, None] @ matrix.T,
        target_rgb=xyz @ np.asarray(rgb_from_xyz, dtype=np.float64).T,
        shading=light,
        names=reference.names,
        white_preserved=white if white_preserving else "none",
        left_out=left_out,
        model="linear" if taken == "linear" else "root-polynomial",
        warnings=(*_spoilt_warnings(left_out, reference.names), *_doubts(light), *_verdict(delta_e[~left_out])),
    )


def root_terms(camera: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return r, g, b, √rg, √gb, √rb [..., 6] of camera RGB [..., 3]; a root of what noise made negative is 0."""
    positive = np.maximum(camera, 0.0)
    mixed = np.sqrt(positive * np.roll(positive, -1, axis=-1))
    # rg, gb, br.
    return np.concatenate([camera, mixed], axis=-1)


def _judged(
    terms: npt.NDArray[np.float64],
    xyz: npt.NDArray[np.float64],
    settings: dict[str, npt.NDArray[Any]],
    kept: npt.NDArray[np.bool_],
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return matrix, light [N], CIEDE2000 [N] of the fit to the `kept` patches, and of fits that leave out each patch too."""
    matrix, light = _fit(terms, xyz, kept=kept, **settings)
    lab = lab_from_xyz(xyz)
    delta_e = delta_e_2000(lab_from_xyz(terms / light[:, None] @ matrix.T), lab)
    unseen = np.empty(len(terms))
    for index in range(len(terms)):
        rest, rest_light = _fit(terms, xyz, kept=kept & (np.arange(len(terms)) != index), **settings)
        unseen[index] = delta_e_2000(lab_from_xyz(rest @ terms[index] / rest_light[index]), lab[index])
    return matrix, light, delta_e, unseen


def _spoilt_patches(
    terms: npt.NDArray[np.float64],
    xyz: npt.NDArray[np.float64],
    settings: dict[str, npt.NDArray[Any]],
    names: tuple[str, ...],
) -> npt.NDArray[np.bool_]:
    """Mark the patches that a fit of the others misses by far, one after the other, the worst first.

    The worst is not the one that is missed most: a bright spoilt patch draws the fit to itself, and the others stand out. It
    is the one without which the others agree best, of those that are missed most: of a Classic of all, of 140 one in six.
    """
    left_out = np.zeros(len(terms), dtype=np.bool_)
    lab = lab_from_xyz(xyz)
    while True:
        best, worst, missed, median, luminance = np.inf, 0, 0.0, 0.0, 1.0
        matrix, light = _fit(terms, xyz, kept=~left_out, **settings)
        misses = delta_e_2000(lab_from_xyz(terms / light[:, None] @ matrix.T), lab)
        free = np.flatnonzero(~left_out & ~settings["held"])
        for index in np.sort(free[np.argsort(-misses[free], kind="stable")[:_MOST_TRIED]]):
            without = ~left_out & (np.arange(len(terms)) != index)
            matrix, light = _fit(terms, xyz, kept=without, **settings)
            fitted = terms / light[:, None] @ matrix.T
            delta_e = delta_e_2000(lab_from_xyz(fitted), lab)
            if delta_e[without].mean() < best:
                best, worst = float(delta_e[without].mean()), int(index)
                missed, median = float(delta_e[index]), float(np.median(delta_e[without]))
                luminance = float(max(fitted[index, 1], 1e-6) / xyz[index, 1])
        changed = max(luminance, 1 / luminance)
        if missed < max(_OUTLIER_DELTA_E, _OUTLIER_FACTOR * median) or changed < _OUTLIER_LUMINANCE:
            return left_out
        left_out[worst] = True
        if left_out.sum() > len(terms) // _MOST_OUTLIERS:
            spoilt = ", ".join(name for name, out in zip(names, left_out, strict=True) if out)
            raise CalibrateError(
                f"correct.chart: {left_out.sum()} patches ({spoilt}) differ by far from what the others predict; at most "
                f"{len(terms) // _MOST_OUTLIERS} may. Something covers the chart, it is lit by two lights, it shines, or the edition is "
                "another one (`correct.reference`). Photograph it again, turned away from the lamps, or give its corners."
            )


def _spoilt_warnings(left_out: npt.NDArray[np.bool_], names: tuple[str, ...]) -> tuple[str, ...]:
    if not left_out.any():
        return ()
    spoilt = ", ".join(name for name, out in zip(names, left_out, strict=True) if out)
    return (
        f"correct.chart: left out of the fit: {spoilt}; the other patches predict another colour there. Glare, dirt or a "
        "shadow: turn the chart away from the lamps, or clean it.",
    )


def _verdict(delta_e: npt.NDArray[np.float64]) -> tuple[str, ...]:
    """Refuse a fit that is none, and doubt a poor one."""
    mean = float(delta_e.mean())
    if mean > _BAD_FIT:
        raise CalibrateError(
            f"correct.chart: the fitted patches differ from the published colours by a mean ΔE2000 of {mean:.1f}; at most "
            f"{_BAD_FIT:g} may be believed. Check the outline in the report and the edition in `correct.reference`; "
            "photograph the chart again in one light, without glare."
        )
    if mean > _POOR_FIT:
        return (
            f"correct.chart: the fit is poor, mean ΔE2000 {mean:.1f} (1 to 3 is usual, {_POOR_FIT:g} the limit of this "
            "warning): a light with a few lines, glare, two lights on the chart, or another edition (`correct.reference`).",
        )
    return ()


def apply_matrix(image: npt.NDArray[np.float32], matrix: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
    """Return `matrix` [3, 3], or [3, 6] of a root-polynomial, applied to every pixel of `image` [H, W, 3]; a new array.

    A pixel's result depends on that pixel alone, so it is the same for any number of threads. NaN stays NaN (and spreads
    to the channels that depend on it).
    """
    pixels = np.ascontiguousarray(image, dtype=np.float32)
    if pixels.ndim != 3 or pixels.shape[2] != 3 or np.shape(matrix) not in {(3, 3), (3, 6)}:
        raise CalibrateError(
            f"apply_matrix: image of shape {np.shape(image)} and matrix of shape {np.shape(matrix)}; expected "
            "(height, width, 3) and (3, 3), or (3, 6) for a root-polynomial. Pass a colour image and such a matrix."
        )
    if np.shape(matrix) == (3, 6):
        out = np.empty_like(pixels)
        for row in range(0, len(pixels), _ROWS_AT_A_TIME):
            part = pixels[row : row + _ROWS_AT_A_TIME]
            positive = np.maximum(part, 0)
            terms = np.concatenate([part, np.sqrt(positive * np.roll(positive, -1, axis=-1))], axis=-1)
            out[row : row + _ROWS_AT_A_TIME] = terms @ np.asarray(matrix, dtype=np.float32).T
        return out
    return np.asarray(cv2.transform(pixels, np.asarray(matrix, dtype=np.float64)), dtype=np.float32)


def _once(xyz: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """One over how often the colour of each patch [N] stands on the chart."""
    lab = lab_from_xyz(xyz)
    alike = delta_e_2000(np.repeat(lab, len(lab), axis=0), np.tile(lab, (len(lab), 1))) < _SAME_COLOUR
    return np.asarray(1.0 / alike.reshape(len(lab), -1).sum(axis=1))


def _check_patches(camera: npt.NDArray[np.float64], reference: "ChartReference") -> None:
    names, white = reference.names, reference.layout.white_patch
    if camera.shape != (len(names), 3):
        raise CalibrateError(
            f"correct: camera RGB of shape {camera.shape}; expected ({len(names)}, 3), one row a patch. "
            "Measure all patches of the chart."
        )
    bad = [name for name, rgb in zip(names, camera, strict=True) if not np.isfinite(rgb).all()]
    if bad:
        raise CalibrateError(
            f"correct: no finite camera RGB for {', '.join(bad)}; every patch must be measured. Add a shorter "
            "exposure if the patch is clipped, or set the corners in `correct.chart`."
        )
    if (camera[white] <= 0).any():
        raise CalibrateError(
            f"correct: the white patch reads {camera[white].round(5).tolist()}; all channels must be positive. "
            "Check the black level, or set the corners in `correct.chart`."
        )
    spread = np.linalg.svd(camera, compute_uv=False)
    if spread[-1] * _LARGEST_CONDITION < spread[0]:
        raise CalibrateError(
            "correct: the three channels of the patches do not differ, so no colour can be told apart; expected a colour "
            "image. Check that the frames are RAW mosaics of a colour camera."
        )


def _held_patches(white_preserving: bool, white: str, layout: "Layout") -> npt.NDArray[np.bool_]:
    held = np.zeros(layout.count, dtype=np.bool_)
    if white not in {"patch", "neutrals"}:
        raise CalibrateError(
            f"correct.white: {white!r} is unknown; expected 'patch' or 'neutrals'. Set `correct.white: patch`."
        )
    if white_preserving:
        held[[layout.white_patch] if white == "patch" else list(layout.neutrals)] = True
    return held


def _doubts(light: npt.NDArray[np.float64]) -> tuple[str, ...]:
    ratio = float(light.max() / light.min())
    if ratio <= _UNEVEN_LIGHT:
        return ()
    return (
        f"correct.chart: the light on the chart differs by a factor of {ratio:.2f} from one corner to another (up to "
        f"{_UNEVEN_LIGHT} is usual). It was taken out of the fit; turn the chart so that it is lit more evenly.",
    )


def _fit(
    camera: npt.NDArray[np.float64],
    target: npt.NDArray[np.float64],
    *,
    weights: npt.NDArray[np.float64],
    held: npt.NDArray[np.bool_],
    places: npt.NDArray[np.float64],
    kept: npt.NDArray[np.bool_],
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return the matrix [3, 3] fitted to the `kept` patches, and the light on every patch [N].

    The light is exp(places · slope); with `places` of no columns it is even.
    """
    slope = np.zeros(places.shape[1])
    root = np.sqrt(weights[kept])[:, None]

    def solved(at: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
        even = camera[kept] * np.exp(-(places[kept] @ at))[:, None]
        matrix = least_squares(even, target[kept], weights[kept], held[kept])
        return matrix, ((even @ matrix.T - target[kept]) * root).ravel()

    # Gauss–Newton on two slopes: from even light it converges in three to five steps, quadratically.
    for _ in range(_MOST_STEPS if len(slope) else 0):
        _, residual = solved(slope)
        tangents = [
            (solved(slope + _DIFFERENCE * axis)[1] - solved(slope - _DIFFERENCE * axis)[1]) / (2 * _DIFFERENCE)
            for axis in np.eye(len(slope))
        ]
        step = np.linalg.lstsq(np.stack(tangents, axis=1), -residual, rcond=None)[0]
        # At most half an e-fold a step, so that a hopeless chart cannot send the exponent off.
        slope = slope + np.clip(step, -0.5, 0.5)
        if np.abs(step).max() < 1e-10:
            break
    return solved(slope)[0], np.exp(places @ slope)


def least_squares(
    camera: npt.NDArray[np.float64],
    target: npt.NDArray[np.float64],
    weights: npt.NDArray[np.float64],
    held: npt.NDArray[np.bool_],
) -> npt.NDArray[np.float64]:
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
