"""Little maps with known lamps: patches of a colour chart under them, with or without the lamps in view."""

import numpy as np

from uplift.spectrum import Observer, RGBSpace, illuminant, observer, rgb_space

OBSERVER: Observer = observer()
SPACE: RGBSpace = rgb_space("ITU-R BT.2020")
WEIGHTS = SPACE.rgb_from_xyz @ OBSERVER.cmfs.T * OBSERVER.step_nm  # RGB = WEIGHTS @ spectrum
BROADER = 3.0  # how sharply the light of one lamp gives way to the next one's


def reflectances() -> np.ndarray:
    """The 24 patches of a ColorChecker [24, N]."""
    from colour.characterisation import SDS_COLOURCHECKERS

    patches = SDS_COLOURCHECKERS["BabelColor Average"].values()
    return np.array([np.interp(OBSERVER.wavelengths_nm, sd.wavelengths, sd.values) for sd in patches])


def emission_rgb(name: str) -> np.ndarray:
    return WEIGHTS @ illuminant(name, OBSERVER)


def room(lamps: list[str], *, seed: int = 0, in_view: bool = True, height: int = 64, tile: int = 4) -> np.ndarray:
    """A lat-long map [H, 2H, 3] whose longitudes are lit by one lamp after the other, blending smoothly.

    Its surfaces are tiles of random patches; if `in_view`, each lamp is a square 400 times as bright as a white card.
    """
    rng = np.random.default_rng(seed)
    width = 2 * height
    patch = rng.integers(0, 24, (height // tile, width // tile)).repeat(tile, 0).repeat(tile, 1)
    u = (np.arange(width) + 0.5) / width
    share = np.array([np.exp(BROADER * np.cos(2 * np.pi * (u - i / len(lamps)))) for i in range(len(lamps))])
    share /= share.sum(axis=0)
    out = np.zeros((height, width, 3))
    size = height // 32
    for i, lamp in enumerate(lamps):
        out += share[i][:, np.newaxis] * (reflectances() @ (WEIGHTS * illuminant(lamp, OBSERVER)).T)[patch]
        if in_view:
            x = int(i / len(lamps) * width) + width // 8
            out[height // 4 : height // 4 + size, x : x + size] = 400.0 * emission_rgb(lamp)
    return out.astype(np.float32)


def open_air(
    *, height: int = 64, sun: bool = True, sky: str = "D75", sun_lamp: str = "D50", seed: int = 0
) -> np.ndarray:
    """Sky down to the horizon, brighter towards it, with a sun in it, over rough ground."""
    rng = np.random.default_rng(seed)
    width = 2 * height
    v = (np.arange(height) + 0.5) / height
    out = (0.6 + 0.8 * v)[:, np.newaxis, np.newaxis] * np.ones((1, width, 1)) * emission_rgb(sky)
    ground = v >= 0.5
    colours = reflectances() @ (WEIGHTS * illuminant("D55", OBSERVER)).T
    out[ground] = 0.25 * colours[rng.integers(0, 24, (int(ground.sum()), width))]
    if sun:
        out[height // 4 : height // 4 + 2, width // 3 : width // 3 + 2] = 2000.0 * emission_rgb(sun_lamp)
    return out.astype(np.float32)
