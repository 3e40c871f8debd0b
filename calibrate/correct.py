"""Camera RGB to working RGB by a 3×3 matrix fitted to a colour chart.

The matrix minimises Σ_p w_p |M c_p − t_p|² over the patches, t the chart's published colours under D65. Two choices of
weight: ``"lightness"``, w = Y^(−4/3), counts an error as CIELAB does (its cube root has the slope Y^(−2/3)), so all patches
weigh about as they are seen; ``"linear"``, w = 1, counts radiance, which the white patch and its neighbours dominate. Both
are closed forms, depend on the published data only, and are exact for a camera that obeys the Luther condition; as all
rows of M share the weights, the result does not depend on the space in which the residual is counted.

The default is ``"lightness"``, because no chart is lit evenly. Mean CIEDE2000 over cameras, linear / lightness, with the
light falling off by so much across the chart (the colours are judged without the fall-off): under D65 0 % 0.86 / 0.89,
10 % 0.96 / 0.91, 20 % 1.21 / 0.99, 40 % 1.87 / 1.24; under illuminant A 2.37 / 2.49, 2.42 / 2.50, 2.56 / 2.52, 2.95 / 2.61.
For the same reason a held white is an option: it gains 5–10 % in even light (0.83 and 2.22) and loses in uneven (40 %:
2.17 and 3.19).

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

# From this condition number of the patches' camera RGB on, three channels are in effect two.
_LARGEST_CONDITION: Final = 1e6


@dataclass(frozen=True, slots=True)
class ColourFit:
    """A fitted camera matrix and how well it does, patch by patch.

    `matrix` [3, 3] is RGB_from_camera. `delta_e` and `delta_e_loo` [24] are CIEDE2000 under D65 against the reference;
    for the latter each patch is left out of the fit that predicts it. `fitted_rgb` and `target_rgb` [24, 3] are linear
    working RGB, 1 = a perfect white diffuser. `white_preserved` says what was held exactly.
    """

    matrix: npt.NDArray[np.float64]
    delta_e: npt.NDArray[np.float64]
    delta_e_loo: npt.NDArray[np.float64]
    fitted_rgb: npt.NDArray[np.float64]
    target_rgb: npt.NDArray[np.float64]
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
    weighting: Literal["linear", "lightness"] = "lightness",
) -> ColourFit:
    """Return the 3×3 matrix that takes the chart as the camera saw it to its published colours.

    The scale is the chart's: a perfect white diffuser standing at the chart becomes RGB (1, 1, 1), and the white patch
    its published Y (exactly so if it is preserved, else as well as least squares can).

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
        ``"lightness"`` or ``"linear"``, see the module.

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
            f"correct.weighting: {weighting!r} is unknown; expected 'lightness' or 'linear'. "
            "Set `correct.weighting: lightness`."
        )
    held = _held_patches(white_preserving, white, len(camera))
    xyz_from_camera = least_squares(camera, xyz, weights, held)

    reference_lab = lab_from_xyz(xyz)
    delta_e = delta_e_2000(lab_from_xyz(camera @ xyz_from_camera.T), reference_lab)
    delta_e_loo = np.empty(len(camera))
    for left_out in range(len(camera)):
        kept = np.arange(len(camera)) != left_out
        rest = least_squares(camera[kept], xyz[kept], weights[kept], held[kept])
        delta_e_loo[left_out] = delta_e_2000(lab_from_xyz(rest @ camera[left_out]), reference_lab[left_out])

    matrix = np.asarray(rgb_from_xyz, dtype=np.float64) @ xyz_from_camera
    return ColourFit(
        matrix=matrix,
        delta_e=delta_e,
        delta_e_loo=delta_e_loo,
        fitted_rgb=camera @ matrix.T,
        target_rgb=xyz @ np.asarray(rgb_from_xyz, dtype=np.float64).T,
        names=reference.names,
        white_preserved=white if white_preserving else "none",
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
