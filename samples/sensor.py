"""A camera: from spectral radiance to the counts of a Bayer mosaic.

The camera is a model with measured spectral sensitivities; its electronics are those of an ordinary 14-bit
camera. Camera RGB is in units of the white level per second: (counts − black) / (white − black) / seconds.

Noise is drawn from the raw bits of PCG64, one number for the photons and one for the reading of every pixel,
whatever their values: so a capture comes out the same on every machine, but for a last-bit difference of a
platform's mathematics that meets a rounding border (about once in 10⁴ captures).

Left out: lens, flare, cross-talk, dark current except in hot pixels, non-linearity near saturation.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import cache

import numpy as np
import numpy.typing as npt

from samples import spectra

Float64 = npt.NDArray[np.float64]
Counts = npt.NDArray[np.uint16]


@dataclass(frozen=True, slots=True)
class Camera:
    """Sensitivities and electronics of a camera.

    `cfa` names the colours of the mosaic's top left 2 × 2 pixels; `black_dn` has its four positions. An
    image of luminance 1 cd/m² and equal energy gives the green channel 1 / `white_luminance_s` of the white
    level per second: 78 N² / (0.65 ISO), ISO 12232's saturation speed at f/5.6 and ISO 100.
    `hot_pixels` pixels, at fixed places, fill at rates between 0.004 and 4 white levels a second.
    """

    make: str = "envcal"
    model: str = "Synthetic 360"
    sensitivities: str = "Nikon 5100 (NPL)"
    cfa: str = "RGGB"
    bits: int = 14
    black_dn: tuple[int, int, int, int] = (512, 512, 512, 512)
    white_dn: int = 16383
    gain_e_per_dn: float = 3.1
    read_noise_e: float = 3.0
    iso: int = 100
    f_number: Fraction = Fraction(28, 5)
    hot_pixels: int = 40
    noise: bool = True

    @property
    def white_luminance_s(self) -> float:
        """Return the exposure, in cd·s/m², that fills the green channel."""
        return 78.0 * float(self.f_number) ** 2 / (0.65 * self.iso)

    @property
    def responses(self) -> Float64:
        """Return the functionals, shape (3, 81), that make camera RGB per second of spectral radiance."""
        return _responses(self.sensitivities, self.white_luminance_s)

    def white_balance(self, spectrum: Float64) -> Float64:
        """Return camera RGB, shape (3,), of a light's spectrum, green 1: DNG's AsShotNeutral."""
        rgb = np.einsum("kn,n->k", self.responses, spectrum)
        return rgb / rgb.max()


@cache
def _responses(name: str, white_luminance_s: float) -> Float64:
    sensitivities = spectra.camera_sensitivities(name)
    flat = spectra.of_luminance_one(np.ones(len(spectra.WAVELENGTHS_NM)))
    green = float((sensitivities[1] * flat).sum())
    responses = sensitivities / (green * white_luminance_s)
    responses.setflags(write=False)
    return responses


@cache
def colour_matrix(sensitivities: str = "Nikon 5100 (NPL)", illuminant: str = "D65") -> Float64:
    """Return CAMERA_FROM_XYZ, shape (3, 3): the least-squares fit over chart and white under an illuminant.

    Scaled so that the illuminant itself gives a largest channel of one, and rounded to 1e-4, as DNG keeps it.
    """
    light = spectra.lamp(illuminant)
    reflectances = np.concatenate([np.ones((1, 81)), spectra.chart_reflectances(), spectra.colour_samples()])
    camera = np.einsum("kn,pn->pk", spectra.camera_sensitivities(sensitivities) * light, reflectances)
    xyz = spectra.xyz_of(reflectances * light)
    fit = np.linalg.lstsq(xyz, camera, rcond=None)[0].T
    matrix: Float64 = np.round(fit / np.einsum("kj,j->k", fit, xyz[0]).max(), 4)
    matrix.setflags(write=False)
    return matrix


def uniform(seed: tuple[int, ...], count: int) -> Float64:
    """Return `count` numbers in (0, 1), the same with every release of numpy: raw bits of PCG64."""
    raw = np.asarray(np.random.PCG64(np.random.SeedSequence(seed)).random_raw(count), np.uint64)
    return ((raw >> np.uint64(11)).astype(np.float64) + 0.5) * 2.0**-53


def poisson(mean: Float64, chance: Float64) -> Float64:
    """Return the quantile `chance` of the Poisson distribution of `mean`, of the same shape.

    Below 64 by summing the distribution; above by the expansion of Cornish and Fisher (1938) to its third
    term, whose error stays below half an electron.
    """
    from scipy.special import ndtri

    z = ndtri(chance)
    root = np.sqrt(np.maximum(mean, 1e-300))
    skewed = (z * z - 1.0) / 6.0 + (z**3 - 3.0 * z) / (24.0 * root) - (2.0 * z**3 - 5.0 * z) / (36.0 * root)
    electrons = np.floor(mean + root * z + skewed + 0.5)
    few = np.flatnonzero(mean < 64.0)
    electrons[few] = 0.0
    term = np.exp(-mean[few])
    total = term.copy()
    rest = np.arange(len(few))
    k = 0
    while len(rest):
        rest = rest[(chance[few[rest]] > total[rest]) & (k < 200)]
        k += 1
        electrons[few[rest]] = k
        term[rest] *= mean[few[rest]] / k
        total[rest] += term[rest]
    return electrons


def hot_pixels(camera: Camera, shape: tuple[int, int], seed: int) -> Float64:
    """Return what leaks into each pixel, shape (height, width), in white levels per second."""
    leak = np.zeros(shape)
    chance = uniform((seed, 7), 2 * camera.hot_pixels).reshape(2, -1)
    places = (chance[0] * leak.size).astype(int)
    leak.flat[places] = 10.0 ** (3.0 * chance[1] - 2.4)
    return leak


def bayer(rgb: Float64, cfa: str) -> Float64:
    """Return the mosaic, shape (height, width), of an image of shape (height, width, 3)."""
    mosaic = np.empty(rgb.shape[:2])
    for position, colour in enumerate(cfa):
        row, column = divmod(position, 2)
        mosaic[row::2, column::2] = rgb[row::2, column::2, "RGB".index(colour)]
    return mosaic


def expose(rgb: Float64, exposure_s: Fraction, *, camera: Camera, seed: int = 0, frame: int = 0) -> Counts:
    """Return the counts, shape (height, width), of an exposure of camera RGB, shape (height, width, 3).

    Photo-electrons are Poisson, reading adds a normal error, counts are rounded and clipped to 0…white.
    Without `camera.noise` the expected counts are rounded.
    """
    height, width = rgb.shape[:2]
    black = np.tile(np.reshape(camera.black_dn, (2, 2)), (height // 2 + 1, width // 2 + 1))[:height, :width]
    filled = bayer(rgb, camera.cfa)
    if camera.hot_pixels:
        filled = filled + hot_pixels(camera, (height, width), seed)
    electrons = filled * float(exposure_s) * (camera.white_dn - black) * camera.gain_e_per_dn
    if camera.noise:
        from scipy.special import ndtri

        chance = uniform((seed, 11, frame), 2 * electrons.size).reshape(2, -1)
        # A well holds some more than the white level; what exceeds it is clipped below in any case.
        full = 1.5 * camera.white_dn * camera.gain_e_per_dn
        electrons = poisson(np.minimum(electrons.ravel(), full), chance[0])
        electrons = (electrons + camera.read_noise_e * ndtri(chance[1])).reshape(height, width)
    counts = np.floor(black + electrons / camera.gain_e_per_dn + 0.5)
    return np.clip(counts, 0, camera.white_dn).astype(np.uint16)
