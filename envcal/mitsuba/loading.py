"""An uplift file, or arrays of the same meaning, in the form that the emitter keeps: float32, wavelengths near zero.

In nanometres the terms of c0 λ² + c1 λ + c2 reach some thousands and cancel; in t = (λ − 580) / 200 they do not, so
single precision is enough at render time. The change of variable is made here, once, in double precision.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from numba import njit

from envcal import exr
from envcal.errors import EnvcalError
from envcal.uplift_file import About, read_about

#: t = (λ − CENTRE_NM) / HALF_NM; near the middle of what is seen, any value serves.
CENTRE_NM, HALF_NM = 580.0, 200.0
#: Stands for c2 = ±inf (a reflectance of 1 or 0 everywhere): its S is 1 − 3e-17, and its square is no infinity.
FLAT = 1e8
_ROWS = 256
_THREADS = 4

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class SpectralMap:
    """A lat-long map of spectral radiance, as the emitter keeps it.

    Attributes
    ----------
    data
        Shape (height, width, 4), float32: coefficients of t², t and 1, and scale.
    cluster
        Shape (height, width), uint32: which emission.
    wavelengths_nm
        Shape (n,): ascending, evenly spaced.
    emissions
        Shape (clusters, n); Σ ȳ·E·Δλ = 1. Linear between the wavelengths, zero outside.
    name
        Where it comes from, for messages.
    """

    data: Float32
    cluster: npt.NDArray[np.uint32]
    wavelengths_nm: Float64
    emissions: Float64
    name: str = "arrays"

    @staticmethod
    def from_arrays(
        coefficients: npt.NDArray[np.floating],
        scale: npt.NDArray[np.floating],
        cluster: npt.NDArray[np.integer] | None = None,
        *,
        wavelengths_nm: npt.ArrayLike,
        emissions: npt.ArrayLike,
    ) -> SpectralMap:
        """Return the map of coefficients [height, width, 3] for λ in nm, scale and cluster [height, width]."""
        light, grid = np.atleast_2d(np.asarray(emissions, float)), np.asarray(wavelengths_nm, float)
        index = np.zeros(scale.shape, np.uint32) if cluster is None else np.asarray(cluster, np.uint32)
        if coefficients.shape != (*scale.shape, 3) or index.shape != scale.shape or scale.ndim != 2:
            raise EnvcalError(
                f"arrays: coefficients {coefficients.shape}, scale {scale.shape}, cluster {index.shape}; expected "
                f"(height, width, 3), (height, width) and (height, width)."
            )
        data = np.empty((*scale.shape, 4), np.float32)
        data[..., :3] = _in_t(*(coefficients[..., k] for k in range(3)))
        data[..., 3] = scale
        return _checked(SpectralMap(data, np.ascontiguousarray(index), grid, light))


def load(path: Path) -> SpectralMap:
    """Read an uplift file, by bands of rows."""
    header, about = read_about(path)
    if about.model != About.model_fields["model"].default:
        raise EnvcalError(
            f"{path}: its radiance is `{about.model}`; this emitter knows `{About.model_fields['model'].default}` only. "
            f"Make the file with `envcal uplift --method constrained` or `--method scaled`."
        )
    height, width = header.size
    data, cluster = np.empty((height, width, 4), np.float32), np.empty((height, width), np.uint32)
    for top, planes in exr.bands(path, ("c0", "c1", "c2", "scale", "cluster"), rows=_ROWS):
        rows = slice(top, top + len(planes["scale"]))
        data[rows, :, :3] = _in_t(*(planes[name] for name in ("c0", "c1", "c2")))
        data[rows, :, 3] = planes["scale"]
        cluster[rows] = planes["cluster"]
    grid = np.asarray(about.wavelengths_nm, float)
    return _checked(SpectralMap(data, cluster, grid, about.emissions(), str(path)))


def slots(cluster: npt.NDArray[np.uint32], clusters: int) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.uint8]]:
    """Return the clusters that pixels have, and per pixel the place of its own among them [height, width]."""
    used = np.flatnonzero(np.bincount(cluster.ravel(), minlength=clusters))
    if len(used) > 256:
        raise EnvcalError(f"arrays: pixels of {len(used)} clusters; at most 256 can be told apart.")
    place = np.zeros(clusters, np.uint8)
    place[used] = np.arange(len(used))
    return used, place[cluster]


def quads(slot: npt.NDArray[np.uint8]) -> npt.NDArray[np.uint32]:
    """Return, per pixel, its slot and those of its right, lower and lower right neighbours, from the lowest byte up."""
    right = np.roll(slot, -1, axis=1)
    lower, lower_right = (np.concatenate([side[1:], side[-1:]]) for side in (slot, right))
    return np.stack([slot, right, lower, lower_right], axis=-1).view("<u4")[..., 0].astype(np.uint32, copy=False)


def packed(used: npt.NDArray[np.intp], nodes: int, width: int) -> npt.NDArray[np.uint32]:
    """Return where, in emissions [clusters, nodes] laid flat, the pairs (here, next node) of `width` slots stand."""
    rows = np.resize(used, width)
    here = rows[None, :] * nodes + np.arange(nodes)[:, None]
    after = rows[None, :] * nodes + np.minimum(np.arange(nodes) + 1, nodes - 1)[:, None]
    return np.stack([here, after], axis=-1).ravel().astype(np.uint32)


def load_rgb(path: Path) -> Float32:
    """Read R, G, B of an uplift file as linear sRGB [height, width, 3]; missing pixels are black.

    The primaries are changed without adaptation, as a spectral render developed to sRGB does it.
    """
    header, _ = read_about(path)
    if header.chromaticities is None:
        raise EnvcalError(
            f"{path}: has no chromaticities, so its RGB has no meaning. Make it again with `envcal uplift`."
        )
    matrix = np.linalg.solve(_xyz_from_rgb(_SRGB), _xyz_from_rgb(header.chromaticities))
    image = np.empty((*header.size, 3), np.float32)
    for top, planes in exr.bands(path, "RGB", rows=_ROWS):
        rgb = np.nan_to_num(np.stack([planes[c] for c in "RGB"], axis=-1), nan=0.0)
        image[top : top + len(rgb)] = rgb @ matrix.T
    return image


_SRGB = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)


def _xyz_from_rgb(chromaticities: tuple[float, ...]) -> Float64:
    """Return the matrix that takes (1, 1, 1) to the white at Y = 1."""
    xy = np.asarray(chromaticities, float).reshape(4, 2)
    xyz = np.stack([xy[:, 0], xy[:, 1], 1 - xy.sum(axis=1)]) / xy[:, 1]
    return np.asarray(xyz[:, :3] * np.linalg.solve(xyz[:, :3], xyz[:, 3]))


def _in_t(c0: npt.NDArray[np.floating], c1: npt.NDArray[np.floating], c2: npt.NDArray[np.floating]) -> Float64:
    """Return [..., 3] for t from coefficients for λ in nm."""
    a, b, c = (np.asarray(values, np.float64) for values in (c0, c1, c2))
    slope = 2 * CENTRE_NM * a + b
    in_t = np.stack([HALF_NM**2 * a, HALF_NM * slope, (a * CENTRE_NM + b) * CENTRE_NM + c], axis=-1)
    flat = np.isinf(c)
    if flat.any():
        in_t[flat] = 0.0
        in_t[flat, 2] = np.sign(c[flat]) * FLAT
    return in_t


def _checked(spectral: SpectralMap) -> SpectralMap:
    height, width = spectral.cluster.shape
    steps = np.diff(spectral.wavelengths_nm)
    if height < 2 or width < 2:
        raise EnvcalError(f"{spectral.name}: {width}×{height} pixels; a lat-long map has at least 2×2.")
    if not len(steps) or steps.min() <= 0 or np.ptp(steps) > 1e-6 * steps.mean():
        raise EnvcalError(f"{spectral.name}: the wavelengths are not ascending and even; resample the emissions.")
    if spectral.emissions.shape[1:] != spectral.wavelengths_nm.shape:
        raise EnvcalError(f"{spectral.name}: the emissions have not one value per wavelength.")
    if not np.isfinite(spectral.emissions).all() or spectral.emissions.min() < 0:
        raise EnvcalError(f"{spectral.name}: an emission is negative or not finite; expected 0 or more.")
    if spectral.cluster.max() >= len(spectral.emissions):
        raise EnvcalError(
            f"{spectral.name}: a pixel is of cluster {spectral.cluster.max()}, but there are {len(spectral.emissions)} "
            f"emissions. Make the file again with `envcal uplift`."
        )
    if not np.isfinite(spectral.data).all() or spectral.data[..., 3].min() < 0:
        bad = ~np.isfinite(spectral.data).all(axis=2) | (spectral.data[..., 3] < 0)
        y, x = (int(v[0]) for v in np.nonzero(bad))
        raise EnvcalError(
            f"{spectral.name}: {int(bad.sum())} pixels are negative or not finite, the first at x={x}, y={y}; "
            f"expected a scale of 0 where there is no radiance. Make the file again with `envcal uplift`."
        )
    return spectral


def luminance(
    data: Float32, cluster: npt.NDArray[np.unsignedinteger], weights: Float64, wavelengths_nm: Float64
) -> Float32:
    """Return scale · Σ weights_cluster · S [height, width]; rows are shared out among threads."""
    t = ((wavelengths_nm - CENTRE_NM) / HALF_NM).astype(np.float32)
    used = np.ascontiguousarray(weights, np.float32)
    out = np.empty(cluster.shape, np.float32)
    with ThreadPoolExecutor(_THREADS) as pool:
        tops = range(0, len(out), _ROWS)
        jobs = [
            pool.submit(_luminance, data[y : y + _ROWS], cluster[y : y + _ROWS], used, t, out[y : y + _ROWS])
            for y in tops
        ]
        for job in jobs:
            job.result()
    return out


@njit(cache=True, nogil=True, fastmath=True, error_model="numpy")
def _luminance(data, cluster, weights, t, out):  # type: ignore[no-untyped-def]
    half, one = np.float32(0.5), np.float32(1)
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            a, b, c = data[y, x, 0], data[y, x, 1], data[y, x, 2]
            w = weights[cluster[y, x]]
            total = np.float32(0)
            for k in range(t.size):
                v = (a * t[k] + b) * t[k] + c
                total += w[k] * (half + half * v / np.sqrt(v * v + one))
            out[y, x] = max(total, np.float32(0)) * data[y, x, 3]
