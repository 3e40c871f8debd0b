"""Map → sky, clusters, colour temperatures, light spectra."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from envcal import atomic, exr, provenance
from envcal.config import ClusterSettings, DeclaredLight, parse_wavelengths
from envcal.lights_file import LightRecord, Lights, record, summary
from envcal.maps import Map
from envcal.runner import Outcome
from envcal.spd import read_spd

if TYPE_CHECKING:
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
) -> Outcome:
    """Find the lights of a map; write R, G, B, `cluster` and `sky` to `out` and the lights to `lights_out`.

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
    )
    lights = Lights(
        wavelengths=wavelengths,
        observer=observer_name,
        space=source.space,
        sky=sky.present,
        lights=[record(light) for light in found.lights],
    )
    measured = [light.spd for light in declared if light.spd is not None]
    attributes = {
        **provenance.attributes("cluster", settings=_told(settings, declared), inputs=[source.path, *measured]),
        **provenance.colour_space(source.space),
        "envmap": True,
        "envcalLights": lights.model_dump(mode="json"),
    }
    planes = {**exr.rgb_planes(image), "cluster": clusters.labels, "sky": sky.mask.astype(np.uint32)}
    exr.write(out, planes, attributes=attributes)
    atomic.write_json(lights_out, lights.model_dump(mode="json"))
    figures = {
        "space": source.space,
        "space_said_by": source.said_by,
        "sky": sky.present,
        "lights": [light.model_dump(mode="json", exclude={"emission"}) for light in lights.lights],
    }
    warnings = [*found.warnings, *doubts(image, clusters.labels, lights.lights, declared)]
    return Outcome(summary(lights.lights), figures, warnings)


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
    lost = float(np.isnan(image).any(axis=2).mean())
    if lost > 0:
        texts.append(
            f"{lost:.2%} of the map is lost (clipped in every frame), and lamps are the first to be: the lights found may "
            f"be others than those of the place. Add a shorter exposure to the bracket."
        )
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
    return settings.model_dump(mode="json") | {"lights": lights}


def _declared(light: DeclaredLight, seen: Observer) -> Declared:
    from uplift.illuminants.measured import measured_emission
    from uplift.lights import Declared

    emission = None
    if light.spd is not None:
        emission = measured_emission(*read_spd(light.spd), seen, name=str(light.spd))
    name = light.name or (light.spd.name if light.spd else "")
    return Declared(at=light.at, type=light.type, cct=light.cct, emission=emission, name=name)
