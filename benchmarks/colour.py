"""How true are the colours that chart, lamp and camera sensitivities give? Cameras of measured sensitivities, without noise.

    python -m benchmarks colour [--every N] [--json FILE]

It needs the environment variable ENVCAL_DATA: a folder with `camera_sensitivities.npz`. The chart is that of measured
reflectances (BabelColor's average of thirty charts), its targets are the same reflectances integrated under D65, so that what is
left is the camera's and the fit's alone. 380–780 nm by 5 nm, CIE 1931 2°.

1. **Fit**: mean CIEDE2000 of the patches, each predicted by a fit without it, and trained; by light, model and settings.
2. **Lamp**: relative error of the colour temperature (Ohno 2013) of the light on the chart after an ideal D65 lamp in the
   same light was balanced: by the chart's matrix and each adaptation, and by the sensitivities with the lamp first.
3. **Fall-off**: the same in CAT16 where the light falls by 20 % from one side of the chart to the other, and the fit knows of it or not.
4. **Elsewhere** (`estimated_cameras`): the colours of other things, in the chart's light and in others, by the chart's matrix, by sensitivities
   estimated from chart and lamp, and by measured ones.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from benchmarks.estimated_cameras import elsewhere
from calibrate.adapt import von_kries_matrix
from calibrate.chart import ChartReference, chart_reference
from calibrate.chart.geometry import CLASSIC
from calibrate.correct import fit_matrix
from calibrate.trained import matrix_of_sensitivities
from uplift.cct import cct_duv, planck
from uplift.spectrum import illuminant, observer

Floats = npt.NDArray[np.float64]
EYES = observer()
TRANSFORMS = ("CAT16", "Bradford", "CAT02", "XYZ Scaling")
WARM_OR_LINES = ("A", "2000 K", "LED-B3", "LED-B5", "FL2")
SMOOTH = ("A", "2000 K", "3000 K", "4000 K", "D50", "D55", "D75", "LED-B1", "LED-B3")
FALL_OFF = 0.2
FITS: dict[str, dict[str, Any]] = {
    "3×3, as it is by default": {},
    "3×3, even light": {"shading": "none"},
    "3×3, even light, lightness": {"shading": "none", "weighting": "lightness"},
    "3×3, lightness": {"weighting": "lightness"},
    "root-polynomial": {"model": "root-polynomial"},
    "root-polynomial, even light, lightness": {
        "model": "root-polynomial",
        "shading": "none",
        "weighting": "lightness",
    },
}


def light(name: str) -> Floats:
    """Return a spectrum [81] by its CIE name or as a black body's temperature, luminance 1."""
    if name.endswith(" K"):
        spectrum = np.asarray(planck(EYES.wavelengths_nm, float(name[:-2])), dtype=np.float64)
    else:
        spectrum = np.asarray(illuminant(name, EYES), dtype=np.float64)
    return np.asarray(spectrum / (spectrum @ EYES.cmfs[:, 1]))


def chart() -> Floats:
    """Return the measured reflectances [24, 81] of the chart, held constant beyond their ends."""
    import colour

    patches = colour.SDS_COLOURCHECKERS["BabelColor Average"].values()
    return np.array([np.interp(EYES.wavelengths_nm, patch.wavelengths, patch.values) for patch in patches])


def true_reference(reflectances: Floats) -> ChartReference:
    """Return the chart's colours under D65, integrated from its reflectances [24, 81]."""
    xyz = reflectances * light("D65") @ EYES.cmfs
    return ChartReference("measured reflectances", chart_reference().names, np.asarray(xyz))


def cct(xyz: Floats) -> float:
    """Return Ohno's colour temperature of XYZ [3]; NaN where there is none."""
    return float(cct_duv(xyz[:2] / xyz.sum())[0]) if (xyz.sum() > 0 and np.isfinite(xyz).all()) else float("nan")


def differences(cameras: Floats, reflectances: Floats, name: str, settings: dict[str, Any]) -> Floats:
    """Return mean ΔE2000 [M, 2], trained and with each patch left out, of cameras [M, 81, 3] under a light."""
    reference, pairs = true_reference(reflectances), []
    for sensitivities in cameras:
        seen = reflectances * light(name) @ sensitivities
        fit = fit_matrix(seen, reference, rgb_from_xyz=np.eye(3), spoilt="keep", **settings)
        pairs.append((fit.delta_e.mean(), fit.delta_e_loo.mean()))
    return np.array(pairs)


def errors_by_chart(
    cameras: Floats, reflectances: Floats, name: str, *, falls_by: float = 0.0, **settings: Any
) -> dict[str, Floats]:
    """Return relative errors [M] of the colour temperature of the chart's light, by adaptation, of fits with `settings`.

    The light falls by the part `falls_by` from the left of the chart to the right.
    """
    reference, lamp, spectrum = true_reference(reflectances), light("D65"), light(name)
    truth, white = cct(spectrum @ EYES.cmfs), lamp @ EYES.cmfs
    on_patches = (1.0 - falls_by) ** CLASSIC.places[:, :1]
    errors: dict[str, list[float]] = {transform: [] for transform in TRANSFORMS}
    for sensitivities in cameras:
        seen = on_patches * (reflectances * spectrum @ sensitivities)
        fit = fit_matrix(seen, reference, rgb_from_xyz=np.eye(3), **settings)
        for transform in TRANSFORMS:
            source = fit.matrix @ (lamp @ sensitivities)
            adapted = von_kries_matrix(source, white, xyz_from_rgb=np.eye(3), transform=transform)
            errors[transform].append(cct(adapted @ fit.matrix @ (spectrum @ sensitivities)) / truth - 1)
    return {transform: np.array(values) for transform, values in errors.items()}


def errors_by_sensitivities(cameras: Floats, name: str) -> Floats:
    """Return relative errors [M] of the colour temperature of a light by matrices trained on the sensitivities."""
    lamp, spectrum = light("D65"), light(name)
    errors = []
    for sensitivities in cameras:
        seen_lamp = lamp @ sensitivities
        trained = matrix_of_sensitivities(
            seen_lamp,
            sensitivities,
            lamp=lamp,
            daylight=lamp,
            observer=EYES.cmfs,
            wavelengths_nm=EYES.wavelengths_nm,
        )
        errors.append(cct(trained @ (spectrum @ sensitivities)) / cct(spectrum @ EYES.cmfs) - 1)
    return np.array(errors)


def main(arguments: list[str] | None = None) -> int:
    """Print how exactly colours and colour temperatures come out over all cameras."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks colour", description=__doc__)
    parser.add_argument("--json", type=Path, help="write the figures there")
    parser.add_argument("--every", type=int, default=1, help="take only every so-many-th camera")
    given = parser.parse_args(arguments)
    folder = os.environ.get("ENVCAL_DATA")
    if not folder or not (Path(folder) / "camera_sensitivities.npz").is_file():
        print("skipped: ENVCAL_DATA names no folder with camera_sensitivities.npz", file=sys.stderr)
        return 0
    data = np.load(Path(folder) / "camera_sensitivities.npz")
    if not np.array_equal(data["wavelength"], EYES.wavelengths_nm):
        print("camera_sensitivities.npz: expected 380–780 nm by 5 nm", file=sys.stderr)
        return 1
    cameras, reflectances = np.asarray(data["ssf"], dtype=np.float64), chart()
    chosen = cameras[:: max(given.every, 1)]
    figures = measured(chosen, reflectances)
    print(
        "\nmean ΔE2000 of other things in the chart's light and in five others (worst camera); a camera is estimated by the others"
    )
    figures["elsewhere"] = elsewhere(chosen, cameras, reflectances, true_reference(reflectances))
    if given.json:
        given.json.write_text(json.dumps(figures, indent=1), encoding="utf-8")
    return 0


def measured(cameras: Floats, reflectances: Floats) -> dict[str, Any]:
    """Return the figures of cameras [M, 81, 3] and a chart [24, 81], printing each as it comes."""
    figures: dict[str, Any] = {"cameras": len(cameras)}
    print(f"{len(cameras)} cameras\n\nmean ΔE2000 of the patches: trained / each left out (worst camera)")
    for name in ("D65", "A"):
        for what, settings in FITS.items():
            pairs = differences(cameras, reflectances, name, settings)
            trained, unseen = (float(mean) for mean in pairs.mean(axis=0))
            print(f"  {name:4} {what:40} {trained:.2f} / {unseen:.2f} ({pairs[:, 1].max():.2f})", flush=True)
            figures.setdefault("fit", {}).setdefault(name, {})[what] = {"trained": trained, "left_out": unseen}
    print("\nerror of the colour temperature of the chart's light after the lamp balance, %: mean (largest)")
    for name in WARM_OR_LINES:
        errors = errors_by_chart(cameras, reflectances, name)
        shown = "  ".join(f"{way} {_percent(values)}" for way, values in errors.items())
        print(f"  {name:8} {shown}", flush=True)
        figures.setdefault("light by chart", {})[name] = {way: _mean(values) for way, values in errors.items()}
    print("\nthe same by sensitivities, the lamp first")
    for name in (*SMOOTH, *(line for line in WARM_OR_LINES if line not in SMOOTH)):
        values = errors_by_sensitivities(cameras, name)
        print(f"  {name:8} {_percent(values)}", flush=True)
        figures.setdefault("light by sensitivities", {})[name] = _mean(values)
    print(f"\nthe same by the chart in CAT16, the light falling by {FALL_OFF:.0%} across the chart")
    for name in WARM_OR_LINES[:2]:
        for shading in ("plane", "none"):
            falling = errors_by_chart(cameras, reflectances, name, falls_by=FALL_OFF, shading=shading, spoilt="keep")[
                "CAT16"
            ]
            print(f"  {name:8} shading {shading:6} {_percent(falling)}", flush=True)
            figures.setdefault("fall-off", {}).setdefault(name, {})[shading] = _mean(falling)
    return figures


def _mean(errors: Floats) -> float:
    return float(np.abs(errors).mean())


def _percent(errors: Floats) -> str:
    return f"{100 * _mean(errors):.2f} ({100 * np.abs(errors).max():.1f})"
