"""How true colours are when nobody knows the camera: its sensitivities estimated from chart and lamp, beside what else there is.

Each camera is left out of the model that estimates it. The chart stands in one light, with 1 % of noise; a D65 module (an LED mixture of
D65's colour) anchors it; then reflectances that are not the chart's are looked at in the chart's light and in five others.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from calibrate.adapt import von_kries_matrix
from calibrate.chart import ChartReference
from calibrate.correct import fit_matrix
from calibrate.trained import matrix_of_sensitivities
from samples import spectra as published
from uplift.cct import cct_duv, planck
from uplift.difference import delta_e_2000
from uplift.spectrometer import measure_light, reading_of
from uplift.spectrometer.camera import fitted_model, model_of
from uplift.spectrometer.chart import anchored
from uplift.spectrum import illuminant, observer, rgb_space

Floats = npt.NDArray[np.float64]
EYES = observer()
SPACE = rgb_space("ITU-R BT.2020", observer=EYES)
#: On the chart; a name with a plus is half and half, by luminance.
ON_CHART = ("A", "2000 K", "LED-B3", "FL2", "LED-B4+A", "D65")
OTHERS = ("A", "LED-B4", "D65", "FL11", "LED-B1")
WAYS = ("chart", "estimated", "sensitivities")
NOISE = 0.01
DIRECTIONS = 6
_SEED = 5


def lights(name: str) -> Floats:
    """Return a spectrum [81] of luminance 1, or the mean of two."""
    parts = [
        planck(EYES.wavelengths_nm, float(one[:-2])) if one.endswith(" K") else illuminant(one, EYES)
        for one in name.split("+")
    ]
    return np.asarray(sum(part / (part @ EYES.cmfs[:, 1]) for part in parts)) / len(parts)


def test_colours() -> Floats:
    """Return 25 reflectances [25, 81] of the 99 of CIE 224:2017: things, not charts."""
    return np.ascontiguousarray(published.colour_samples()[1::4])


def temperature_error(xyz_from_camera: Floats, sensitivities: Floats, light: Floats) -> float:
    """Return the relative error of Ohno's colour temperature of a light."""
    made, true = xyz_from_camera @ (light @ sensitivities), light @ EYES.cmfs
    return float(abs(cct_duv(made[:2] / made.sum())[0] / cct_duv(true[:2] / true.sum())[0] - 1.0))


def difference(xyz_from_camera: Floats, sensitivities: Floats, light: Floats) -> float:
    """Return the mean ΔE2000 of the test colours in a light, their mean luminance made equal."""
    seen = test_colours() * light
    true = seen @ EYES.cmfs / (light @ EYES.cmfs[:, 1])
    made = seen @ sensitivities @ xyz_from_camera.T
    made *= true[:, 1].sum() / made[:, 1].sum()
    return float(delta_e_2000(true @ SPACE.rgb_from_xyz.T, made @ SPACE.rgb_from_xyz.T, SPACE).mean())


def matrices(
    sensitivities: Floats, others: Floats, reflectances: Floats, reference: ChartReference, name: str
) -> dict[str, Floats]:
    """Return XYZ from camera [3, 3] of a camera [81, 3] by each way, its chart in the light `name`; `others` [M, 81, 3] make the model."""
    rng = np.random.default_rng(_SEED)
    day, module = lights("D65"), published.d65_module()
    lamp = module / (module @ EYES.cmfs[:, 1]) @ sensitivities
    patches = reflectances * lights(name) @ sensitivities
    patches = patches * (1 + NOISE * rng.standard_normal(patches.shape))
    fit = fit_matrix(patches, reference, rgb_from_xyz=np.eye(3))
    adapted = von_kries_matrix(fit.matrix @ lamp, day @ EYES.cmfs, xyz_from_rgb=np.eye(3), transform="CAT16")
    model = model_of(*fitted_model(others, EYES.wavelengths_nm, DIRECTIONS), EYES)
    found = measure_light(
        reading_of(patches, NOISE * np.abs(patches), lamp), camera=model, observer=EYES, reflectances=reflectances
    )

    def trained(curves: Floats) -> Floats:
        return matrix_of_sensitivities(
            lamp, curves, lamp=day, daylight=day, observer=EYES.cmfs, wavelengths_nm=EYES.wavelengths_nm
        )

    return {
        "chart": adapted @ fit.matrix,
        "estimated": trained(found.camera),
        "sensitivities": trained(sensitivities),
    }


def elsewhere(
    cameras: Floats,
    known: Floats,
    reflectances: Floats,
    reference: ChartReference,
    names: Sequence[str] = ON_CHART,
) -> dict[str, Any]:
    """Print and return, by light on the chart, the mean ΔE2000 of cameras [M, 81, 3] in it and in the others, and the worst camera's.

    `known` [K, 81, 3] are all cameras that there are; of them the model is made, without the one that is looked through.
    """
    found: dict[str, Any] = {}
    for name in names:
        of_cameras: dict[str, list[float]] = {way: [] for way in WAYS}
        warmth: dict[str, list[float]] = {way: [] for way in WAYS}
        for sensitivities in cameras:
            others = np.stack([anchored(one, EYES) for one in known if not np.array_equal(one, sensitivities)])
            for way, matrix in matrices(sensitivities, others, reflectances, reference, name).items():
                errors = [difference(matrix, sensitivities, lights(one)) for one in (name, *OTHERS)]
                of_cameras[way].append(float(np.mean(errors)))
                warmth[way].append(temperature_error(matrix, sensitivities, lights(name)))
        worse = np.mean(np.array(of_cameras["estimated"]) > np.array(of_cameras["chart"]))
        told = "  ".join(f"{way} {np.mean(values):.2f} ({np.max(values):.2f})" for way, values in of_cameras.items())
        print(f"  {name:9} {told}  estimated is worse than the chart for {worse:.0%}", flush=True)
        told = "  ".join(f"{way} {np.mean(values):.2%} ({np.max(values):.1%})" for way, values in warmth.items())
        print(f"  {'':9} CCT of that light: {told}", flush=True)
        found[name] = {way: float(np.mean(values)) for way, values in of_cameras.items()} | {"worse": float(worse)}
        found[name]["cct"] = {way: float(np.mean(values)) for way, values in warmth.items()}
    return found
