"""Map → sky, clusters, colour temperatures, light spectra."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from envcal import atomic, exr, provenance
from envcal.config import ClusterSettings, DeclaredLight, parse_wavelengths
from envcal.lights_file import Lights, record, summary
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
    return Outcome(summary(lights.lights), figures, found.warnings)


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
