"""Lamp of known spectrum → von Kries adaptation, or a profile applied."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING

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

if TYPE_CHECKING:
    from calibrate.lamp import Lamp as Reading

Floats = npt.NDArray[np.float64]

#: What a profile calls the space of the gains where the camera's sensitivities are known.
CAMERA_RGB_BALANCE = "camera RGB"


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
    from calibrate.adapt import cone_matrix, von_kries_matrix
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
    seen = observer()
    daylight = illuminant("D65", seen)
    spectrum = daylight
    if settings.spectrum is not None:
        path = folder / settings.spectrum
        spectrum = measured_emission(*read_spd(path), seen, name=str(path))
    # (1, 1, 1) for D65 in a space whose white is D65.
    lamp_xyz = xyz_of(spectrum, seen)
    if pair is None:
        camera_rgb = _expected(header, settings, spectrum, lamp_xyz, seen.wavelengths_nm, folder)
        lamp = _read_lamp(header, image, profile, settings, xyz_from_rgb=space.xyz_from_rgb, camera_rgb=camera_rgb)
    else:
        lamp = _read_pair(pair, profile, settings, xyz_from_rgb=space.xyz_from_rgb)
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
                found="settings" if settings.lamp != "auto" else "auto" if pair is None else "pair",
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


def _expected(
    header: exr.Header,
    settings: BalanceSettings,
    spectrum: Floats,
    lamp_xyz: Floats,
    wavelengths_nm: Floats,
    folder: Path,
) -> Floats | None:
    """Camera RGB [3] that the lamp should have: by the camera's sensitivities, else by its published matrix, else None."""
    if settings.camera is not None:
        return np.asarray(spectrum @ sensitivities(chart_light.place_of(settings.camera, folder), wavelengths_nm))
    if "envcalCameraFromXYZ" not in header.attributes:
        return None
    return np.asarray(np.asarray(header.json("envcalCameraFromXYZ"), np.float64) @ lamp_xyz)


def _read_lamp(
    header: exr.Header,
    image: npt.NDArray[np.float32],
    profile: Profile,
    settings: BalanceSettings,
    *,
    xyz_from_rgb: Floats,
    camera_rgb: Floats | None,
) -> Reading:
    """The lamp in one picture in working RGB: where the settings say, else the one found."""
    from calibrate.lamp import find_lamp

    if settings.lamp != "auto":
        return _read_named(image, profile, settings, header, xyz_from_rgb=xyz_from_rgb, alone=False)
    corners = np.asarray(profile.chart.corners, np.float64)
    latlong = header.size[1] == 2 * header.size[0]
    # Root terms are of no account for a colour that is expected to a percent only.
    expected = None if camera_rgb is None else np.asarray(profile.matrix, np.float64) @ camera_rgb
    return find_lamp(image, chart_corners=corners, xyz_from_rgb=xyz_from_rgb, expected_rgb=expected, latlong=latlong)


def _read_named(
    image: npt.NDArray[np.float32],
    profile: Profile,
    settings: BalanceSettings,
    header: exr.Header,
    *,
    xyz_from_rgb: Floats,
    alone: bool,
) -> Reading:
    """The lamp where the settings say that it is; `alone`: the picture holds no other light."""
    from calibrate.lamp import measure_lamp, rectangle_from_chart

    latlong = header.size[1] == 2 * header.size[0]
    if isinstance(settings.lamp, LampRectangle):
        return measure_lamp(
            image, rectangle=settings.lamp.rectangle, xyz_from_rgb=xyz_from_rgb, latlong=latlong, alone=alone
        )
    assert isinstance(settings.lamp, LampOnChart)
    polygon = rectangle_from_chart(settings.lamp.chart_rectangle, np.asarray(profile.chart.corners, np.float64))
    return measure_lamp(image, polygon, xyz_from_rgb=xyz_from_rgb, latlong=latlong, alone=alone)


def _read_pair(
    pair: tuple[Path, Path], profile: Profile, settings: BalanceSettings, *, xyz_from_rgb: Floats
) -> Reading:
    """The lamp in the difference of two merged pictures, lamp on and lamp off."""
    from calibrate.correct import apply_matrix
    from calibrate.lamp import find_lit_lamp, lamp_alone

    (header, on, sigma_on), (_, off, sigma_off) = (_read_merged(path) for path in pair)
    white = np.asarray(profile.chart.white.camera_rgb)
    alone = lamp_alone(on, off, sigma_on=sigma_on, sigma_off=sigma_off, white_rgb=white)
    working = apply_matrix(alone.light, profile.full_matrix())
    if settings.lamp == "auto":
        latlong = header.size[1] == 2 * header.size[0]
        lamp = find_lit_lamp(alone, working, xyz_from_rgb=xyz_from_rgb, latlong=latlong)
    else:
        lamp = _read_named(working, profile, settings, header, xyz_from_rgb=xyz_from_rgb, alone=True)
    return dataclasses.replace(lamp, warnings=(*alone.warnings, *lamp.warnings))


def _read_merged(path: Path) -> tuple[exr.Header, npt.NDArray[np.float32], npt.NDArray[np.float32]]:
    header, image = exr.read_rgb(path)
    names = [f"sigma.{channel}" for channel in "RGB"]
    if header.attributes.get("envcalSpace") != provenance.CAMERA_RGB or any(n not in header.channels for n in names):
        raise EnvcalError(
            f"{path}: is no merged bracket with its noise, which the difference of lamp on and lamp off needs. Make it with "
            "`envcal merge FRAME… -o merged.exr --set deviation=true`."
        )
    _, planes = exr.read(path, [*names, "lost"])
    # Lost light may have been filled with what nobody measured.
    image = np.where(planes["lost"][..., None] > 0, np.float32(np.nan), image)
    return header, image, np.stack([planes[name] for name in names], axis=2)


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
