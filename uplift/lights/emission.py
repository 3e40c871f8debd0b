"""The type and the emission spectrum of one light, from what is declared of it and what is seen."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from uplift.cct import MAX_DUV
from uplift.cluster import Clusters
from uplift.illuminants import Family, cct_duv_of
from uplift.illuminants.kinds import KINDS
from uplift.lights.advice import remedy_of
from uplift.lights.declared import NAMED_TYPES
from uplift.lights.record import Declared, Light
from uplift.lights.seen import Seen
from uplift.spectrum import Observer, illuminant, normalised

DAYLIGHT_FROM_K = 5000.0
# how far an unknown light's smooth spectrum is moved to D65, in mired; see `uplift.lights`
TOWARDS_D65 = 0.5
# How sure: a ranking for people, no probability. Multiplied where several apply.
SURE_SPECTRUM, SURE_TYPE_AND_CCT, SURE_TYPE = 1.0, 0.95, 0.9
SURE_OUTDOOR, SURE_INDOOR_SETTING, SURE_UNKNOWN = 0.8, 0.7, 0.3
BY_SURFACES, OFF_LOCUS, OUT_OF_REACH = 0.7, 0.5, 0.7
# What a light that is only said to be fluorescent has of the halophosphate spectrum, the rest being smooth. Relight error over
# that of the unconstrained uplift, three rooms, for 1, 0.9, 0.8, 0.7: FL1-FL6 0.26, 0.20, 0.23, 0.30; FL11 2.07, 1.85, 1.65, 1.48.
HALOPHOSPHATE = 0.8


def light_of(
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
    """Return the light of a cluster, and warnings; `kinds` are the probabilities its colour gives."""
    outdoor = bool(clusters.outdoor[cluster])
    warnings: list[str] = []
    confidence = 1.0 if colour.trusted else BY_SURFACES
    if not np.isfinite(colour.cct):
        confidence = 0.0
    elif abs(colour.duv) > MAX_DUV:
        confidence *= OFF_LOCUS
        warnings.append(
            f"light {cluster}: its colour is {abs(colour.duv):.3f} from white light in (u, v); {colour.cct:.0f} K is only the "
            "nearest colour temperature. Give its measured spectrum"
        )
    kind, wanted = _kind_and_cct(declared, colour, indoor, outdoor, estimator, observer)
    if declared is not None and declared.emission is not None:
        emission, source = normalised(declared.emission, observer), "measured spectrum, declared"
        confidence = SURE_SPECTRUM
    elif declared is not None and declared.type in NAMED_TYPES:
        emission, source = illuminant(declared.type, observer), f"CIE {declared.type}, declared"
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
        emission, source = _of_family(kind, reached, families, observer)
        if declared is None and kind == "smooth":
            source += "; half-way from the colour seen to D65, where a wrong guess harms least"
        confidence *= _sure(declared, kind, outdoor)
    cct, duv = cct_duv_of(emission, observer)
    at = (float(clusters.at[cluster, 0]), float(clusters.at[cluster, 1]))
    return Light(
        cluster=cluster,
        type=kind,
        cct=cct,
        duv=duv,
        emission=emission,
        source=source,
        confidence=float(confidence),
        share=float(clusters.share[cluster]),
        at=at,
        declared=declared is not None,
        remedy=remedy_of(declared, kind, outdoor, at, indoor),
        cct_seen=colour.cct,
        duv_seen=colour.duv,
        cct_sigma=colour.cct_sigma,
        duv_sigma=colour.duv_sigma,
        kinds=kinds if declared is None or kind not in KINDS else {one: float(one == kind) for one in KINDS},
        outdoor=outdoor,
        name=declared.name if declared is not None else "",
    ), warnings


def _of_family(
    kind: str, cct: float, families: Mapping[str, Family], observer: Observer
) -> tuple[npt.NDArray[np.float64], str]:
    """The emission [N] of a kind of lamp at a CCT, and where it comes from."""
    family = families[kind]
    emission, source = family.emission(cct, observer), family.source
    if kind == "fluorescent":
        # both parts have the CCT, so the mix has it too
        even = families["smooth"].emission(cct, observer)
        emission = normalised(HALOPHOSPHATE * emission + (1.0 - HALOPHOSPHATE) * even, observer)
        source += f"; {1.0 - HALOPHOSPHATE:.0%} of it smooth, as the tube may be of another kind"
    return emission, source


def _kind_and_cct(
    declared: Declared | None, colour: Seen, indoor: str, outdoor: bool, estimator: str, observer: Observer
) -> tuple[str, float]:
    """The type of a light, and the CCT (K) that its spectrum is to have."""
    neutral = cct_duv_of(illuminant("D65", observer), observer)[0]
    wanted = colour.cct if np.isfinite(colour.cct) else neutral
    if declared is not None:
        return _declared_kind(declared, indoor, outdoor, wanted), declared.cct if declared.cct is not None else wanted
    if estimator == "lamps" and np.isfinite(colour.sun) and np.isfinite(colour.cct):
        # What the sun lights has its spectrum, what it does not the sky's: the paper's mean of both serves either.
        wanted = (colour.cct + colour.sun) / 2.0
    kind = _undeclared_kind(indoor, outdoor, wanted)
    if kind == "smooth":
        wanted = 1.0 / ((1.0 - TOWARDS_D65) / wanted + TOWARDS_D65 / neutral)
    return kind, wanted


def _declared_kind(declared: Declared, indoor: str, outdoor: bool, cct: float) -> str:
    if declared.emission is not None:
        return "measured"
    if declared.type is not None:
        return NAMED_TYPES.get(declared.type, declared.type)
    return _undeclared_kind(indoor, outdoor, declared.cct if declared.cct is not None else cct)


def _undeclared_kind(indoor: str, outdoor: bool, cct: float) -> str:
    if outdoor:
        return "daylight" if cct >= DAYLIGHT_FROM_K else "sunset"
    return "smooth" if indoor == "auto" else indoor


def _sure(declared: Declared | None, kind: str, outdoor: bool) -> float:
    if declared is not None and declared.type is not None:
        return SURE_TYPE_AND_CCT if declared.cct is not None else SURE_TYPE
    if outdoor:
        return SURE_OUTDOOR
    return SURE_UNKNOWN if kind == "smooth" else SURE_INDOOR_SETTING
