"""The merge proper: frames and what was measured of them → radiance."""

from collections.abc import Callable, Sequence
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.exposure import BAYER_PATTERNS, MONOCHROME, by_exposure, check_bracket
from calibrate.merge.defects import find_defects, replace_defects
from calibrate.merge.measure import Asked, decoded, measure_bracket
from calibrate.merge.records import Exposure, Float64, FrameUse, Measured, Merged, MosaicFrame, NoiseModel, Plane
from calibrate.merge.weights import gather, weigh

# A frame's share in the result is measured on about this many photosites.
_SHARE_SAMPLES = 1 << 16

Skip = npt.NDArray[np.uint8]
_NONE = np.zeros((0, 0), np.uint8)


def merge_mosaics(
    frames: Sequence[MosaicFrame],
    *,
    noise: NoiseModel | None = None,
    measured: Measured | None = None,
    defects: bool = True,
    mixed_iso: bool = False,
    mixed_aperture: bool = False,
    deviation: bool = False,
    ghosts: Sequence[Skip] | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Merged:
    """Return the radiance that best explains a bracket of mosaics.

    Each sample is weighted by its inverse variance under the noise model. A sample at or above the clipping level weighs
    exactly nothing. So does a sample that is not clipped by luck only: where the frames together expect it within about
    one σ of the clipping level, or above. (Choosing by the sample's own value keeps the low ones: −0.25 σ at the clipping
    level; this: −0.06 σ.) The shortest frame that is not clipped is always used. A pixel clipped in every frame is NaN,
    and counted.

    The frames are sorted by exposure first, and no sum runs across threads: the result is bit-identical for any order
    of the frames and any number of threads. `mosaic()` of each frame is called twice, from the longest to the shortest
    and back, and its result dropped at once. Peak memory is 18 bytes a photosite (four float32 planes and one uint16
    mosaic), however many frames there are, plus what `mosaic()` itself needs.

    Parameters
    ----------
    frames
        In any order; one scene.
    noise
        At the lowest ISO of the bracket, where `measured` is not given; None takes `guess_noise`.
    measured
        Levels, exposures and noise, from `measure_bracket` of the same frames in the same order; None takes the file's.
    defects
        Replace single photosites that stand out as no optical image can (see `find_defects`); on Bayer and monochrome
        mosaics.
    mixed_iso, mixed_aperture
        Let the ISO or the aperture differ; radiance is then in units of the lowest ISO, and of the smallest aperture.
    deviation
        Return the standard deviation of every sample too.
    ghosts
        One mask a frame, in the order of `frames`: shape (⌈H/2⌉, ⌈columns/2⌉), uint8, 1 where a 2×2 of it is left out.
        A sample that would be left out of every frame that does not clip is kept in the one that `ghosts` keeps.
    progress
        Called with (frames decoded, frames to decode).

    Raises
    ------
    CalibrateError
        What `check_bracket` finds; a mosaic that is not what its frame announced; a noise model that is not positive.
    """
    infos = [f.info for f in frames]
    warnings = list(check_bracket(infos, mixed_iso=mixed_iso, mixed_aperture=mixed_aperture))
    if noise is not None and not (noise.gain_e_per_dn > 0 and noise.read_noise_e > 0):
        raise CalibrateError(
            f"merge: noise model with gain {noise.gain_e_per_dn:g} e-/DN and read noise {noise.read_noise_e:g} e-; "
            "both must be above 0. Leave `merge.gain_e_per_dn` and `merge.read_noise_e` out to have them measured."
        )
    if measured is None:
        told = Asked(
            clip="file",
            black="file",
            exposures="file",
            gain_e_per_dn=None if noise is None else noise.gain_e_per_dn,
            read_noise_e=None if noise is None else noise.read_noise_e,
            mixed_aperture=mixed_aperture,
            noise="file",
        )
        measured = measure_bracket(frames, told)
    warnings += measured.warnings
    order = by_exposure(infos, mixed_aperture=mixed_aperture)
    frames, infos = [frames[i] for i in order], [infos[i] for i in order]
    exposures = [measured.exposures[i] for i in order]
    skips = [_NONE if ghosts is None else ghosts[i] for i in order]
    shape = infos[0].height, infos[0].columns
    weighted, weights, clipped, used, share = _two_passes(frames, exposures, skips, progress)
    lost = weights == 0
    np.divide(weighted, weights, out=weighted, where=~lost)
    weighted[lost] = np.nan
    mosaic = weighted
    ceiling = _ceiling(exposures[0].light, exposures[0].clip, exposures[0].black, exposures[0].span)
    at = np.empty((0, 2), np.int32)
    cfa = infos[0].cfa
    if defects and cfa in (*BAYER_PATTERNS, MONOCHROME):
        at = find_defects(mosaic, weights, ceiling=float(ceiling.min()))
        replace_defects(mosaic, lost, at)
    sigma = None
    if deviation:
        with np.errstate(divide="ignore"):
            sigma = np.divide(1.0, np.sqrt(weights, out=weights), out=weights)
        sigma[lost] = np.nan
    lost_count = int(lost.sum())
    uses = tuple(
        FrameUse(
            info.name,
            info.exposure_s or Fraction(0),
            c,
            u,
            s,
            float(np.max(e.light)) / float(info.exposure_s or 1),
            int(np.count_nonzero(g)) * 4,
        )
        for info, e, c, u, s, g in zip(infos, exposures, clipped, used, share.shares(), skips, strict=True)
    )
    warnings += _warnings(uses, lost_count, len(at), mosaic.size)
    moved = None
    if ghosts is not None:
        moved = _whole(np.maximum.reduce([s.astype(np.bool_) for s in skips]), shape)
    return Merged(
        mosaic, lost, cfa, uses, lost_count, len(at), at, measured.noise, ceiling, sigma, moved, tuple(warnings)
    )


def _two_passes(
    frames: Sequence[MosaicFrame],
    exposures: Sequence[Exposure],
    skips: Sequence[Skip],
    progress: Callable[[int, int], None] | None,
) -> tuple[Plane, Plane, list[int], list[int], "_Shares"]:
    """Return Σ weight × radiance, Σ weight, clipped and used samples by frame, and the frames' shares."""
    info = frames[0].info
    columns, shape, steps = info.period[1], (info.height, info.columns), 2 * len(frames)
    first, squares = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    clipped = [0] * len(frames)
    for done, k in enumerate(reversed(range(len(frames)))):
        rows, e = np.zeros(shape[0], np.int64), exposures[k]
        gather(decoded(frames[k]), columns, e.black, e.clip, e.span, e.light, skips[k], first, squares, rows)
        clipped[k] = int(rows.sum())
        if progress:
            progress(done + 1, steps)

    weighted, weights = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    share = _Shares(shape)
    used = []
    for k, (frame, e) in enumerate(zip(frames, exposures, strict=True)):
        rows = np.zeros(shape[0], np.int64)
        electrons = e.gain_e_per_dn * e.span
        read = (e.read_noise_e / electrons) ** 2
        weigh(
            decoded(frame), columns, e.black, e.clip, e.span, e.light, electrons, read, skips[k], first, squares,
            weighted, weights, rows,
        )  # fmt: skip
        used.append(int(rows.sum()))
        share.add(weights)
        if progress:
            progress(len(frames) + k + 1, steps)
    return weighted, weights, clipped, used, share


def _ceiling(light: Float64, clip: Float64, black: Float64, span: Float64) -> Float64:
    ceiling: Float64 = (clip - black) / span / light
    return ceiling


def _whole(halves: npt.NDArray[np.bool_], shape: tuple[int, int]) -> npt.NDArray[np.bool_]:
    whole: npt.NDArray[np.bool_] = halves.repeat(2, axis=0).repeat(2, axis=1)[: shape[0], : shape[1]]
    return whole


class _Shares:
    """Follows how the weights of a regular sample of the pixels grow from frame to frame."""

    def __init__(self, shape: tuple[int, int]) -> None:
        # An odd step visits all positions of the 2×2.
        self._step = max(1, int((shape[0] * shape[1] / _SHARE_SAMPLES) ** 0.5)) | 1
        self._sums: list[Plane] = []

    def add(self, weights: Plane) -> None:
        self._sums.append(weights[:: self._step, :: self._step].copy())

    def shares(self) -> list[float]:
        total = self._sums[-1].astype(np.float64)
        valid = total > 0
        if not valid.any():
            return [0.0] * len(self._sums)
        parts = [float(np.mean(s[valid] / total[valid])) for s in self._sums]
        return [b - a for a, b in zip([0.0, *parts], parts, strict=False)]


def _warnings(uses: Sequence[FrameUse], lost: int, defects: int, pixels: int) -> list[str]:
    out = []
    if lost:
        shortest = uses[0]
        out.append(
            f"{shortest.name}: {lost} photosites ({lost / pixels:.2g} of all) are clipped even in this, the shortest "
            f"exposure ({shortest.exposure_s} s), and are lost. Add a shorter exposure to the bracket if they matter."
        )
    out += [
        f"{use.name}: no sample of it was used ({use.clipped / pixels:.0%} clipped); it should add to the bracket. "
        "Remove it from `capture.reference` or `capture.environment`."
        for use in uses
        if use.used == 0
    ]
    if defects > 1e-3 * pixels:
        out.append(
            f"{uses[-1].name}: {defects} photosites ({defects / pixels:.2g} of all) were taken for defects and "
            "replaced; a sensor has fewer than 1 in 1000. If the scene has single bright points, set "
            "`merge.defects: false`."
        )
    return out
