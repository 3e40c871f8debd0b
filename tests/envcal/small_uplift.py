"""A little uplift file of two lamps, made by the stages themselves on a map whose colours are known."""

from pathlib import Path

import numpy as np

from envcal import exr, provenance
from envcal.config import UpliftSettings
from envcal.lights_file import LightRecord, Lights
from envcal.maps import read_map
from envcal.steps.uplift import uplift
from uplift.illuminants import cct_duv_of
from uplift.spectrum import illuminant, observer, rgb_space, rgb_weights

SPACE = "ITU-R BT.2020"
EYES = observer()


def small_uplift(
    folder: Path,
    *,
    lamps: tuple[str, ...] = ("FL11", "LED-B3"),
    height: int = 8,
    seed: int = 3,
    method: str = "constrained",
    peak: float = 1.0,
    saturated: bool = False,
    smooth: bool = False,
    black: bool = False,
) -> tuple[Path, np.ndarray]:
    """Write `uplift.exr` and return its path and the colours [H, 2H, 3] it was made of.

    Lamps share the columns out among themselves; `smooth` gives each of them one colour and a soft gradient. The first pixel is black,
    the second as bright as `peak`; with `black` all of them are.
    """
    width = 2 * height
    space = rgb_space(SPACE, observer=EYES)
    cluster = np.broadcast_to(np.arange(width) * len(lamps) // width, (height, width)).astype(np.uint32)
    emissions = [illuminant(name, EYES) for name in lamps]
    rng = np.random.default_rng(seed)
    t = (EYES.wavelengths_nm - 580.0) / 200.0
    slopes = rng.normal(0.0, 0.7, (height, width, 2))
    reflectance = 1.0 / (1.0 + np.exp(1.0 + slopes[..., :1] * t + slopes[..., 1:] * t**2))
    colours = np.stack([rgb_weights(emission, EYES, space) for emission in emissions])
    rgb = np.einsum("hwcn,hwn->hwc", colours[cluster], reflectance) * np.exp(rng.normal(0, 0.6, (height, width, 1)))
    if smooth:  # one reflectance a lamp: nothing between two texels but their brightness
        reflectance = reflectance[:1, :1] + 0.0 * reflectance
        v = (np.arange(height)[:, None] + 0.5) / height
        bright = 1.0 + 0.5 * np.sin(np.pi * v) * np.cos(2 * np.pi * (np.arange(width) + 0.5) / width)
        rgb = np.einsum("hwcn,hwn->hwc", colours[cluster], reflectance) * bright[..., None]
    rgb[0, 0], rgb[0, 1] = 0.0, peak * colours[0].sum(axis=1)
    if saturated:
        rgb[1, :] = [0.02, 0.9, 0.05]
    if black:
        rgb[:] = 0.0
    image = np.ascontiguousarray(rgb, dtype=np.float32)
    attributes = {**provenance.colour_space(SPACE), "envmap": True}
    exr.write(folder / "map.exr", exr.rgb_planes(image), attributes=attributes)
    lights = Lights(
        wavelengths="380:780:5",
        observer=EYES.name,
        space=SPACE,
        sky=False,
        lights=[_record(k, name, emission) for k, (name, emission) in enumerate(zip(lamps, emissions, strict=True))],
    )
    planes = {**exr.rgb_planes(image), "cluster": np.ascontiguousarray(cluster), "sky": np.zeros_like(cluster)}
    exr.write(
        folder / "clusters.exr", planes, attributes={**attributes, "envcalLights": lights.model_dump(mode="json")}
    )
    out = folder / "uplift.exr"
    uplift(
        read_map(folder / "map.exr"), folder / "clusters.exr", out, UpliftSettings.model_validate({"method": method})
    )
    return out, image


def _record(cluster: int, name: str, emission: np.ndarray) -> LightRecord:
    cct, duv = cct_duv_of(emission, EYES)
    values = {
        "cluster": cluster, "type": "measured", "name": name, "cct": cct, "duv": duv, "cct_seen": cct, "duv_seen": duv, "cct_sigma": 1.0,
        "outdoor": False, "share": 0.5, "at": (0.5, 0.5), "confidence": 1.0, "remedy": "", "source": f"CIE {name}", "declared": True,
        "emission": [float(v) for v in emission],
    }  # fmt: skip
    return LightRecord.model_validate(values)
