"""From clusters to lights: type, CCT and emission spectrum of each.

What a person declares is taken. Otherwise the outdoor cluster is daylight from 5000 K upwards and a low sun below (Tódová
and Wilkie, EGSR 2024), and an indoor cluster is what `indoor` says. The paper takes every indoor light for an LED; with
`indoor="auto"` it is *unknown* here, and gets a smooth spectrum, half-way (in mired) between that of its CCT and D65, as a
wrong kind of lamp does more harm than a smooth spectrum does: over 195 rooms of one lamp (`benchmarks.lights --only single`) it
has 0.86 times the error of the unconstrained uplift in the geometric mean and 1.11 times at worst.

The probability of each kind of lamp, from sky, CCT and Duv (`illuminants.kinds`), is told with every light and chooses
nothing: over 33 such rooms (`--only single --alternatives --every 6`) spectra blended by those probabilities had 0.84 times the
error in the mean and 2.4 at worst, the spectra taken 0.92 and 1.04, smooth ones of the light's own CCT 0.93 and 1.10.

A CCT that was *measured* beyond the reach of a family is moved to the family's end, with a warning; a CCT that was
*declared* there is refused.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np
import numpy.typing as npt

from uplift import UpliftError
from uplift.cluster import Clusters
from uplift.illuminants import FAMILIES, Family
from uplift.lights.advice import about_tubes, not_like_an_led, with_suggestion
from uplift.lights.declared import called, mistakes_of, placed
from uplift.lights.emission import HALOPHOSPHATE, light_of
from uplift.lights.record import Declared, Light, Lights
from uplift.lights.seen import kinds_of, seen_of
from uplift.spectrum import Observer, RGBSpace

__all__ = ["HALOPHOSPHATE", "INDOOR", "Declared", "Light", "Lights", "lights_of"]

INDOOR = ("auto", "led", "fluorescent", "incandescent")


def lights_of(
    image: npt.NDArray[np.float32],
    clusters: Clusters,
    *,
    indoor: str = "auto",
    declared: Sequence[Declared] = (),
    observer: Observer,
    space: RGBSpace,
    estimator: Literal["lamps", "paper"] = "lamps",
    library: Sequence[tuple[str, npt.NDArray[np.float64]]] = (),
    families: Mapping[str, Family] = FAMILIES,
    calibration: float = 0.0,
) -> Lights:
    """Return type, CCT and emission spectrum of every cluster of a map.

    Parameters
    ----------
    image
        Shape [H, W, 3], float32, linear RGB in `space`: the map the clusters were found in.
    clusters
        What `cluster_angles` returned.
    indoor
        What indoor lights are that nobody declared: "led", "fluorescent", "incandescent", or "auto": unknown.
    declared
        What is known; each applies to the whole cluster at its place.
    estimator
        Of the CCT. "lamps": Ohno's CCT of the lamp where it is seen directly, else of the locally brightest surfaces;
        outdoors of what sky and sun give to a level surface. "paper": McCamy's CCT of the cluster's mean, averaged
        outdoors with that of its brightest pixel.
    library
        Name and emission [N] of spectra that the person owns; a light that has the colour of one is told so.
    families
        The spectra of the types; others than the package's own have the same keys.
    calibration
        Relative standard deviation of any CCT from the camera's calibration; 0 if it is not known.

    Raises
    ------
    UpliftError
        All mistakes in `indoor`, `declared` and `estimator` at once.
    """
    mistakes = [] if indoor in INDOOR else [f"indoor: {indoor!r}; expected one of {', '.join(INDOOR)}"]
    if estimator not in ("lamps", "paper"):
        mistakes.append(f'estimator: {estimator!r}; expected "lamps" or "paper"')
    if image.shape[:2] != clusters.labels.shape:
        mistakes.append(
            f"image of {image.shape[:2]} and labels of {clusters.labels.shape}; expected those of the same map"
        )
    for number, one in enumerate(declared):
        mistakes += [f"{called(one, number)}: {text}" for text in mistakes_of(one, observer)]
    if mistakes:
        raise UpliftError("\n".join(mistakes))
    known, warnings = placed(image, clusters, declared, space)
    lights = []
    for cluster in range(clusters.count):
        seen = seen_of(clusters, cluster, space, estimator, calibration)
        kinds = kinds_of(seen, bool(clusters.outdoor[cluster]), observer)
        light, more = light_of(
            clusters,
            cluster,
            known.get(cluster),
            seen,
            kinds,
            indoor=indoor,
            estimator=estimator,
            observer=observer,
            families=families,
        )
        lights.append(light)
        warnings += more
        warnings += not_like_an_led(light, known.get(cluster))
    warnings += about_tubes(lights, known)
    lights = [with_suggestion(light, library, observer) for light in lights]
    return Lights(tuple(lights), (*clusters.warnings, *warnings))
