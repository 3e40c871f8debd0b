"""Chart → camera RGB to working RGB, or a profile applied."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from envcal import atomic, exr, provenance
from envcal.config import CorrectSettings
from envcal.errors import EnvcalError
from envcal.patches_file import read_patches
from envcal.profile import Camera, Chart, OtherChart, Patch, Profile, exposure_gain, matrix_rows, mismatches, row
from envcal.runner import Outcome

if TYPE_CHECKING:
    from calibrate.chart import ChartFound, ChartReference
    from calibrate.correct import ColourFit

#: From this share of lost pixels on, clipping is named before anything else that may be wrong.
_MUCH_LOST = 0.05


def calibrate_on_chart(
    merged: Path, settings: CorrectSettings, working_space: str, *, folder: Path = Path()
) -> Profile:
    """Find the chart in a merged reference shot and return the profile it gives, without a lamp yet.

    Files that the settings name start from `folder`.
    """
    from calibrate import CalibrateError
    from calibrate.chart import chart_from_corners, chart_reference, find_charts, measure_patches, other_charts
    from calibrate.correct import fit_matrix
    from uplift.spectrum import rgb_space

    header, image = _read_merged(merged)
    reference = (
        chart_reference(settings.reference) if settings.patches is None else read_patches(folder / settings.patches)
    )
    latlong = header.size[1] == 2 * header.size[0]
    try:
        if settings.chart == "auto":
            found, *others = find_charts(image, reference, latlong=latlong)
        else:
            found = chart_from_corners(np.asarray(settings.chart, np.float64), reference.layout)
            others = list(other_charts(image, found, reference, latlong=latlong))
        # Bayer: a quarter of the red and blue samples were measured, half of the green; the rest is interpolated.
        patches = measure_patches(
            image, found.quads, names=reference.names, latlong=latlong, independent=(0.25, 0.5, 0.25)
        )
    except CalibrateError as error:
        lost = float(np.isnan(image).any(axis=2).mean())
        if lost < _MUCH_LOST:
            raise
        raise CalibrateError(
            f"{merged}: {lost:.0%} of the shot is clipped in every frame, which is the likely reason for what follows. Add "
            f"shorter exposures to the bracket.\n{error}"
        ) from error
    fit = fit_matrix(
        patches.rgb,
        reference,
        rgb_from_xyz=rgb_space(working_space).rgb_from_xyz,
        white_preserving=settings.fit == "white-preserving",
        white=settings.white,
        weighting=settings.weighting,
        shading=settings.shading,
        model="linear" if settings.fit == "white-preserving" else settings.fit,
        spoilt=settings.spoilt,
    )
    matrix = fit.matrix if fit.model == "linear" else fit.matrix[:, :3]
    checked, doubts = _checked(image, others, found.corners, fit, reference, working_space, latlong=latlong)
    reflectances = reference.reflectances
    return Profile(
        working_space=working_space,
        camera=_camera(header),
        reference_shot=merged.name,
        reference_digest=atomic.digest(merged),
        chart=Chart(
            reference=reference.name,
            found="auto" if settings.chart == "auto" else "settings",
            corners=_points(found.corners),
            quads=[_points(quad) for quad in found.quads],
            score=float(found.score) if np.isfinite(found.score) else None,
            fit=fit.model if settings.fit == "auto" else settings.fit,
            patches=[
                Patch(
                    name=name,
                    camera_rgb=row(patches.rgb[k]),
                    noise=row(patches.noise[k]),
                    pixels=int(patches.pixels[k]),
                    light=float(fit.shading[k]),
                    left_out=bool(fit.left_out[k]),
                    target_rgb=row(fit.target_rgb[k]),
                    fitted_rgb=row(fit.fitted_rgb[k]),
                    delta_e=float(fit.delta_e[k]),
                    delta_e_left_out=float(fit.delta_e_loo[k]),
                    reflectance=[] if reflectances is None else [float(v) for v in reflectances[k]],
                )
                for k, name in enumerate(reference.names)
            ],
            wavelengths_nm=[] if reference.wavelengths_nm is None else [float(v) for v in reference.wavelengths_nm],
            others=checked,
        ),
        matrix=matrix_rows(matrix),
        root_terms=None if fit.model == "linear" else matrix_rows(fit.matrix[:, 3:]),
        warnings=[*found.warnings, *fit.warnings, *doubts],
    )


def _checked(
    image: npt.NDArray[np.float32],
    others: Sequence[ChartFound],
    corners: npt.NDArray[np.float64],
    fit: ColourFit,
    reference: ChartReference,
    working_space: str,
    *,
    latlong: bool,
) -> tuple[list[OtherChart], list[str]]:
    """What further charts say of the fit to the one at `corners`, and warnings: which was taken, and where they differ."""
    from calibrate import CalibrateError
    from calibrate.chart import measure_patches
    from calibrate.crosscheck import check_chart
    from uplift.spectrum import rgb_space

    out, warnings = [], []
    for chart in others:
        where = f"at {chart.corners.round().astype(int).tolist()}"
        named = f"`correct.chart: {chart.corners.round(1).tolist()}`"
        try:
            patches = measure_patches(image, chart.quads, names=reference.names, latlong=latlong)
            check = check_chart(patches.rgb, fit, reference, rgb_from_xyz=rgb_space(working_space).rgb_from_xyz)
        except CalibrateError as error:
            warnings.append(f"correct.chart: a further chart {where} says nothing of the fit: {error}")
            continue
        out.append(
            OtherChart(
                corners=_points(chart.corners),
                score=float(chart.score),
                delta_e=round(check.delta_e, 4),
                delta_e_balanced=round(check.delta_e_balanced, 4),
                level=round(check.level, 4),
                light_uv=round(check.light_uv, 5),
            )
        )
        taken = f"the one at {corners.round().astype(int).tolist()} is used"
        if check.another_light:
            warnings.append(
                f"correct.chart: several charts, in different light: {taken}; on the other, {where}, the light has another colour "
                f"(Δu′v′ {check.light_uv:.3f}, {check.level:.2g} times as bright). The map is balanced to the light of the chart in "
                f"use. If the other is meant, give its corners: {named}."
            )
        if check.disagrees:
            warnings.append(
                f"correct.chart: several charts that disagree: {taken}; under its matrix the other, {where}, reads a mean ΔE2000 of "
                f"{check.delta_e_balanced:.1f}, its own {fit.delta_e.mean():.1f}. Glare or dirt on one, two lights on one, or another "
                f"edition (`correct.reference`). If the other is the better one, give its corners: {named}."
            )
    return out, warnings


def correct(
    merged: Path, out: Path, settings: CorrectSettings, profile: Profile, *, applied: str | None = None
) -> Outcome:
    """Write `merged` in the profile's working RGB to `out`; 1 is a perfect white diffuser at the chart.

    A shot of another ISO or aperture is brought to the unit of the profile's. `applied` names the profile where it was not made on this shot.
    """
    from calibrate.correct import apply_matrix

    header, image = _read_merged(merged)
    gain = exposure_gain(profile, _camera(header))
    # Both fits scale as the exposure does.
    corrected = apply_matrix(image, profile.full_matrix() * (1.0 if gain is None else gain))
    attributes = {
        **provenance.attributes("correct", settings=settings.model_dump(mode="json"), inputs=[merged]),
        **provenance.colour_space(profile.working_space),
        "envcalCamera": header.json("envcalCamera"),
        "envcalProfile": profile.model_dump(mode="json"),
    }
    if "envcalCameraFromXYZ" in header.attributes:
        attributes["envcalCameraFromXYZ"] = header.json("envcalCameraFromXYZ")
    exr.write(out, exr.with_lost(corrected), attributes=attributes)
    delta_e = profile.delta_e()
    negative = int((corrected < 0).any(axis=2).sum())
    figures = {
        "shot": out.stem,
        "delta_e": delta_e,
        "chart_score": profile.chart.score,
        "chart_found": profile.chart.found,
        "other_charts": [other.model_dump(mode="json", exclude={"corners"}) for other in profile.chart.others],
        "exposure_gain": gain,
        "negative_pixels": negative,
    }
    summary = (
        f"chart ΔE2000 mean {delta_e['mean']:.2f}, largest {delta_e['max']:.2f}; left out mean "
        f"{delta_e['left_out_mean']:.2f}"
    )
    for other in profile.chart.others:
        summary += f"; another chart reads {other.delta_e:.2f} under it, in light {other.level:.2g} times as bright"
    if applied is not None:
        summary = f"profile {applied} of {profile.reference_shot} applied; no chart was looked for"
    warnings = [f"{merged.name}: {text}" for text in mismatches(profile, _camera(header))]
    return Outcome(summary, figures, warnings)


def _read_merged(path: Path) -> tuple[exr.Header, npt.NDArray[np.float32]]:
    header, image = exr.read_rgb(path)
    if header.attributes.get("envcalSpace") != provenance.CAMERA_RGB:
        space = header.attributes.get("envcalSpace") or "unknown"
        raise EnvcalError(
            f"{path}: its colours are {space}, not camera RGB; the chart correction starts from a merged RAW bracket. "
            f"Make one with `envcal merge FRAME… -o merged.exr`."
        )
    return header, image


def _camera(header: exr.Header) -> Camera:
    return Camera.model_validate(header.json("envcalCamera"))


def _points(points: npt.NDArray[Any]) -> list[tuple[float, float]]:
    return [(round(float(x), 3), round(float(y), 3)) for x, y in points]
