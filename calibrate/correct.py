"""Camera RGB to working RGB by a 3×3 matrix fitted to a colour chart.

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

Root-polynomial fits and fits of spectra are left out here.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal

import cv2
import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.difference import delta_e_2000, lab_from_xyz

if TYPE_CHECKING:
    from calibrate.chart.reference import ChartReference

WHITE_PATCH: Final = 18
NEUTRAL_PATCHES: Final = slice(18, 24)

# The patches' places on the chart: columns and rows from −½ to ½.
_PLACES: Final = np.stack([np.arange(24) % 6 / 5 - 0.5, np.arange(24) // 6 / 3 - 0.5], axis=-1)
_UNEVEN_LIGHT: Final = 1.6
_MOST_STEPS: Final = 12
_DIFFERENCE: Final = 1e-5

# From this condition number of the patches' camera RGB on, three channels are in effect two.
_LARGEST_CONDITION: Final = 1e6


@dataclass(frozen=True, slots=True)
class ColourFit:
    """A fitted camera matrix and how well it does, patch by patch.

    `matrix` [3, 3] is RGB_from_camera. `delta_e` and `delta_e_loo` [24] are CIEDE2000 under D65 against the reference;
    for the latter each patch is left out of the fit that predicts it. `fitted_rgb` and `target_rgb` [24, 3] are linear
    working RGB, 1 = a perfect white diffuser. `shading` [24] is the relative light on each patch (geometric mean 1), which
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
) -> ColourFit:
    """Return the 3×3 matrix that takes the chart as the camera saw it to its published colours.

    The scale is the chart's: a perfect white diffuser at the middle of the chart becomes RGB (1, 1, 1), and the white
    patch its published Y (exactly so if it is preserved, else as well as least squares can).

    Parameters
    ----------
    camera_rgb
        Shape (24, 3). Mean camera RGB of each patch, linear, any scale, in the order of `reference`.
    reference
        Published XYZ under D65, Y of a perfect white = 1.
    rgb_from_xyz
        Shape (3, 3). Working RGB of D65 white is (1, 1, 1).
    white_preserving
        Hold a white exactly: the white patch, or with ``white="neutrals"`` the mean of the six neutral patches (steadier
        when the white patch is dirty or shiny).
    weighting
        ``"linear"`` or ``"lightness"``, see the module.
    shading
        ``"plane"`` lets the light fall off across the chart, see the module; ``"none"`` takes it as even.

    Raises
    ------
    CalibrateError
        If a patch is not finite, the white is not positive, or the three channels do not differ.
    """
    camera = np.asarray(camera_rgb, dtype=np.float64)
    _check_patches(camera, reference.names)
    xyz = np.asarray(reference.XYZ, dtype=np.float64)
    weights = {"lightness": xyz[:, 1] ** (-4 / 3), "linear": np.ones(len(xyz))}.get(weighting)
    if weights is None:
        raise CalibrateError(
            f"correct.weighting: {weighting!r} is unknown; expected 'linear' or 'lightness'. "
            "Set `correct.weighting: linear`."
        )
    if shading not in {"plane", "none"}:
        raise CalibrateError(
            f"correct.shading: {shading!r} is unknown; expected 'plane' or 'none'. Set `correct.shading: plane`."
        )
    held = _held_patches(white_preserving, white, len(camera))
    places = _PLACES if shading == "plane" else np.zeros((len(camera), 0))
    everything = np.ones(len(camera), dtype=np.bool_)
    xyz_from_camera, light = _fit(camera, xyz, weights=weights, held=held, places=places, kept=everything)

    reference_lab = lab_from_xyz(xyz)
    even = camera / light[:, None]
    delta_e = delta_e_2000(lab_from_xyz(even @ xyz_from_camera.T), reference_lab)
    delta_e_loo = np.empty(len(camera))
    for left_out in range(len(camera)):
        kept = np.arange(len(camera)) != left_out
        rest, rest_light = _fit(camera, xyz, weights=weights, held=held, places=places, kept=kept)
        predicted = rest @ camera[left_out] / rest_light[left_out]
        delta_e_loo[left_out] = delta_e_2000(lab_from_xyz(predicted), reference_lab[left_out])

    matrix = np.asarray(rgb_from_xyz, dtype=np.float64) @ xyz_from_camera
    return ColourFit(
        matrix=matrix,
        delta_e=delta_e,
        delta_e_loo=delta_e_loo,
        fitted_rgb=even @ matrix.T,
        target_rgb=xyz @ np.asarray(rgb_from_xyz, dtype=np.float64).T,
        shading=light,
        names=reference.names,
        white_preserved=white if white_preserving else "none",
        warnings=_doubts(light),
    )


def apply_matrix(image: npt.NDArray[np.float32], matrix: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
    """Return `matrix` [3, 3] applied to every pixel of `image` [H, W, 3]; float32, a new array.

    A pixel's result depends on that pixel alone, so it is the same for any number of threads. NaN stays NaN (and spreads
    to the channels that depend on it).
    """
    pixels = np.ascontiguousarray(image, dtype=np.float32)
    if pixels.ndim != 3 or pixels.shape[2] != 3 or np.shape(matrix) != (3, 3):
        raise CalibrateError(
            f"apply_matrix: image of shape {np.shape(image)} and matrix of shape {np.shape(matrix)}; expected "
            "(height, width, 3) and (3, 3). Pass a colour image and a 3×3 matrix."
        )
    return np.asarray(cv2.transform(pixels, np.asarray(matrix, dtype=np.float64)), dtype=np.float32)


def _check_patches(camera: npt.NDArray[np.float64], names: tuple[str, ...]) -> None:
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
    if (camera[WHITE_PATCH] <= 0).any():
        raise CalibrateError(
            f"correct: the white patch reads {camera[WHITE_PATCH].round(5).tolist()}; all channels must be positive. "
            "Check the black level, or set the corners in `correct.chart`."
        )
    spread = np.linalg.svd(camera, compute_uv=False)
    if spread[-1] * _LARGEST_CONDITION < spread[0]:
        raise CalibrateError(
            "correct: the three channels of the patches do not differ, so no colour can be told apart; expected a colour "
            "image. Check that the frames are RAW mosaics of a colour camera."
        )


def _held_patches(white_preserving: bool, white: str, count: int) -> npt.NDArray[np.bool_]:
    held = np.zeros(count, dtype=np.bool_)
    if white not in {"patch", "neutrals"}:
        raise CalibrateError(
            f"correct.white: {white!r} is unknown; expected 'patch' or 'neutrals'. Set `correct.white: patch`."
        )
    if white_preserving:
        held[WHITE_PATCH if white == "patch" else NEUTRAL_PATCHES] = True
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
