"""What is lost when a renderer makes its own spectra from RGB: the relight test on a sample of pixels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from envcal.export.opened import Float64, Opened, bands, conversion
from envcal.reflectances import colour_checker
from uplift.difference import delta_e_2000
from uplift.radiance import spectra_of
from uplift.scaled import uplift_scaled
from uplift.spectrum import rgb_space

#: Pixels of the sample; the mean of their ΔE2000 is then known to a few per cent.
SAMPLE = 4096


@dataclass(frozen=True, slots=True, eq=False)
class Sample:
    """Pixels drawn from a map, each with a chance proportional to its solid angle; `light` is their luminance."""

    spectra: Float64  # [n, N], on the grid of the file
    rgb: Float64  # [n, 3], in the file's space
    light: Float64  # [n]
    cluster: npt.NDArray[np.uint32]  # [n]


def sample(opened: Opened, *, count: int = SAMPLE, seed: int = 1) -> Sample:
    """Draw about `count` pixels with radiance, evenly over the sphere; the same ones every time."""
    height, width = opened.size
    weight = np.sin(np.pi * (np.arange(height) + 0.5) / height)
    rng = np.random.default_rng(seed)
    drawn = np.sort(rng.choice(height, size=count, p=weight / weight.sum()))
    columns = rng.integers(0, width, count)
    emissions = opened.about.emissions()
    spectra, rgb, cluster = [], [], []
    for band in bands(opened):
        here = (drawn >= band.top) & (drawn < band.top + len(band.scale))
        place = (drawn[here] - band.top, columns[here])
        lit = band.scale[place] > 0
        place = (place[0][lit], place[1][lit])
        c, s, k = band.coefficients[place], band.scale[place], band.cluster[place]
        spectra.append(spectra_of(c, s, k, emissions, opened.wavelengths_nm, observer=opened.observer))
        picked = type(band)(0, c[np.newaxis], s[np.newaxis], k[np.newaxis])
        rgb.append(picked.rgb(opened)[0])
        cluster.append(k)
    colours = np.concatenate(rgb)
    light = colours @ opened.space.luminance_weights
    lit = light > 0
    return Sample(
        np.concatenate(spectra).astype(np.float64)[lit], colours[lit], light[lit], np.concatenate(cluster)[lit]
    )


def reconstruction(opened: Opened, drawn: Sample, space: str) -> Float64:
    """Return the spectra [n, N] that a renderer makes of the pixels' RGB in `space`: a sigmoid times D65.

    As pbrt-v4's RGBIlluminantSpectrum and Mitsuba's envmap define it: the sigmoid of rgb / (2 · max(rgb)) times the
    illuminant of the space times 2 · max(rgb), negative components being 0. Solved exactly here; the renderers look up
    a table of 64³ cells, and differ from this by as much as that interpolates wrongly.
    """
    target = rgb_space(space, observer=opened.observer)
    rgb = np.maximum(drawn.rgb @ conversion(opened.space, target).T, 0.0)
    found = uplift_scaled(rgb[np.newaxis], observer=opened.observer, space=target)
    return np.asarray(
        spectra_of(
            found.coefficients[0],
            found.scale[0],
            found.emission[0],
            found.emissions,
            opened.wavelengths_nm,
            observer=opened.observer,
        ),
        dtype=np.float64,
    )


def relight(opened: Opened, ours: Float64, theirs: Float64) -> Float64:
    """Return ΔE2000 [n, 24] of the ColorChecker patches under pairs of light spectra [n, N].

    Each pair is scaled so that the first of them has luminance 1: a patch is judged beside a white of that light.
    """
    patches = np.stack(list(colour_checker(opened.wavelengths_nm).values()))
    weights = opened.space.rgb_from_xyz @ (opened.observer.cmfs * opened.observer.step_nm).T
    luminance = ours @ (weights.T @ opened.space.luminance_weights)
    first = np.einsum("nw,pw,cw->npc", ours / luminance[:, None], patches, weights, optimize=True)
    second = np.einsum("nw,pw,cw->npc", theirs / luminance[:, None], patches, weights, optimize=True)
    return delta_e_2000(first, second, opened.space)


def loss(opened: Opened, *, space: str) -> dict[str, float]:
    """Return the mean, median and 95th percentile of ΔE2000 over the pixels' means, and the mean weighted by light."""
    drawn = sample(opened)
    if not len(drawn.light):
        return {"pixels": 0, "mean": 0.0, "median": 0.0, "p95": 0.0, "mean_by_light": 0.0}
    difference = relight(opened, drawn.spectra, reconstruction(opened, drawn, space))
    per_pixel = difference.mean(axis=1)
    return {
        "pixels": len(per_pixel),
        "mean": float(difference.mean()),
        "median": float(np.median(per_pixel)),
        "p95": float(np.percentile(per_pixel, 95)),
        "mean_by_light": float((per_pixel * drawn.light).sum() / drawn.light.sum()),
    }
