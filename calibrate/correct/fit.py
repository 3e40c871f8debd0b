"""The fit of a camera's matrix to a chart: what is asked of it, what it gives, and how well it does.

``"auto"`` takes the root-polynomial where it predicts patches that it has not seen clearly better than the matrix does (mean
CIEDE2000, each left out once).
"""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Literal

import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.correct.model import ChartFit, Floats, root_terms, stands_once
from calibrate.correct.spoilt import spoilt_patches, spoilt_warnings
from calibrate.difference import delta_e_2000, lab_from_xyz

if TYPE_CHECKING:
    from calibrate.chart.reference import ChartReference

_UNEVEN_LIGHT: Final = 1.6
# The root-polynomial must predict what it has not seen by this part better; it has twice as many numbers to fit.
_CLEARLY_BETTER: Final = 0.85
# A fit as bad as this is none: the largest mean met with cameras of the literature under CIE lamps was 4.3.
_BAD_FIT: Final = 12.0
_POOR_FIT: Final = 6.0

# From this condition number of the patches' camera RGB on, three channels are in effect two.
_LARGEST_CONDITION: Final = 1e6


@dataclass(frozen=True, slots=True)
class ColourFit:
    """A fitted camera matrix and how well it does, patch by patch.

    `matrix` [3, 3] is RGB_from_camera; for a root-polynomial it is [3, 6] and multiplies (r, g, b, √rg, √gb, √br).
    `delta_e` and `delta_e_loo` [N] are CIEDE2000 under D65 against the reference; for the latter each patch is left out of
    the fit that predicts it. `fitted_rgb` and `target_rgb` [N, 3] are linear working RGB, 1 = a perfect white diffuser.
    `shading` [N] is the relative light on each patch (geometric mean 1), which `fitted_rgb` and the differences are free
    of. `white_preserved` says what was held exactly. `left_out` [N] marks patches that were spoilt and have no part in the
    fit. `model` is the one that was taken.
    """

    matrix: Floats
    delta_e: Floats
    delta_e_loo: Floats
    fitted_rgb: Floats
    target_rgb: Floats
    shading: Floats
    names: tuple[str, ...]
    white_preserved: str
    left_out: npt.NDArray[np.bool_]
    model: Literal["linear", "root-polynomial"] = "linear"
    warnings: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class _Judged:
    """One model's fit: its terms [N, T], matrix, light [N], and CIEDE2000 [N] with each patch in and left out."""

    terms: Floats
    matrix: Floats
    light: Floats
    left_out: npt.NDArray[np.bool_]
    delta_e: Floats
    delta_e_loo: Floats


def fit_matrix(
    camera_rgb: Floats,
    reference: "ChartReference",
    *,
    rgb_from_xyz: Floats,
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
        ``"linear"`` or ``"lightness"``, see `calibrate.correct.model`.
    shading
        ``"plane"`` lets the light fall off across the chart, see there; ``"none"`` takes it as even.
    model
        ``"linear"``, ``"root-polynomial"``, or ``"auto"``: what predicts unseen patches better.
    spoilt
        Whether patches that the others' fit misses by far are left out.

    Raises
    ------
    CalibrateError
        If a patch is not finite, the white is not positive, the three channels do not differ, too many patches are spoilt, or
        nothing fits.
    """
    _check_choice("fit", model, ("linear", "root-polynomial", "auto"))
    _check_choice("weighting", weighting, ("linear", "lightness"))
    _check_choice("shading", shading, ("plane", "none"))
    _check_choice("white", white, ("patch", "neutrals"))
    camera, xyz = np.asarray(camera_rgb, dtype=np.float64), np.asarray(reference.XYZ, dtype=np.float64)
    _check_patches(camera, reference)
    layout, once = reference.layout, stands_once(xyz)
    held = np.zeros(len(camera), dtype=np.bool_)
    if white_preserving:
        held[[layout.white_patch] if white == "patch" else list(layout.neutrals)] = True
    linear = ChartFit(
        camera=camera,
        terms=camera,
        target=xyz,
        weights=once * xyz[:, 1] ** (-4 / 3) if weighting == "lightness" else once,
        held=held,
        places=layout.places if shading == "plane" else np.zeros((len(camera), 0)),
    )
    best = _best(linear, model, reference.names, leave_out=spoilt == "leave out")
    rgb = np.asarray(rgb_from_xyz, dtype=np.float64)
    matrix = rgb @ best.matrix
    return ColourFit(
        matrix=matrix,
        delta_e=best.delta_e,
        delta_e_loo=best.delta_e_loo,
        fitted_rgb=best.terms / best.light[:, None] @ matrix.T,
        target_rgb=xyz @ rgb.T,
        shading=best.light,
        names=reference.names,
        white_preserved=white if white_preserving else "none",
        left_out=best.left_out,
        model="linear" if matrix.shape[1] == 3 else "root-polynomial",
        warnings=(
            *spoilt_warnings(best.left_out, reference.names),
            *_doubts(best.light),
            *_verdict(best.delta_e[~best.left_out]),
        ),
    )


def _best(linear: ChartFit, model: str, names: tuple[str, ...], *, leave_out: bool) -> _Judged:
    """Fit the model asked for; for ``"auto"`` both, and take the better one."""
    if model == "linear":
        return _judged(linear, names, leave_out=leave_out)
    roots = _judged(replace(linear, terms=root_terms(linear.camera)), names, leave_out=leave_out)
    if model == "root-polynomial":
        return roots
    plain = _judged(linear, names, leave_out=leave_out)
    return roots if roots.delta_e_loo.mean() < _CLEARLY_BETTER * plain.delta_e_loo.mean() else plain


def _judged(problem: ChartFit, names: tuple[str, ...], *, leave_out: bool) -> _Judged:
    """Fit to the patches that are not spoilt, and judge by fits that leave out each patch too."""
    left_out = spoilt_patches(problem, names) if leave_out else np.zeros(len(names), dtype=np.bool_)
    matrix, light = problem.solved(~left_out)
    lab = lab_from_xyz(problem.target)
    delta_e = delta_e_2000(lab_from_xyz(problem.terms / light[:, None] @ matrix.T), lab)
    unseen = np.empty(len(names))
    for index in range(len(names)):
        rest, rest_light = problem.solved(~left_out & (np.arange(len(names)) != index))
        unseen[index] = delta_e_2000(lab_from_xyz(rest @ problem.terms[index] / rest_light[index]), lab[index])
    return _Judged(problem.terms, matrix, light, left_out, delta_e, unseen)


def _check_choice(setting: str, value: str, known: tuple[str, ...]) -> None:
    if value not in known:
        *first, last = (repr(one) for one in known)
        raise CalibrateError(
            f"correct.{setting}: {value!r} is unknown; expected {', '.join(first)} or {last}. "
            f"Set `correct.{setting}: {known[0]}`."
        )


def _check_patches(camera: Floats, reference: "ChartReference") -> None:
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


def _doubts(light: Floats) -> tuple[str, ...]:
    ratio = float(light.max() / light.min())
    if ratio <= _UNEVEN_LIGHT:
        return ()
    return (
        f"correct.chart: the light on the chart differs by a factor of {ratio:.2f} from one corner to another (up to "
        f"{_UNEVEN_LIGHT} is usual). It was taken out of the fit; turn the chart so that it is lit more evenly.",
    )


def _verdict(delta_e: Floats) -> tuple[str, ...]:
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
