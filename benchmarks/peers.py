"""What the uplift is measured against: a plain loop, colour-science's table, a renderer loading the map."""

from __future__ import annotations

import os
import tempfile
import time
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from numba import njit, prange

from uplift.scaled import uplift_scaled
from uplift.spectrum import Observer, RGBSpace, rgb_weights

Float64 = npt.NDArray[np.float64]
Skipped = str  # the reason


class PlainLoop:
    """What one writes first: a 64-node bilinear look-up and two full Newton steps in double, fastmath, parallel.

    It knows no gamut: it is a yardstick for speed, for colours that the light can show.
    """

    def __init__(self, emissions: list[Float64], *, observer: Observer, space: RGBSpace, nodes: int = 64) -> None:
        weights = np.stack([rgb_weights(light, observer, space) for light in emissions])
        self._white = weights.sum(axis=2)
        self._weights = np.ascontiguousarray(weights / self._white[:, :, None])
        self._t = np.linspace(-1.0, 1.0, observer.wavelengths_nm.size)
        self._nodes = np.stack([_plain_table(w, self._t, nodes) for w in self._weights])

    def __call__(
        self,
        rgb: npt.NDArray[np.float32],
        cluster: npt.NDArray[np.uint32],
        *,
        steps: int = 2,
        out: tuple[Float64, Float64] | None = None,
    ) -> tuple[Float64, Float64]:
        """Return coefficients [H, W, 3] for t in −1 … 1 and scale [H, W]: the first rows of `out`, or new ones."""
        coefficients, scale = out or (np.empty(rgb.shape), np.empty(rgb.shape[:2]))
        coefficients, scale = coefficients[: len(rgb)], scale[: len(rgb)]
        _plain(rgb, cluster, self._white, self._weights, self._t, self._nodes, steps, coefficients, scale)
        return coefficients, scale

    def colours(self, coefficients: Float64, scale: Float64, cluster: npt.NDArray[np.uint32]) -> Float64:
        """Return the RGB [..., 3] of what was found."""
        c = coefficients[..., None]
        x = (c[..., 0, :] * self._t + c[..., 1, :]) * self._t + c[..., 2, :]
        s = 0.5 + 0.5 * x / np.sqrt(1 + x * x)
        out = np.empty(coefficients.shape)
        for k, (weights, white) in enumerate(zip(self._weights, self._white, strict=True)):
            out[cluster == k] = (s[cluster == k] @ weights.T) * white
        return out * scale[..., None]


@njit(cache=True, fastmath=True, error_model="numpy")
def _steps(weights, t, g0, g1, g2, c0, c1, c2, steps):  # type: ignore[no-untyped-def]
    for _ in range(steps):
        f0 = f1 = f2 = 0.0
        a = b = c = d = e = f = g = h = i = 0.0
        for k in range(t.size):
            x = (c0 * t[k] + c1) * t[k] + c2
            root = 1.0 / np.sqrt(1.0 + x * x)
            s, slope = 0.5 + 0.5 * x * root, 0.5 * root * root * root
            w0, w1, w2 = weights[0, k], weights[1, k], weights[2, k]
            f0, f1, f2 = f0 + w0 * s, f1 + w1 * s, f2 + w2 * s
            w0, w1, w2 = w0 * slope, w1 * slope, w2 * slope
            a, b, c = a + w0 * t[k] * t[k], b + w0 * t[k], c + w0
            d, e, f = d + w1 * t[k] * t[k], e + w1 * t[k], f + w1
            g, h, i = g + w2 * t[k] * t[k], h + w2 * t[k], i + w2
        r0, r1, r2 = g0 - f0, g1 - f1, g2 - f2
        determinant = a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g)
        c0 += ((e * i - f * h) * r0 + (c * h - b * i) * r1 + (b * f - c * e) * r2) / determinant
        c1 += ((f * g - d * i) * r0 + (a * i - c * g) * r1 + (c * d - a * f) * r2) / determinant
        c2 += ((d * h - e * g) * r0 + (b * g - a * h) * r1 + (a * e - b * d) * r2) / determinant
    return c0, c1, c2


@njit(cache=True, error_model="numpy")
def _plain_table(weights, t, n):  # type: ignore[no-untyped-def]
    """Return nodes [3, n, n, 3]; what full steps cannot solve from its neighbour keeps the neighbour's values."""
    nodes = np.zeros((3, n, n, 3))
    goal = np.empty(3)
    for m in range(3):
        for i in range(n - 1, -1, -1):
            for j in range(n - 1, -1, -1):
                if i == n - 1 and j == n - 1:
                    continue
                start = nodes[m, i, j + 1] if j < n - 1 else nodes[m, i + 1, j]
                goal[m], goal[(m + 1) % 3], goal[(m + 2) % 3] = 0.5, 0.5 * i / (n - 1), 0.5 * j / (n - 1)
                c0, c1, c2 = _steps(weights, t, goal[0], goal[1], goal[2], start[0], start[1], start[2], 6)
                error = 0.0
                for channel in range(3):
                    seen = 0.0
                    for k in range(t.size):
                        x = (c0 * t[k] + c1) * t[k] + c2
                        seen += weights[channel, k] * (0.5 + 0.5 * x / np.sqrt(1.0 + x * x))
                    error += abs(seen - goal[channel])
                if error < 1e-6:
                    nodes[m, i, j, 0], nodes[m, i, j, 1], nodes[m, i, j, 2] = c0, c1, c2
                else:
                    nodes[m, i, j] = start
    return nodes


@njit(cache=True, fastmath=True, error_model="numpy", parallel=True)
def _plain(rgb, cluster, white, weights, t, nodes, steps, coefficients, scale):  # type: ignore[no-untyped-def]
    n, width = nodes.shape[2], rgb.shape[1]
    for index in prange(rgb.shape[0] * width):
        row, column = index // width, index % width
        k = cluster[row, column]
        G0, G1, G2 = (
            rgb[row, column, 0] / white[k, 0],
            rgb[row, column, 1] / white[k, 1],
            rgb[row, column, 2] / white[k, 2],
        )
        largest = max(G0, G1, G2, 1e-30)
        if G0 >= G1 and G0 >= G2:
            m, p, q = 0, G1, G2
        elif G1 >= G2:
            m, p, q = 1, G2, G0
        else:
            m, p, q = 2, G0, G1
        p, q = p / largest * (n - 1), q / largest * (n - 1)
        i, j = min(int(p), n - 2), min(int(q), n - 2)
        p, q = p - i, q - j
        w00, w01, w10, w11 = (1 - p) * (1 - q), (1 - p) * q, p * (1 - q), p * q
        face = nodes[k, m]
        c0 = w00 * face[i, j, 0] + w01 * face[i, j + 1, 0] + w10 * face[i + 1, j, 0] + w11 * face[i + 1, j + 1, 0]
        c1 = w00 * face[i, j, 1] + w01 * face[i, j + 1, 1] + w10 * face[i + 1, j, 1] + w11 * face[i + 1, j + 1, 1]
        c2 = w00 * face[i, j, 2] + w01 * face[i, j + 1, 2] + w10 * face[i + 1, j, 2] + w11 * face[i + 1, j + 1, 2]
        brightness = 2.0 * largest
        c0, c1, c2 = _steps(weights[k], t, G0 / brightness, G1 / brightness, G2 / brightness, c0, c1, c2, steps)
        coefficients[row, column, 0] = c0
        coefficients[row, column, 1] = c1
        coefficients[row, column, 2] = c2
        scale[row, column] = brightness


def colour_look_up(
    observer: Observer, space: RGBSpace, *, nodes: int = 16
) -> Callable[[npt.NDArray[np.float32]], Float64] | Skipped:
    """Return colour-science's Jakob2019 look-up of rgb / (2 · max), or why there is none.

    Its own `generate` takes minutes, so the table (its file format, `nodes`³) is filled by `uplift.scaled` and read.
    The speed of the look-up does not depend on who filled the table.
    """
    try:
        from colour.recovery import LUT3D_Jakob2019
    except ImportError as error:
        return f"colour-science: {error}"
    lightness = np.linspace(0, 1, nodes)
    lightness = lightness**2 * (3 - 2 * lightness)
    ratio = np.linspace(0, 1, nodes)
    coefficients = np.zeros((3, nodes, nodes, nodes, 3), np.float32)
    for m in range(3):
        rgb = np.ones((nodes, nodes, 3))
        rgb[..., (m + 2) % 3], rgb[..., (m + 1) % 3] = ratio[:, None], ratio
        for k in range(1, nodes):
            factor = 1 / min(lightness[k], 0.999)
            coefficients[m, k] = uplift_scaled(rgb, observer=observer, space=space, factor=factor).coefficients
        coefficients[m, 0] = coefficients[m, 1]
    table = LUT3D_Jakob2019()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "table.coeff"
        with path.open("wb") as file:
            file.write(b"SPEC" + np.int32(nodes).tobytes() + np.float32(lightness).tobytes() + coefficients.tobytes())
        table.read(str(path))

    def look_up(rgb: npt.NDArray[np.float32]) -> Float64:
        largest = np.maximum(2 * rgb.max(axis=-1, keepdims=True), np.float32(1e-30))
        return np.asarray(table.RGB_to_coefficients(rgb / largest))

    return look_up


def renderer_load(rgb: npt.NDArray[np.float32]) -> tuple[str, float] | Skipped:
    """Return Mitsuba's variant and the seconds in which it loads `rgb` as a spectral `envmap`, or why it cannot."""
    try:
        mitsuba: Any = import_module("mitsuba")
    except ImportError:
        return "Mitsuba is not installed (pip install mitsuba)"
    # Some versions of LLVM abort the whole process on some machines: only one that was named is tried.
    llvm = ("llvm_ad_spectral",) if "DRJIT_LIBLLVM_PATH" in os.environ else ()
    wanted = [name for name in (*llvm, "scalar_spectral") if name in mitsuba.variants()]
    reason = "Mitsuba: no spectral variant in this build"
    for variant in wanted:
        try:
            mitsuba.set_variant(variant)
            bitmap = mitsuba.Bitmap(np.ascontiguousarray(rgb))
            mitsuba.load_dict({"type": "envmap", "bitmap": mitsuba.Bitmap(np.ascontiguousarray(rgb[:16, :32]))})
            start = time.perf_counter()
            mitsuba.load_dict({"type": "envmap", "bitmap": bitmap})
        except Exception as error:  # a renderer that does not start is a peer the less, not a failure
            reason = f"Mitsuba {variant}: {str(error).splitlines()[0]}"
            continue
        return variant, time.perf_counter() - start
    return reason
