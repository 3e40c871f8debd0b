"""The light on the chart: measured with the profile's own raw values, and given to the light of the map that it is."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from envcal.profile import ChartLight, Patch, Profile, row

if TYPE_CHECKING:
    from uplift.lights import Light
    from uplift.spectrum import Observer

#: The chart's light and a light of the map are the same if their colours differ by at most so many standard deviations;
#: to those of the two come these, for the difference of the two ways (in mired and Duv).
_SAME_SIGMAS = 3.0
_MIRED, _DUV = 4.0, 0.002
#: A mix of two lights explains the chart's colour if it comes so near in (u, v), with at least so much of either.
_MIX_UV, _MIX_LEAST = 0.006, 0.08
#: A camera estimated from a chart is believed if it explains the chart so well (chi² per degree of freedom), and is no farther from
#: what cameras are like (mean square of standard deviations). 52 cameras, each left out of the model, under three lights: 1.2 and 3.3 at
#: most; a Foveon sensor, of which the model knows none: 4.9 and 22.
_MOST_CHI2, _MOST_UNLIKELY = 1.5, 6.0
_OF_TWO_LIGHTS = (
    "{name}: its chart measures no spectrum, as several lights reach it{mix}. Colours are calibrated all the same. To have a lamp's spectrum, "
    "photograph the chart where that lamp is much the brightest, or declare the light."
)
_NO_REFLECTANCES = (
    "the light on the chart is not measured: that takes the patches' reflectances, and of a ColorChecker Digital SG only colours are "
    "published. Photograph a Classic or a Passport for it, or give this chart's reflectances as measured in `correct.patches`."
)


def measure(
    profile: Profile,
    camera: str | None,
    folder: Path,
    *,
    lamp: npt.NDArray[np.float64] | None = None,
    lamp_rgb: npt.NDArray[np.float64] | None = None,
) -> tuple[ChartLight | None, list[str]]:
    """Return the light on the chart of a profile that knows its lamp, and warnings. `camera` is a name or a file; `lamp_rgb` [3]
    is what the lamp reads in the profile's working RGB, if the profile does not say it yet.

    `lamp` [N] is the spectrum of the profile's lamp on the standard observer's grid; None: D65. A light that was refused is
    returned too, with the reason; it is kept in the profile and not used.
    """
    from calibrate.chart import SG
    from envcal.cameras import sensitivities
    from uplift import UpliftError
    from uplift.spectrometer import measure_light, reading_of
    from uplift.spectrum import observer

    if lamp_rgb is None:
        lamp_rgb = None if profile.lamp is None else np.asarray(profile.lamp.rgb)
    if lamp_rgb is None:
        return None, []
    patches = _patches_of_known_reflectance(profile)
    if patches is None:
        return None, [_NO_REFLECTANCES] if len(profile.chart.patches) == SG.count else []
    if profile.root_terms is not None:
        # What the camera read of the lamp cannot be had back from working RGB then.
        return None, [
            "the light on the chart is not measured beside a root-polynomial. Set `correct.fit: linear` for that."
        ]
    seen = observer()
    curves = None if camera is None else sensitivities(place_of(camera, folder), seen.wavelengths_nm)
    back = np.linalg.inv(np.asarray(profile.matrix))
    fall_off = np.array([[patch.light] for patch in patches])
    values = np.array([patch.camera_rgb for patch in patches]) / fall_off
    noise = np.array([patch.noise for patch in patches]) / fall_off
    # Glare makes a patch say nothing.
    spoilt = np.array([[patch.left_out] for patch in patches])
    nm = profile.chart.wavelengths_nm
    measured = np.array([np.interp(seen.wavelengths_nm, nm, patch.reflectance) for patch in patches]) if nm else None
    try:
        reading = reading_of(
            values,
            np.where(spoilt, values.max(), noise),
            back @ lamp_rgb,
        )
        found = measure_light(reading, camera=curves, observer=seen, reflectances=measured, lamp=lamp)
    except UpliftError as error:
        return None, [f"the light on the chart could not be measured: {error}"]
    light = ChartLight(
        camera=camera or "",
        camera_loss=round(found.camera_loss, 4),
        camera_unlikely=round(found.camera_unlikely, 4),
        sensitivities=[row(values) for values in found.camera],
        wavelengths_nm=[float(v) for v in seen.wavelengths_nm],
        emission=[float(v) for v in found.emission],
        sigma=[float(v) for v in found.sigma],
        measured=[float(v) for v in found.measured],
        trusted=found.trusted,
        readings=[row(values) for values in reading.values],
        fitted=[row(values) for values in found.explained],
        cct=_number(found.cct),
        duv=_number(found.duv),
        cct_sigma=found.cct_sigma,
        duv_sigma=found.duv_sigma,
        families={name: round(value, 6) for name, value in found.families.items()},
        chi2=found.chi2,
        refused=found.refused,
    )
    if found.refused:
        return light, [f"the light on the chart is not used as a measured spectrum: {found.refused}"]
    return light, []


def _patches_of_known_reflectance(profile: Profile) -> list[Patch] | None:
    """The 24 patches in the order of a Classic whose reflectances are published or were measured; None if there are none."""
    from calibrate.chart import CLASSIC, CLASSIC_ON_SG, SG

    patches = profile.chart.patches
    if len(patches) == SG.count and profile.chart.wavelengths_nm:
        return [patches[k] for k in CLASSIC_ON_SG]
    return patches if len(patches) == CLASSIC.count else None


def estimated_camera(light: ChartLight | None) -> npt.NDArray[np.float64] | None:
    """Return the sensitivities [N, 3] that were estimated with a chart's light, if a matrix may rest on them; else None.

    Two lights that reach the chart unevenly, for which the spectrum is refused, leave the camera what it is.
    """
    if light is None or light.camera or light.camera_unlikely is None or not light.sensitivities:
        return None
    if light.chi2 > _MOST_CHI2 or light.camera_unlikely > _MOST_UNLIKELY:
        return None
    return np.array(light.sensitivities, np.float64)


def place_of(camera: str, folder: Path) -> str | Path:
    """The name of a camera, or the path of its file, which starts from `folder`."""
    return folder / camera if (folder / camera).is_file() else camera


def given(
    lights: Sequence[Light], colours_xyz: npt.NDArray[np.float64], charts: Mapping[str, ChartLight], observer: Observer
) -> tuple[list[Light], list[str]]:
    """Return the lights with the spectra that charts measured, and warnings.

    `colours_xyz` [K, 3] are the colours of the lights in the map, `charts` what was measured, by the names of the profiles.
    Each spectrum goes to the one light of its colour; what a person declared stays. A spectrum without such a light is not
    used, and if a mix of two lights has its colour, that is said.
    """
    out, warnings = list(lights), []
    for name, chart in charts.items():
        if chart.refused:
            mix = _mix(name, chart, colours_xyz, observer)
            warnings += [_OF_TWO_LIGHTS.format(name=name, mix=mix)] if mix else []
            continue
        if chart.cct is None or chart.duv is None:
            continue
        off = [_sigmas_off(chart, light) for light in out]
        best = int(np.argmin(off))
        if off[best] > _SAME_SIGMAS:
            warnings.append(_belongs_to_none(name, chart, colours_xyz, observer))
            continue
        if out[best].declared:
            continue
        if out[best].type == "measured":
            warnings.append(
                f"{name}: its chart measured light {best} as another chart did, whose spectrum is used. Leave one of the two "
                "profiles out."
            )
            continue
        out[best] = _with_spectrum(out[best], name, chart, observer)
    return out, warnings


def _with_spectrum(light: Light, name: str, chart: ChartLight, observer: Observer) -> Light:
    from uplift.illuminants import cct_duv_of, measured_emission

    emission = measured_emission(chart.wavelengths_nm, chart.emission, observer, name=name)
    cct, duv = cct_duv_of(emission, observer)
    family = chart.family
    sure = 1.0 - float(np.linalg.norm(chart.sigma) / np.linalg.norm(chart.emission))
    camera = f"camera {chart.camera}" if chart.camera else "camera fitted along"
    followed, remedy = "", ""
    if chart.trusted is not None and chart.trusted < 1.0:
        followed = f"; only {chart.trusted:.0%} of it, the rest a smooth spectrum of its colour, as it is not sure"
        remedy = "" if chart.camera else "Give the camera's sensitivities (`balance.camera`)."
    return replace(
        light,
        type="measured",
        cct=cct,
        duv=duv,
        emission=emission,
        source=f"measured by the chart of {name} ({camera}; {family} with probability {chart.families[family]:.2f}{followed})",
        confidence=float(np.clip(sure, 0.3, 0.99)),
        remedy=remedy,
        kinds=dict(chart.families),
    )


def _sigmas_off(chart: ChartLight, light: Light) -> float:
    """How many standard deviations the colours of a chart's light and of a light of the map are apart."""
    assert chart.cct is not None and chart.duv is not None
    if not (np.isfinite(light.cct_seen) and np.isfinite(light.duv_seen)):
        return float("inf")
    seen_sigma = light.cct_sigma if np.isfinite(light.cct_sigma) else 0.0
    mired = 1e6 / chart.cct - 1e6 / light.cct_seen
    spread = np.hypot(1e6 * chart.cct_sigma / chart.cct**2, 1e6 * seen_sigma / light.cct_seen**2)
    duv_sigma = light.duv_sigma if np.isfinite(light.duv_sigma) else 0.0
    duv = (chart.duv - light.duv_seen) / np.sqrt(chart.duv_sigma**2 + duv_sigma**2 + _DUV**2)
    return float(np.hypot(mired / np.hypot(spread, _MIRED), duv) / np.sqrt(2.0))


def _belongs_to_none(name: str, chart: ChartLight, colours_xyz: npt.NDArray[np.float64], observer: Observer) -> str:
    return (
        f"{name}: the light on its chart ({chart.cct:.0f} K, Duv {chart.duv:+.4f}) is none of the lights of the map"
        f"{_mix(name, chart, colours_xyz, observer)}. Its spectrum is used for no light. Photograph the chart where the one lamp is "
        f"much the brightest, or declare the light (`cluster.lights`)."
    )


def _mix(name: str, chart: ChartLight, colours_xyz: npt.NDArray[np.float64], observer: Observer) -> str:
    """Which two lights of the map together have the colour of the chart's light, or ""."""
    from uplift.illuminants import measured_emission
    from uplift.spectrum import xyz_of

    xyz = xyz_of(measured_emission(chart.wavelengths_nm, chart.emission, observer, name=name), observer)
    nearest, told = _MIX_UV, ""
    lit = [k for k in range(len(colours_xyz)) if np.isfinite(colours_xyz[k]).all() and colours_xyz[k, 1] > 0]
    for i, j in itertools.combinations(lit, 2):
        one, other = colours_xyz[i] / colours_xyz[i, 1], colours_xyz[j] / colours_xyz[j, 1]
        along = one - other
        part = float(along @ (xyz / xyz[1] - other) / max(float(along @ along), 1e-12))
        if _MIX_LEAST < part < 1.0 - _MIX_LEAST:
            off = float(np.linalg.norm(_uv(part * one + (1 - part) * other) - _uv(xyz)))
            if off < nearest:
                nearest = off
                told = (
                    f"; light {i} ({part:.0%} of its luminance) and light {j} ({1 - part:.0%}) together have its colour"
                )
    return told


def _uv(xyz: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """CIE 1960 u, v."""
    x, y, z = xyz
    return np.asarray(np.array([4 * x, 6 * y]) / (x + 15 * y + 3 * z))


def _number(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None
