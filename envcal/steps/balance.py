"""Lamp of known spectrum → von Kries adaptation, or a profile applied."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from envcal import exr, provenance
from envcal.config import BalanceSettings, LampOnChart, LampRectangle, PhotometrySettings
from envcal.errors import EnvcalError
from envcal.profile import Lamp, Profile, matrix_rows, parse, row
from envcal.runner import Outcome
from envcal.steps import chart_light
from envcal.steps.absolute import unit_of_chart
from envcal.steps.lamp import KnownLamp, read_in_difference, read_in_view

if TYPE_CHECKING:
    from uplift.spectrum import RGBSpace

Floats = npt.NDArray[np.float64]

#: What a profile calls the space of the gains where the camera's sensitivities are known.
CAMERA_RGB_BALANCE = "camera RGB"
#: What a profile names as the camera where its sensitivities were estimated from chart and lamp.
ESTIMATED = "estimated"
_CHART_ALONE = (
    "nothing is known of the camera's sensitivities that explains the chart, so colours come from the chart's own matrix: they are "
    "right in the light on the chart, and in others off by ΔE 3 to 5. Give the sensitivities (`balance.camera`)."
)


def calibrate_on_lamp(
    corrected: Path,
    settings: BalanceSettings,
    photometry: PhotometrySettings | None = None,
    *,
    folder: Path = Path(),
    pair: tuple[Path, Path] | None = None,
) -> Profile:
    """Find the lamp in a corrected reference shot and return its profile, completed with the chart's light and the unit.

    Files that the settings name start from `folder`. `pair` are the merged shots with the lamp on and off; the lamp is then
    read in their difference.
    """
    from uplift.spectrum import rgb_space

    header, image, profile = _read_corrected(corrected)
    if settings.camera is not None and settings.transform == "auto" and profile.root_terms is not None:
        raise EnvcalError(
            "balance.camera: a matrix from sensitivities takes the place of the chart's, which was fitted as a root-polynomial. "
            "Set `correct.fit: linear`, or `balance.transform: CAT16`, or leave `balance.camera` out."
        )
    lamp = KnownLamp.of(settings, folder)
    space = rgb_space(profile.working_space)
    if pair is None:
        reading = read_in_view(header, image, profile, settings, lamp, xyz_from_rgb=space.xyz_from_rgb)
    else:
        reading = read_in_difference(pair, profile, settings, xyz_from_rgb=space.xyz_from_rgb)
    light, doubts = chart_light.measure(profile, settings.camera, folder, lamp=lamp.measured, lamp_rgb=reading.rgb)
    sensitivities = None
    if settings.transform == "auto" and profile.root_terms is None:
        sensitivities = chart_light.estimated_camera(light) if settings.camera is None else lamp.sensitivities
        doubts += [_CHART_ALONE] if sensitivities is None else []
    if sensitivities is None:
        matrix, gains = _in_cones(reading.rgb, settings, lamp, space)
    else:
        matrix, gains = _in_camera_rgb(reading.rgb, sensitivities, np.asarray(profile.matrix), settings, lamp, space)
    named = isinstance(settings.lamp, LampRectangle | LampOnChart)
    completed = profile.model_copy(
        update={
            "lamp": Lamp(
                found="settings" if named else "auto" if pair is None else "pair",
                polygon=[(round(float(x), 3), round(float(y), 3)) for x, y in reading.polygon],
                pixels=int(reading.pixels),
                clipped=int(reading.clipped),
                rgb=row(reading.rgb),
                noise=row(reading.noise),
                transform=_cones(settings) if sensitivities is None else CAMERA_RGB_BALANCE,
                luminance=settings.luminance,
                cone_gains=row(gains),
                spectrum=None if settings.spectrum is None else settings.spectrum.name,
                camera=None if sensitivities is None else settings.camera or ESTIMATED,
            ),
            "balance_matrix": matrix_rows(matrix),
            "warnings": [*profile.warnings, *reading.warnings],
        }
    )
    unit, readings = unit_of_chart(completed, photometry or PhotometrySettings())
    warnings = [*completed.warnings, *doubts, *readings]
    return completed.model_copy(update={"light": light, "unit": unit, "warnings": warnings})


def _in_cones(rgb: Floats, settings: BalanceSettings, lamp: KnownLamp, space: RGBSpace) -> tuple[Floats, Floats]:
    """Von Kries gains in a cone space that take the lamp's `rgb` [3] to its own colour: matrix [3, 3] and gains [3]."""
    from calibrate.adapt import cone_matrix, von_kries_matrix

    matrix = von_kries_matrix(
        rgb,
        # (1, 1, 1) for D65 in a space whose white is D65.
        space.rgb_from_xyz @ (lamp.xyz / lamp.xyz[1]),
        xyz_from_rgb=space.xyz_from_rgb,
        transform=_cones(settings),
        luminance=settings.luminance,
    )
    cones = cone_matrix(_cones(settings), space.xyz_from_rgb)
    return matrix, np.diag(cones @ matrix @ np.linalg.inv(cones))


def _cones(settings: BalanceSettings) -> str:
    return "CAT16" if settings.transform == "auto" else settings.transform


def _in_camera_rgb(
    rgb: Floats,
    sensitivities: Floats,
    rgb_from_camera: Floats,
    settings: BalanceSettings,
    lamp: KnownLamp,
    space: RGBSpace,
) -> tuple[Floats, Floats]:
    """The same in camera RGB, and a matrix from the camera's `sensitivities` [N, 3] in the place of the chart's."""
    from calibrate.trained import matrix_of_sensitivities

    camera_from_rgb = np.linalg.inv(rgb_from_camera)
    camera_rgb = camera_from_rgb @ rgb
    xyz_from_camera = matrix_of_sensitivities(
        camera_rgb,
        sensitivities,
        lamp=lamp.spectrum,
        daylight=lamp.daylight,
        observer=lamp.observer.cmfs,
        wavelengths_nm=lamp.observer.wavelengths_nm,
    )
    if settings.luminance == "keep":
        xyz_from_camera = xyz_from_camera * float(space.xyz_from_rgb[1] @ rgb)
    return space.rgb_from_xyz @ xyz_from_camera @ camera_from_rgb, camera_rgb[1] / camera_rgb


def balance(
    corrected: Path, out: Path, settings: BalanceSettings, profile: Profile, *, applied: str | None = None
) -> Outcome:
    """Write `corrected` balanced by the profile's lamp to `out`; the lamp reads as D65, (1, 1, 1) in most spaces.

    With a profile that has a unit, all is in cd/m².
    """
    from calibrate.correct import apply_matrix

    if profile.lamp is None or profile.balance_matrix is None:
        raise EnvcalError(
            f"{applied or 'the profile'}: has no lamp balance yet. Run `envcal balance` on the reference shot without --profile: it "
            "finds the lamp and writes the completed profile beside its output."
        )
    header, image, own = _read_corrected(corrected)
    if own.matrix != profile.matrix or own.root_terms != profile.root_terms:
        raise EnvcalError(
            f"{corrected}: was corrected with another chart matrix than the profile's. Correct it with the same "
            f"profile first: `envcal correct MERGED -o {corrected.name} --profile PROFILE`."
        )
    unit = profile.unit
    balanced = apply_matrix(image, np.asarray(profile.balance_matrix) * (1.0 if unit is None else unit.factor))
    attributes = {
        **provenance.attributes("balance", settings=settings.model_dump(mode="json"), inputs=[corrected], unit=unit),
        **provenance.colour_space(profile.working_space),
        "envcalCamera": header.json("envcalCamera"),
        "envcalProfile": profile.model_dump(mode="json"),
    }
    exr.write(out, exr.with_lost(balanced), attributes=attributes)
    lamp_now = np.asarray(profile.balance_matrix) @ np.asarray(profile.lamp.rgb)
    figures = {
        "shot": out.stem,
        "lamp_rgb": list(profile.lamp.rgb),
        "lamp_rgb_balanced": [float(v) for v in lamp_now],
        "lamp_pixels": profile.lamp.pixels,
        "cone_gains": list(profile.lamp.cone_gains),
        "transform": profile.lamp.transform,
        "camera": profile.lamp.camera,
        "unit": None if unit is None else unit.model_dump(mode="json"),
        "chart_light": profile.light
        and profile.light.model_dump(
            exclude={"emission", "sigma", "wavelengths_nm", "measured", "readings", "fitted", "sensitivities"}
        ),
    }
    r, g, b = profile.lamp.rgb
    now = ", ".join(f"{v:.4g}" for v in lamp_now)
    summary = (
        f"lamp of {profile.lamp.pixels} pixels at ({r:.3f}, {g:.3f}, {b:.3f}) → ({now}) in {profile.lamp.transform}"
    )
    if profile.lamp.camera is not None:
        summary += ", matrix by sensitivities " + (
            "estimated from chart and lamp" if profile.lamp.camera == ESTIMATED else f"of {profile.lamp.camera}"
        )
    if applied is not None:
        summary = f"profile {applied} of {profile.reference_shot} applied; no lamp was looked for"
    return Outcome(summary if unit is None else f"{summary}; {unit.told()}", figures)


def _read_corrected(path: Path) -> tuple[exr.Header, npt.NDArray[np.float32], Profile]:
    header, image = exr.read_rgb(path)
    if header.attributes.get("envcalStage") != "correct":
        stage = header.attributes.get("envcalStage", "unknown")
        raise EnvcalError(
            f"{path}: was not written by `envcal correct` (stage {stage}); the lamp is balanced after the chart. Run `envcal correct MERGED -o {path.name}` first."
        )
    return header, image, parse(str(header.attributes.get("envcalProfile", "")), place=f"{path}: its envcalProfile")
