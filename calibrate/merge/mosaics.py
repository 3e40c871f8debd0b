"""The merge proper: frames and what was measured of them → radiance."""

from collections.abc import Callable, Sequence
from fractions import Fraction

import numpy as np
import numpy.typing as npt

from calibrate import CalibrateError
from calibrate.exposure import BAYER_PATTERNS, MONOCHROME, FrameInfo, by_exposure, check_bracket
from calibrate.merge.defects import find_defects, replace_defects
from calibrate.merge.measure import Asked, measure_bracket
from calibrate.merge.records import Exposure, Float64, FrameUse, Measured, Merged, MosaicFrame, NoiseModel, Plane
from calibrate.merge.windows import Skip, Weighed, weigh_bracket


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
    of the frames and any number of threads. `mosaic()` of each frame is called once, and all results stay in memory
    meanwhile (2 bytes a photosite each, beside 9 of the result); of more than 12 frames, once for each window of rows, and
    at most 24 bytes a photosite stay.

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
        Called with (bands of rows done, bands).

    Raises
    ------
    CalibrateError
        What `check_bracket` finds; a mosaic that is not what its frame announced; a noise model that is not positive.
    """
    infos = [f.info for f in frames]
    warnings = list(check_bracket(infos, mixed_iso=mixed_iso, mixed_aperture=mixed_aperture))
    if measured is None:
        measured = _as_told(frames, noise, mixed_aperture=mixed_aperture)
    warnings += measured.warnings
    order = by_exposure(infos, mixed_aperture=mixed_aperture)
    frames, infos = [frames[i] for i in order], [infos[i] for i in order]
    exposures = [measured.exposures[i] for i in order]
    skips = None if ghosts is None else [ghosts[i] for i in order]
    weighed = weigh_bracket(frames, exposures, skips, progress=progress)
    mosaic, cfa, shortest = weighed.mosaic, infos[0].cfa, exposures[0]
    lost = weighed.weights == 0
    ceiling: Float64 = (shortest.clip - shortest.black) / shortest.span / shortest.light
    at = np.empty((0, 2), np.int32)
    if defects and cfa in (*BAYER_PATTERNS, MONOCHROME):
        at = find_defects(mosaic, weighed.weights, ceiling=float(ceiling.min()))
        replace_defects(mosaic, lost, at)
    lost_count = int(np.count_nonzero(lost))
    uses = _uses(infos, exposures, weighed, skips)
    return Merged(
        mosaic=mosaic,
        lost=lost,
        cfa=cfa,
        frames=uses,
        lost_count=lost_count,
        defect_count=len(at),
        defects=at,
        noise=measured.noise,
        ceiling=ceiling,
        deviation=_deviation(weighed.weights, lost) if deviation else None,
        ghosts=None if skips is None else _anywhere(skips, mosaic.shape),
        warnings=(*warnings, *_warnings(uses, lost_count, len(at), mosaic.size)),
    )


def _as_told(frames: Sequence[MosaicFrame], noise: NoiseModel | None, *, mixed_aperture: bool) -> Measured:
    """Return what the files say of themselves, under a noise model that is given or guessed."""
    if noise is not None and not (noise.gain_e_per_dn > 0 and noise.read_noise_e > 0):
        raise CalibrateError(
            f"merge: noise model with gain {noise.gain_e_per_dn:g} e-/DN and read noise {noise.read_noise_e:g} e-; "
            "both must be above 0. Leave `merge.gain_e_per_dn` and `merge.read_noise_e` out to have them measured."
        )
    told = Asked(
        clip="file",
        black="file",
        exposures="file",
        gain_e_per_dn=None if noise is None else noise.gain_e_per_dn,
        read_noise_e=None if noise is None else noise.read_noise_e,
        mixed_aperture=mixed_aperture,
        noise="file",
    )
    return measure_bracket(frames, told)


def _deviation(weights: Plane, lost: npt.NDArray[np.bool_]) -> Plane:
    """Return the standard deviation of every sample, NaN where it is lost, in the memory of the weights."""
    with np.errstate(divide="ignore"):
        sigma = np.divide(1.0, np.sqrt(weights, out=weights), out=weights)
    sigma[lost] = np.nan
    return sigma


def _uses(
    infos: Sequence[FrameInfo], exposures: Sequence[Exposure], weighed: Weighed, skips: Sequence[Skip] | None
) -> tuple[FrameUse, ...]:
    return tuple(
        FrameUse(
            name=info.name,
            exposure_s=info.exposure_s or Fraction(0),
            clipped=weighed.clipped[k],
            used=weighed.used[k],
            share=weighed.shares[k],
            light=float(np.max(exposures[k].light)) / float(info.exposure_s or 1),
            ghosts=0 if skips is None else int(np.count_nonzero(skips[k])) * 4,
        )
        for k, info in enumerate(infos)
    )


def _anywhere(skips: Sequence[Skip], shape: tuple[int, int]) -> npt.NDArray[np.bool_]:
    """Return where some frame was left out, a mask (H, columns)."""
    halves = np.maximum.reduce([s.astype(np.bool_) for s in skips])
    whole: npt.NDArray[np.bool_] = halves.repeat(2, axis=0).repeat(2, axis=1)[: shape[0], : shape[1]]
    return whole


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
