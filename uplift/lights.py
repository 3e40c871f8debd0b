"""From clusters to lights: type, CCT and emission spectrum of each.

What a person declares is taken. Otherwise the outdoor cluster is daylight from 5000 K upwards and a low sun below (Tódová
and Wilkie, EGSR 2024), and an indoor cluster is what `indoor` says. The paper takes every indoor light for an LED; with
`indoor="auto"` it is *unknown* here, and gets the smooth spectrum of its CCT, as a wrong kind of lamp does more harm than a
smooth spectrum does: 1.02 times the error of the unconstrained uplift in the mean and 6.85 times at worst with LEDs,
0.95 and 1.21 with smooth spectra, over 28 lamps in two rooms.

The probability of each kind of lamp, from sky, CCT and Duv (`illuminants.kinds`), is told with every light and chooses
nothing: over 99 rooms of one lamp (`benchmarks.lights`), spectra blended by those probabilities had 0.93 times the error of
the unconstrained uplift in the mean and 2.9 at worst, smooth spectra of the light's CCT 0.88 and 1.15. Half-way between that CCT
and D65 (in mired) harms least: over 17 awkward lamps in three rooms 0.90 and 1.07, against 0.91 and 1.26 at the CCT itself.

A CCT that was *measured* beyond the reach of a family is moved to the family's end, with a warning; a CCT that was
*declared* there is refused.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from uplift import UpliftError
from uplift.cct import MAX_DUV, cct_duv, mccamy, nearest_cct, xy_of_rgb
from uplift.cluster import Clusters
from uplift.illuminants import FAMILIES, Family, cct_duv_of
from uplift.illuminants.fluorescent import NAMES as FLUORESCENT_NAMES
from uplift.illuminants.kinds import KINDS, kind_probabilities
from uplift.illuminants.led import NAMES as LED_NAMES
from uplift.spectrum import Observer, RGBSpace, checked_emission, illuminant, normalised

Floats = npt.NDArray[np.float64]

INDOOR = ("auto", "led", "fluorescent", "incandescent")
DISCHARGE_NAMES = tuple(f"HP{i}" for i in range(1, 6))
NAMED_TYPES = (
    dict.fromkeys(FLUORESCENT_NAMES, "fluorescent")
    | dict.fromkeys(LED_NAMES, "led")
    | dict.fromkeys(DISCHARGE_NAMES, "discharge")
)
DAYLIGHT_FROM_K = 5000.0
TOWARDS_D65 = 0.5  # how far an unknown light's smooth spectrum is moved to D65, in mired; see above
PLACE_RADIUS = 1.0 / 360.0  # of the width: what "at (u, v)" takes in

TUBE_REMEDY = (
    "name the tube: type FL12, FL11 or FL10 for a three-band one of 3000, 4000 or 5000 K (marked 830, 840, 850), FL7 to FL9 or "
    "FL3.12 to FL3.14 for a broad-band one of high colour rendering; or photograph the chart in its light"
)

# How sure: a ranking for people, no probability. Multiplied where several apply.
SURE_SPECTRUM, SURE_TYPE_AND_CCT, SURE_TYPE = 1.0, 0.95, 0.9
SURE_OUTDOOR, SURE_INDOOR_SETTING, SURE_UNKNOWN = 0.8, 0.7, 0.3
BY_SURFACES, OFF_LOCUS, OUT_OF_REACH = 0.7, 0.5, 0.7
# Relative error of the CCT besides the spread of its evidence. Direct: over 90 lamps in relit rooms the median was 0.2 %,
# 80 % were within 1.1 % and 90 % within 4.6 % (windows that mirror another lamp). Outdoors: 2.3 % at most in three skies.
# Surfaces: up to 15 % where they are coloured at random.
CCT_ERROR_DIRECT, CCT_ERROR_SURFACES, CCT_ERROR_OUTDOOR = 0.02, 0.10, 0.05
DUV_ERROR_DIRECT, DUV_ERROR_SURFACES = 0.001, 0.010
SKY_SAYS_DAYLIGHT = 100.0  # how much likelier daylight is than any other kind where there is a sky, before any colour
# What a light that is only said to be fluorescent has of the halophosphate spectrum, the rest being smooth. Relight error over
# that of the unconstrained uplift, three rooms, for 1, 0.9, 0.8, 0.7: FL1-FL6 0.26, 0.20, 0.23, 0.30; FL11 2.07, 1.85, 1.65, 1.48.
HALOPHOSPHATE = 0.8
LED_DUV = 0.004  # phosphor LEDs of the CIE and nearly all others are nearer than this to the family's locus
SAME_MIRED, SAME_DUV = 20.0, 0.006  # so near a spectrum must be to a light's colour to be taken for its own


@dataclass(frozen=True, slots=True, eq=False)
class Light:
    """One light of the map, and its spectrum."""

    cluster: int
    type: str  # daylight, sunset, led, fluorescent, incandescent, discharge, measured, smooth (unknown)
    cct: float  # K, of the emission
    duv: float  # of the emission
    emission: Floats  # [N] on the observer's grid, Y = 1
    source: str  # how the spectrum was got
    confidence: float  # 0…1, a ranking
    share: float  # of luminance · solid angle of the map
    at: tuple[float, float]  # (u, v) of its brightest region
    declared: bool
    remedy: str  # what a person could do to make it surer; "" where nothing is needed
    cct_seen: float = float("nan")  # K, of the colour in the map; the nearest of the locus, if that is far
    duv_seen: float = float("nan")
    cct_sigma: float = float("nan")  # K, of cct_seen
    outdoor: bool = False
    name: str = ""
    duv_sigma: float = float("nan")  # of duv_seen
    kinds: Mapping[str, float] = field(default_factory=dict)  # kind of lamp → probability; sums to 1


@dataclass(frozen=True, slots=True, eq=False)
class Declared:
    """What a person knows of the light at a place of the map; None is "not known"."""

    at: tuple[float, float]  # (u, v), 0…1 from the top left of the map
    type: str | None = None  # a family, or a CIE lamp by name (FL11, LED-V2, HP1)
    cct: float | None = None
    emission: npt.NDArray[np.float64] | None = None  # [N] on the observer's grid
    name: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Lights:
    """The lights of a map, one a cluster and in its order, and what a person should be told."""

    lights: tuple[Light, ...]
    warnings: tuple[str, ...]

    def __iter__(self) -> Iterator[Light]:
        return iter(self.lights)

    def __len__(self) -> int:
        return len(self.lights)

    def __getitem__(self, cluster: int) -> Light:
        return self.lights[cluster]


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
        mistakes += [f"{_called(one, number)}: {text}" for text in _mistakes(one, observer)]
    if mistakes:
        raise UpliftError("\n".join(mistakes))
    known, warnings = _placed(image, clusters, declared, space)
    lights = []
    for cluster in range(clusters.count):
        seen = _seen(clusters, cluster, space, estimator, calibration)
        kinds = _kinds(seen, bool(clusters.outdoor[cluster]), observer)
        light, more = _light(
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
        warnings += _not_like_an_led(light, known.get(cluster))
    tubes = [light for light in lights if _is_any_tube(light, known.get(light.cluster))]
    if tubes:
        warnings.append(
            f"light{'s' if len(tubes) > 1 else ''} {', '.join(str(light.cluster) for light in tubes)}: `fluorescent` has the "
            f"spectrum of halophosphate tubes (FL1 to FL6). For a three-band tube or a compact lamp it is some 2.5 times as wrong "
            f"as no declaration, and colours do not tell which it is. {TUBE_REMEDY[0].upper()}{TUBE_REMEDY[1:]}"
        )
    lights = [_with_suggestion(light, library, observer) for light in lights]
    return Lights(tuple(lights), (*clusters.warnings, *warnings))


# ---- what was declared ----


def _called(declared: Declared, number: int) -> str:
    return f"declared light {number + 1}" + (f" ({declared.name})" if declared.name else "")


def _mistakes(declared: Declared, observer: Observer) -> list[str]:
    """What is wrong with a declaration, as far as it can be told without the map."""
    found = []
    if not all(0.0 <= value <= 1.0 for value in declared.at):
        found.append(f"at {tuple(declared.at)}; expected u and v from 0 to 1, from the top left of the map")
    if declared.type is None and declared.cct is None and declared.emission is None:
        found.append("says nothing; give a type, a cct or a measured spectrum, or remove it")
    if declared.emission is not None:
        if declared.type not in (None, "measured") or declared.cct is not None:
            found.append("has a measured spectrum and a type or cct besides; a spectrum says it all, remove the others")
        try:
            checked_emission(declared.emission, observer, place="measured spectrum")
        except UpliftError as error:
            found.append(str(error))
        return found
    if declared.type == "measured":
        found.append("type measured without a spectrum; give one, or another type")
    elif declared.type in NAMED_TYPES:
        if declared.cct is not None:
            found.append(f"{declared.type} is one lamp with a cct of its own; remove cct, or name the type only")
    elif declared.type is not None and declared.type not in FAMILIES:
        found.append(
            f"type {declared.type!r} is unknown; expected one of {', '.join(FAMILIES)}, measured, or a lamp by name "
            "such as FL11, LED-V2, HP1"
        )
    elif declared.cct is not None:
        family = FAMILIES[declared.type or "smooth"]
        if not family.low_k <= declared.cct <= family.high_k:
            found.append(
                f"cct {declared.cct:g} K; expected {family.low_k:g} to {family.high_k:g} K for "
                f"{declared.type or 'a light of unknown type'}. Correct it, or give a measured spectrum"
            )
    return found


def _placed(
    image: npt.NDArray[np.float32], clusters: Clusters, declared: Sequence[Declared], space: RGBSpace
) -> tuple[dict[int, Declared], list[str]]:
    """Which declaration each cluster has: that of the light most present within 1 degree of its place."""
    height, width = clusters.labels.shape
    known: dict[int, Declared] = {}
    warnings = []
    for number, one in enumerate(declared):
        x, y = min(int(one.at[0] * width), width - 1), min(int(one.at[1] * height), height - 1)
        reach = max(0, round(PLACE_RADIUS * width))
        columns = np.arange(x - reach, x + reach + 1) % width
        rows = np.arange(max(y - reach, 0), min(y + reach, height - 1) + 1)
        around = np.ix_(rows, columns)
        light = image[around].astype(np.float64) @ space.luminance_weights
        light = np.where(np.isfinite(light), np.maximum(light, 0.0), 0.0)
        if light.max() <= 0:
            raise UpliftError(
                f"{_called(one, number)}: the map is black or empty at {tuple(one.at)}; point to the lamp or to what it lights"
            )
        votes = np.bincount(clusters.labels[around].ravel().astype(np.int64), light.ravel(), clusters.count)
        cluster = int(np.argmax(votes))
        if cluster in known:
            warnings.append(
                f"{_called(one, number)} is in the same cluster ({cluster}) as another declared light, which is used; the "
                "two lights have too similar colours to be told apart"
            )
        else:
            known[cluster] = one
    return known, warnings


# ---- one light ----


def _light(
    clusters: Clusters,
    cluster: int,
    declared: Declared | None,
    colour: Seen,
    kinds: Mapping[str, float],
    *,
    indoor: str,
    estimator: str,
    observer: Observer,
    families: Mapping[str, Family],
) -> tuple[Light, list[str]]:
    outdoor = bool(clusters.outdoor[cluster])
    seen, duv = colour.cct, colour.duv
    warnings: list[str] = []
    confidence = 1.0 if colour.trusted else BY_SURFACES
    wanted = seen
    if not np.isfinite(seen):
        wanted = cct_duv_of(illuminant("D65", observer), observer)[0]
        confidence = 0.0
    elif abs(duv) > MAX_DUV:
        confidence *= OFF_LOCUS
        warnings.append(
            f"light {cluster}: its colour is {abs(duv):.3f} from white light in (u, v); {seen:.0f} K is only the nearest "
            "colour temperature. Give its measured spectrum"
        )
    if declared is not None and declared.cct is not None:
        wanted = declared.cct
    if declared is None and estimator == "lamps" and np.isfinite(colour.sun) and np.isfinite(seen):
        # What the sun lights has its spectrum, what it does not the sky's: the paper's mean of both serves either. Under a sun
        # 2 degrees high it brought the error from 1.18 to 1.0 times that of the best single CCT.
        wanted = (seen + colour.sun) / 2.0
    kind = _kind(declared, indoor, outdoor, wanted)
    if declared is None and kind == "smooth":
        neutral = cct_duv_of(illuminant("D65", observer), observer)[0]
        wanted = 1.0 / ((1.0 - TOWARDS_D65) / wanted + TOWARDS_D65 / neutral)

    name = (declared.type or "") if declared is not None else ""
    if declared is not None and declared.emission is not None:
        emission, source = normalised(declared.emission, observer), "measured spectrum, declared"
        confidence = SURE_SPECTRUM
    elif name in NAMED_TYPES:
        emission, source = illuminant(name, observer), f"CIE {name}, declared"
        confidence = SURE_SPECTRUM
    else:
        family = families[kind]
        reached = float(np.clip(wanted, family.low_k, family.high_k))
        if reached != wanted:
            confidence *= OUT_OF_REACH
            warnings.append(
                f"light {cluster}: {wanted:.0f} K is beyond {kind} ({family.low_k:g} to {family.high_k:g} K); the spectrum of "
                f"{reached:g} K is used. Declare another type, or a measured spectrum"
            )
        emission, source = family.emission(reached, observer), family.source
        if kind == "fluorescent":
            # both parts have the CCT, so the mix has it too
            even = families["smooth"].emission(reached, observer)
            emission = normalised(HALOPHOSPHATE * emission + (1.0 - HALOPHOSPHATE) * even, observer)
            source += f"; {1.0 - HALOPHOSPHATE:.0%} of it smooth, as the tube may be of another kind"
        if declared is None and kind == "smooth":
            source += "; half-way from the colour seen to D65, where a wrong guess harms least"
        confidence *= _sure(declared, kind, outdoor)
    cct, duv_of_emission = cct_duv_of(emission, observer)
    at = (float(clusters.at[cluster, 0]), float(clusters.at[cluster, 1]))
    return Light(
        cluster=cluster,
        type=kind,
        cct=cct,
        duv=duv_of_emission,
        emission=emission,
        source=source,
        confidence=float(confidence),
        share=float(clusters.share[cluster]),
        at=at,
        declared=declared is not None,
        remedy=_remedy(declared, kind, outdoor, at, indoor),
        cct_seen=seen,
        duv_seen=duv,
        cct_sigma=colour.cct_sigma,
        duv_sigma=colour.duv_sigma,
        kinds=kinds if declared is None or kind not in KINDS else {one: float(one == kind) for one in KINDS},
        outdoor=outdoor,
        name=declared.name if declared is not None else "",
    ), warnings


def _is_any_tube(light: Light, declared: Declared | None) -> bool:
    """Whether a light is fluorescent, of a tube that nobody named."""
    return light.type == "fluorescent" and (declared is None or declared.type not in NAMED_TYPES)


def _not_like_an_led(light: Light, declared: Declared | None) -> list[str]:
    """A warning if a light that is said to be an LED, of no name, has no colour of white phosphor LEDs."""
    if light.type != "led" or (declared is not None and declared.type in NAMED_TYPES):
        return []
    off = light.duv_seen - light.duv
    if not abs(off) > max(LED_DUV, 2.0 * light.duv_sigma):
        return []
    return [
        f"light {light.cluster}: said to be an LED, but its colour is {abs(off):.4f} (Duv) to the {'green' if off > 0 else 'pink'} "
        f"side of white phosphor LEDs of {light.cct:.0f} K; it may be made of coloured LEDs or be another lamp, and the spectrum "
        "taken may do harm. Declare LED-RGB1 or its measured spectrum, leave the type away, or photograph the chart in its light"
    ]


@dataclass(frozen=True, slots=True)
class Seen:
    """A light's colour in the map; NaN for a black cluster."""

    cct: float  # K
    duv: float
    cct_sigma: float  # K
    duv_sigma: float
    sun: float  # K, of the brightest place of an outdoor light; NaN otherwise
    trusted: bool  # seen directly, or outdoors; not told by surfaces


def _seen(clusters: Clusters, cluster: int, space: RGBSpace, estimator: str, calibration: float) -> Seen:
    outdoor, direct = bool(clusters.outdoor[cluster]), bool(clusters.direct[cluster])
    if estimator == "paper":
        mean = xy_of_rgb(clusters.means[cluster], space.xyz_from_rgb)
        cct = float(mccamy(mean))
        if outdoor:
            cct = (cct + float(mccamy(xy_of_rgb(clusters.brightest[cluster], space.xyz_from_rgb)))) / 2.0
        duv = nearest_cct(mean)[1]
    else:
        cct, duv = nearest_cct(xy_of_rgb(clusters.lamps[cluster], space.xyz_from_rgb))
    sun = float("nan")
    if outdoor:
        sun = float(cct_duv(xy_of_rgb(clusters.brightest[cluster], space.xyz_from_rgb))[0])
    spread = float(clusters.spread_mired[cluster])
    error = CCT_ERROR_DIRECT if direct else CCT_ERROR_SURFACES
    of_spread = 0.0 if not np.isfinite(spread) else spread * cct**2 / 1e6
    across = float(clusters.spread_duv[cluster])
    across = 0.0 if not np.isfinite(across) else across
    if outdoor:  # a sky's many colours are no uncertainty of what it gives to a level surface
        error, of_spread, across = CCT_ERROR_OUTDOOR, 0.0, 0.0
    sigma = float(np.sqrt((error * cct) ** 2 + of_spread**2 + (calibration * cct) ** 2))
    duv_sigma = float(np.hypot(DUV_ERROR_DIRECT if direct or outdoor else DUV_ERROR_SURFACES, across))
    return Seen(cct, duv, sigma, duv_sigma, sun, direct or outdoor or estimator == "paper")


def _kinds(seen: Seen, outdoor: bool, observer: Observer) -> dict[str, float]:
    """Probability of each kind, from the sky and the colour."""
    spread = seen.cct_sigma / seen.cct**2 * 1e6 if np.isfinite(seen.cct) else 0.0
    found = kind_probabilities(seen.cct, seen.duv, observer, sigma_mired=spread, sigma_duv=seen.duv_sigma)
    if outdoor:
        found = {kind: p * (SKY_SAYS_DAYLIGHT if kind == "daylight" else 1.0) for kind, p in found.items()}
    total = sum(found.values())
    return {kind: p / total for kind, p in found.items()}


# ---- the library ----


def _apart(light: Light, emission: Floats, observer: Observer) -> float:
    """How far a spectrum's colour is from a light's, in units of what is still the same."""
    cct, duv = cct_duv_of(emission, observer)
    if not (np.isfinite(cct) and np.isfinite(light.cct_seen)):
        return float("inf")
    along = abs(1e6 / cct - 1e6 / light.cct_seen) / SAME_MIRED
    return float(np.hypot(along, abs(duv - light.duv_seen) / SAME_DUV))


def _with_suggestion(light: Light, library: Sequence[tuple[str, Floats]], observer: Observer) -> Light:
    """The light, with the spectrum of the library that has its colour named in the remedy, where nothing is known of it."""
    if light.declared or not library:
        return light
    apart = [_apart(light, emission, observer) for _, emission in library]
    nearest = int(np.argmin(apart))
    if not apart[nearest] <= 1.0:
        return light
    place = f"at: [{light.at[0]:.3f}, {light.at[1]:.3f}]"
    more = f"it has the colour of {library[nearest][0]} of your library: if it is that lamp, declare {{{place}, spd: {library[nearest][0]}}}"
    return replace(light, remedy="; ".join(part for part in (light.remedy, more) if part))


def _kind(declared: Declared | None, indoor: str, outdoor: bool, cct: float) -> str:
    if declared is not None:
        if declared.emission is not None:
            return "measured"
        if declared.type is not None:
            return NAMED_TYPES.get(declared.type, declared.type)
    if outdoor:
        return "daylight" if cct >= DAYLIGHT_FROM_K else "sunset"
    return "smooth" if indoor == "auto" else indoor


def _sure(declared: Declared | None, kind: str, outdoor: bool) -> float:
    if declared is not None and declared.type is not None:
        return SURE_TYPE_AND_CCT if declared.cct is not None else SURE_TYPE
    if outdoor:
        return SURE_OUTDOOR
    return SURE_UNKNOWN if kind == "smooth" else SURE_INDOOR_SETTING


def _remedy(declared: Declared | None, kind: str, outdoor: bool, at: tuple[float, float], indoor: str) -> str:
    place = f"at: [{at[0]:.3f}, {at[1]:.3f}]"
    if kind == "fluorescent" and (declared is None or declared.type == kind):
        taken = "" if declared is not None else f"taken for fluorescent as all indoor lights; at {place[4:]}, "
        return taken + TUBE_REMEDY
    if declared is not None and (declared.emission is not None or declared.type is not None):
        return ""
    if outdoor:
        return "" if declared is not None else f"if this is no daylight, declare {{{place}, type: …}}"
    if indoor == "auto" or declared is not None:
        return f"declare {{{place}, type: led | fluorescent | incandescent | FL11 | …}}, or its measured spectrum (spd)"
    return f"taken for {indoor} as all indoor lights; if it is not, declare {{{place}, type: …}}"
