"""Map → sky, clusters, colour temperatures, light spectra."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from envcal import atomic, exr, provenance
from envcal.config import ClusterSettings, DeclaredLight, parse_wavelengths
from envcal.errors import EnvcalError
from envcal.lights_file import LightRecord, Lights, record, summary
from envcal.maps import Map, lost_told
from envcal.runner import Outcome
from envcal.spd import in_library, read_spd
from envcal.steps import chart_light

if TYPE_CHECKING:
    from envcal.profile import Profile
    from uplift.illuminants import Family
    from uplift.lights import Declared
    from uplift.spectrum import Observer


def cluster(
    source: Map,
    out: Path,
    lights_out: Path,
    settings: ClusterSettings,
    *,
    declared: Sequence[DeclaredLight],
    wavelengths: str,
    observer_name: str,
    calibration: float = 0.0,
    profiles: Mapping[str, Profile] | None = None,
    tell_lost: bool = True,
) -> Outcome:
    """Find the lights of a map; write it, its `cluster`s and the `sky` to `out` and the lights to `lights_out`.

    `profiles` are those of chart shots in this place, by name: a light of a chart's colour gets the spectrum measured there.
    `calibration` is the relative standard deviation that the camera's calibration gives to any CCT (`calibration_error`).
    `tell_lost` False leaves the pixels that are NaN or infinite in the file to the uplift that follows, which tells them too.

    The lights also stand in the header of `out`, so that one file carries all that the uplift needs.
    """
    from uplift.cluster import cluster_angles
    from uplift.lights import lights_of
    from uplift.sky import find_sky
    from uplift.spectrum import observer, rgb_space

    seen = observer(*parse_wavelengths(wavelengths), name=observer_name)
    space = rgb_space(source.space, observer=seen)
    image = source.image
    sky = find_sky(image, space.luminance_weights)
    clusters = cluster_angles(
        image,
        luminance_weights=space.luminance_weights,
        xyz_from_rgb=space.xyz_from_rgb,
        sky=sky,
        k_max=settings.most,
        evidence="bright" if settings.estimator == "paper" else "lamps",
    )
    found = lights_of(
        image,
        clusters,
        indoor=settings.indoor,
        declared=[_declared(light, seen) for light in declared],
        observer=seen,
        space=space,
        estimator=settings.estimator,
        library=_library(settings.library, seen),
        families=_families(settings.sky_model),
        calibration=calibration,
    )
    charts = {name: one.light for name, one in (profiles or {}).items() if one.light is not None}
    if settings.chart_spectrum == "off":
        charts = {}
    colours = clusters.lamps @ space.xyz_from_rgb.T
    emitting, chart_warnings = chart_light.given(found.lights, colours, charts, seen)
    lights = Lights(
        wavelengths=wavelengths,
        observer=observer_name,
        space=source.space,
        sky=sky.present,
        lights=[record(light) for light in emitting],
    )
    planes = {
        **exr.rgb_planes(image),
        "cluster": clusters.labels,
        "second": clusters.second,
        "weight": clusters.weight,
        "sky": sky.mask.astype(np.uint32),
    }
    exr.write(out, planes, attributes=_attributes(source, settings, declared, lights))
    atomic.write_json(lights_out, lights.model_dump(mode="json"))
    figures = {"space": source.space, "space_said_by": source.said_by, **lights_figures(lights)}
    lost = lost_told(source) if tell_lost or source.photographed else None
    told = [] if lost is None else [lost]
    warnings = [*found.warnings, *chart_warnings, *told, *doubts(image, clusters.labels, lights.lights, declared)]
    return Outcome(summary(lights.lights), figures, warnings)


def _attributes(
    source: Map, settings: ClusterSettings, declared: Sequence[DeclaredLight], lights: Lights
) -> dict[str, Any]:
    """What the header says: where the file is from, spectra of the user's own among it, and the lights."""
    measured = [light.spd for light in declared if light.spd is not None]
    measured += [] if settings.library is None else in_library(settings.library)
    measured += [] if settings.sky_model is None else [settings.sky_model]
    inputs = [source.path, *measured]
    return {
        **provenance.attributes("cluster", settings=_told(settings, declared), inputs=inputs, unit=source.unit),
        **provenance.colour_space(source.space),
        "envmap": True,
        "envcalLights": lights.model_dump(mode="json"),
    }


def lights_figures(lights: Lights) -> dict[str, Any]:
    """What is told of the lights in figures: all but their spectra."""
    return {"sky": lights.sky, "lights": [one.model_dump(mode="json", exclude={"emission"}) for one in lights.lights]}


#: A declared spectrum this far from the colour seen bends the spectra of what it lights by tens of per cent.
_FAR_DUV = 0.005
_FAR_MIRED = 20.0
#: A declaration this far from the lamp, at a place this much darker, was meant for the place rather than the lamp.
_FAR_DEGREES = 15.0
_MUCH_DARKER = 0.1


def doubts(
    image: npt.NDArray[np.float32],
    labels: npt.NDArray[np.uint32],
    lights: Sequence[LightRecord],
    declared: Sequence[DeclaredLight],
) -> list[str]:
    """Return warnings about lights that may not be what a person takes them for."""
    texts = []
    for light in lights:
        if not light.declared or light.cct is None or light.cct_seen is None:
            continue
        duv = abs((light.duv or 0.0) - (light.duv_seen or 0.0))
        if duv > _FAR_DUV or abs(1e6 / light.cct - 1e6 / light.cct_seen) > _FAR_MIRED:
            texts.append(
                f"light {light.cluster} ({light.name or light.type}): the map shows {light.cct_seen:.0f} K, Duv "
                f"{light.duv_seen or 0.0:+.4f}, its spectrum has {light.cct:.0f} K, Duv {light.duv or 0.0:+.4f}. Colours are "
                f"kept, so the spectra of what it lights are bent by the difference, most at the ends. Either the "
                f"declaration is wrong, or the chart did not stand in this light."
            )
    height, width = labels.shape
    for one in declared:
        row, column = min(int(one.at[1] * height), height - 1), min(int(one.at[0] * width), width - 1)
        light = lights[int(labels[row, column])]
        there = min(int(light.at[1] * height), height - 1), min(int(light.at[0] * width), width - 1)
        darker = np.nansum(image[row, column]) < _MUCH_DARKER * np.nansum(image[there])
        if darker and _degrees(one.at, light.at) > _FAR_DEGREES:
            texts.append(
                f"the light declared at {list(one.at)} is taken for light {light.cluster}, whose lamp is seen at "
                f"[{light.at[0]:.3f}, {light.at[1]:.3f}], and holds wherever that light does. A declaration says what a lamp "
                f"is; it does not move a surface from one light to another."
            )
    return texts


def _degrees(one: tuple[float, float], other: tuple[float, float]) -> float:
    """Angle between two places (u, v) of a lat-long map."""
    across = 2 * np.pi * (one[0] - other[0])
    a, b = np.pi * one[1], np.pi * other[1]
    cosine = np.cos(a) * np.cos(b) + np.sin(a) * np.sin(b) * np.cos(across)
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _told(settings: ClusterSettings, declared: Sequence[DeclaredLight]) -> dict[str, Any]:
    """The settings with the lights that were declared, files by name only: a path would differ between machines."""
    lights = [light.model_dump(mode="json") | {"spd": light.spd and light.spd.name} for light in declared]
    owned = {name: getattr(settings, name) and getattr(settings, name).name for name in ("library", "sky_model")}
    return settings.model_dump(mode="json") | {"lights": lights} | owned


def _library(folder: Path | None, seen: Observer) -> list[tuple[str, npt.NDArray[np.float64]]]:
    from uplift.illuminants.measured import measured_emission

    if folder is None:
        return []
    return [(path.name, measured_emission(*read_spd(path), seen, name=str(path))) for path in in_library(folder)]


def _families(sky_model: Path | None) -> Mapping[str, Family]:
    """The package's families, sunsets being those of the Prague sky model where its data are at hand."""
    from uplift.illuminants import FAMILIES, with_sky_model

    if sky_model is None:
        return FAMILIES
    try:
        data = np.memmap(sky_model, np.uint8, "r")
    except (OSError, ValueError) as error:
        raise EnvcalError(f"{sky_model}: cannot be read ({error}). Correct `cluster.sky_model`.") from error
    return with_sky_model(data, place=str(sky_model))


#: Relative error of the CCT that von Kries adaptation to the lamp leaves, mean over 51 cameras and five lights (CAT16).
_ADAPTATION_ERROR = 0.026


def calibration_error(profile: Profile) -> float:
    """Return the relative standard deviation of a CCT from a camera's profile: its neutral patches, and the adaptation."""
    from uplift.cct import cct_duv, xy_of_rgb
    from uplift.spectrum import rgb_space

    neutral = [
        p for p in profile.chart.patches if max(p.target_rgb) < 1.25 * min(p.target_rgb) and min(p.target_rgb) > 0
    ]
    fitted = np.array([p.fitted_rgb for p in neutral]).reshape(-1, 3)
    matrix = rgb_space(profile.working_space).xyz_from_rgb
    seen = cct_duv(xy_of_rgb(fitted, matrix))[0]
    wanted = cct_duv(xy_of_rgb(np.array([p.target_rgb for p in neutral]).reshape(-1, 3), matrix))[0]
    off = (seen / wanted - 1.0)[np.isfinite(seen) & np.isfinite(wanted)]
    of_patches = float(np.sqrt(np.mean(off**2))) if off.size else 0.0
    return float(np.hypot(of_patches, _ADAPTATION_ERROR))


def _declared(light: DeclaredLight, seen: Observer) -> Declared:
    from uplift.illuminants.measured import measured_emission
    from uplift.lights import Declared

    emission = None
    if light.spd is not None:
        emission = measured_emission(*read_spd(light.spd), seen, name=str(light.spd))
    name = light.name or (light.spd.name if light.spd else "")
    return Declared(at=light.at, type=light.type, cct=light.cct, emission=emission, name=name)
