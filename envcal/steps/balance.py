"""Lamp of known spectrum → von Kries adaptation, or a profile applied."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import numpy.typing as npt

from envcal import exr, provenance
from envcal.cameras import sensitivities
from envcal.config import BalanceSettings, LampOnChart, LampRectangle, PhotometrySettings
from envcal.errors import EnvcalError
from envcal.profile import Lamp, Profile, matrix_rows, parse, row
from envcal.runner import Outcome
from envcal.spd import read_spd
from envcal.steps import chart_light
from envcal.steps.absolute import unit_of_chart

#: What a profile calls the space of the gains where the camera's sensitivities are known.
CAMERA_RGB_BALANCE = "camera RGB"


def calibrate_on_lamp(
    corrected: Path,
    settings: BalanceSettings,
    photometry: PhotometrySettings | None = None,
    *,
    folder: Path = Path(),
) -> Profile:
    """Find the lamp in a corrected reference shot and return its profile, completed with the chart's light and the unit.

    Files that the settings name start from `folder`.
    """
    from calibrate.adapt import cone_matrix, von_kries_matrix
    from calibrate.lamp import find_lamp, measure_lamp, rectangle_from_chart
    from calibrate.trained import matrix_of_sensitivities
    from uplift.illuminants import measured_emission
    from uplift.spectrum import illuminant, observer, rgb_space, xyz_of

    header, image, profile = _read_corrected(corrected)
    if settings.camera is not None and profile.root_terms is not None:
        raise EnvcalError(
            "balance.camera: a matrix from sensitivities takes the place of the chart's, which was fitted as a root-polynomial. "
            "Set `correct.fit: linear`, or leave `balance.camera` out."
        )
    space = rgb_space(profile.working_space)
    corners = np.asarray(profile.chart.corners, np.float64)
    latlong = header.size[1] == 2 * header.size[0]
    if settings.lamp == "auto":
        lamp = find_lamp(image, chart_corners=corners, xyz_from_rgb=space.xyz_from_rgb, latlong=latlong)
    elif isinstance(settings.lamp, LampRectangle):
        lamp = measure_lamp(image, rectangle=settings.lamp.rectangle, xyz_from_rgb=space.xyz_from_rgb, latlong=latlong)
    else:
        assert isinstance(settings.lamp, LampOnChart)
        polygon = rectangle_from_chart(settings.lamp.chart_rectangle, corners)
        lamp = measure_lamp(image, polygon, xyz_from_rgb=space.xyz_from_rgb, latlong=latlong)
    seen = observer()
    daylight = illuminant("D65", seen)
    spectrum = daylight
    if settings.spectrum is not None:
        path = folder / settings.spectrum
        spectrum = measured_emission(*read_spd(path), seen, name=str(path))
    # (1, 1, 1) for D65 in a space whose white is D65.
    lamp_xyz = xyz_of(spectrum, seen)
    destination = space.rgb_from_xyz @ (lamp_xyz / lamp_xyz[1])
    transform = settings.transform if settings.camera is None else CAMERA_RGB_BALANCE
    if settings.camera is None:
        matrix = von_kries_matrix(
            lamp.rgb,
            destination,
            xyz_from_rgb=space.xyz_from_rgb,
            transform=settings.transform,
            luminance=settings.luminance,
        )
        cones = cone_matrix(settings.transform, space.xyz_from_rgb)
        gains = np.diag(cones @ matrix @ np.linalg.inv(cones))
    else:
        spectral = sensitivities(chart_light.place_of(settings.camera, folder), seen.wavelengths_nm)
        camera_from_rgb = np.linalg.inv(np.asarray(profile.matrix))
        reading = camera_from_rgb @ lamp.rgb
        xyz_from_camera = matrix_of_sensitivities(
            reading,
            spectral,
            lamp=spectrum,
            daylight=daylight,
            observer=seen.cmfs,
            wavelengths_nm=seen.wavelengths_nm,
        )
        if settings.luminance == "keep":
            xyz_from_camera = xyz_from_camera * float(space.xyz_from_rgb[1] @ lamp.rgb)
        matrix = space.rgb_from_xyz @ xyz_from_camera @ camera_from_rgb
        gains = reading[1] / reading
    completed = profile.model_copy(
        update={
            "lamp": Lamp(
                found="auto" if settings.lamp == "auto" else "settings",
                polygon=[(round(float(x), 3), round(float(y), 3)) for x, y in lamp.polygon],
                pixels=int(lamp.pixels),
                clipped=int(lamp.clipped),
                rgb=row(lamp.rgb),
                noise=row(lamp.noise),
                transform=transform,
                luminance=settings.luminance,
                cone_gains=row(gains),
                spectrum=None if settings.spectrum is None else settings.spectrum.name,
                camera=settings.camera,
            ),
            "balance_matrix": matrix_rows(matrix),
            "warnings": [*profile.warnings, *lamp.warnings],
        }
    )
    light, doubts = chart_light.measure(
        completed, settings.camera, folder, lamp=None if settings.spectrum is None else spectrum
    )
    unit, readings = unit_of_chart(completed, photometry or PhotometrySettings())
    warnings = [*completed.warnings, *doubts, *readings]
    return completed.model_copy(update={"light": light, "unit": unit, "warnings": warnings})


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
        "unit": None if unit is None else unit.model_dump(mode="json"),
        "chart_light": profile.light
        and profile.light.model_dump(exclude={"emission", "sigma", "wavelengths_nm", "measured", "readings", "fitted"}),
    }
    r, g, b = profile.lamp.rgb
    now = ", ".join(f"{v:.4g}" for v in lamp_now)
    summary = (
        f"lamp of {profile.lamp.pixels} pixels at ({r:.3f}, {g:.3f}, {b:.3f}) → ({now}) in {profile.lamp.transform}"
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
