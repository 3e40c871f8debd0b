"""What is true of a synthetic capture, for tests: radiance, lamps, masks and the chart's corners."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from samples import spectra
from samples.sensor import Camera
from samples.view import View

Float32 = npt.NDArray[np.float32]
Float64 = npt.NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The answers of a capture. L lamps, E = L or L + 1 emitters (the D65 module comes last)."""

    wavelengths_nm: Float64
    """(81,)."""
    spectral: Float32 | None
    """(H, W, 81) spectral radiance in W·m⁻²·sr⁻¹·nm⁻¹, if it was asked for."""
    camera_rgb: Float64
    """(H, W, 3) noise-free camera RGB in white levels per second."""
    xyz: Float64
    """(H, W, 3) XYZ in cd/m²."""
    emitters: tuple[str, ...]
    """Names of the emitters."""
    emission: Float64
    """(E, 81) their spectral radiance."""
    cct_k: Float64
    """(E,) their correlated colour temperature, Ohno 2013."""
    duv: Float64
    """(E,) their distance from the Planckian locus."""
    seen: Float32
    """(H, W, E) share of the pixel that shows the emitter itself."""
    labels: npt.NDArray[np.int8]
    """(H, W) the emitter seen in at least half of the pixel, −1 elsewhere."""
    shares: Float32
    """(H, W, L) share of each lamp in the luminance of the pixel; a lamp seen directly is its own."""
    dominant: npt.NDArray[np.int8]
    """(H, W) the lamp with the largest share; −1 where only the module is seen, or nothing."""
    chart_corners: Float64 | None
    """(4, 2) pixels TL, TR, BR, BL of the box around the patches with a gap's margin (OpenCV's chart box)."""
    patch_quads: Float64 | None
    """(24, 4, 2) pixels of the patches' corners, TL, TR, BR, BL, row by row from dark skin."""
    patch_xyz: Float64 | None
    """(24, 3) XYZ in cd/m² of the patches' means over their pixels (the inner half)."""

    @property
    def module(self) -> npt.NDArray[np.bool_]:
        """(H, W) pixels that show nothing but the D65 module; empty if there is none."""
        if "D65 module" not in self.emitters:
            return np.zeros(self.labels.shape, bool)
        return np.asarray(self.seen[..., self.emitters.index("D65 module")] >= 1.0)

    def lamp(self, name: str) -> int:
        """Return the index of an emitter by name."""
        return self.emitters.index(name)


def truth_of(view: View, camera: Camera, *, spectral: bool = False) -> Truth:
    """Return what is true of a view through a camera."""
    scene = view.scene
    luminance = spectra.cmfs()[:, 1][None] * (spectra.LUMENS_PER_WATT * spectra.STEP_NM)
    functionals = spectra.cmfs().T * (spectra.LUMENS_PER_WATT * spectra.STEP_NM)
    xyz = view.response(functionals)
    seen = view.seen()
    share = []
    for lamp in range(scene.lamps):
        alone = np.zeros_like(scene.emission)
        alone[lamp] = scene.emission[lamp]
        share.append(view.response(luminance, spectra=alone)[..., 0])
    parts = np.stack(share, axis=-1)
    total = xyz[..., 1:2]
    shares = np.divide(parts, total, out=np.zeros_like(parts), where=total > 0).astype(np.float32)
    dominant = np.where(shares.max(axis=-1) > 0, shares.argmax(axis=-1), -1).astype(np.int8)
    labels = np.where(seen.max(axis=-1) >= 0.5, seen.argmax(axis=-1), -1).astype(np.int8)
    temperatures = np.array([spectra.cct_of(emission) for emission in scene.emission])
    corners = quads = patch_xyz = None
    if scene.chart_corners is not None and scene.patch_corners is not None:
        corners = view.pixels(scene.chart_corners)
        quads = view.pixels(scene.patch_corners)
        patch_xyz = np.stack([_inner_mean(xyz, quad) for quad in quads])
    return Truth(
        wavelengths_nm=spectra.WAVELENGTHS_NM, spectral=view.radiance() if spectral else None,
        camera_rgb=view.response(camera.responses), xyz=xyz, emitters=scene.emitters, emission=scene.emission,
        cct_k=temperatures[:, 0], duv=temperatures[:, 1], seen=seen, labels=labels, shares=shares,
        dominant=dominant, chart_corners=corners, patch_quads=quads, patch_xyz=patch_xyz,
    )  # fmt: skip


def _inner_mean(image: Float64, quad: Float64) -> Float64:
    """Return the mean, shape (3,), over the inner half of a quadrilateral of pixels; NaN if it is empty."""
    import cv2

    inner = quad.mean(axis=0) + 0.5 * (quad - quad.mean(axis=0))
    mask = np.zeros(image.shape[:2], np.uint8)
    cv2.fillConvexPoly(mask, np.round(inner).astype(np.int32), 1)
    inside = image[mask > 0]
    return np.asarray(inside.mean(axis=0)) if len(inside) else np.full(3, np.nan)


def write_truth(folder: Path, truth: Truth) -> Path:
    """Write a truth as `truth.npz` into `folder`, which is made if need be; return its path."""
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / "truth.npz"
    fields = {name: getattr(truth, name) for name in Truth.__slots__}
    fields = {name: np.asarray(value) for name, value in fields.items() if value is not None}
    np.savez_compressed(path, module=truth.module, **fields)
    return path
