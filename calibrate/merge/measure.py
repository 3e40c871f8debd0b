"""What a bracket tells about itself before it is merged: levels, exposures, noise.

Nothing measured is used unless it is known well and differs from what the file says by more than it is uncertain; a
bracket that says nothing is merged as its files tell.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calibrate import CalibrateError
from calibrate.exposure import FrameInfo
from calibrate.merge.joint import Joint, Sites, fit_jointly
from calibrate.merge.levels import dark_levels
from calibrate.merge.noise import guess_noise
from calibrate.merge.records import Counts, Exposure, Float64, Measured, MosaicFrame, NoiseModel, Ratio
from calibrate.merge.survey import Levels, black_groups, survey

# A ratio is used if it is known this well (logarithm), and departs by more than `_TELLING` and `_SURE` standard errors.
_KNOWN, _TELLING, _SURE = 3e-3, 5e-4, 4.0

# Shutters keep their nominal time to about a sixth of a stop; more is worth a word.
NOTABLE_EV = 1.0 / 6.0

# A shift of black larger than this share of the range is not one.
_LARGEST_SHIFT = 2e-3

# Masked photosites may differ between the frames by this share of the range; more is light, or an amplifier's glow.
_MASKED_DRIFT = 2e-4

# Residuals that are so many times what noise explains mean that the scene itself was not the same.
_UNEXPLAINED = 3.0

# Light that differs by this between tiles is worth a word.
_NOTABLE_UNEVEN = 0.02

# A gain and a read noise that are known worse than this are guessed instead.
_NOISE_KNOWN = 0.15

# Largest and smallest gain, in electrons at the white level at ISO 100, that a camera can have.
_WELLS = (500.0, 2_000_000.0)


@dataclass(frozen=True, slots=True)
class Asked:
    """How much of a bracket to measure, and what a person knows better.

    Attributes
    ----------
    clip
        "data", "file", or the level in raw counts.
    black
        "data" (masked photosites, else the bracket itself), or "file".
    dark
        A mosaic exposed under a lens cap; its levels are black.
    exposures
        "data" or "file".
    known
        Names of the frames whose exposure a person has given.
    gain_e_per_dn, read_noise_e
        Gain at the lowest ISO, and read noise; None where not known.
    noise
        What is not known of the noise is measured ("data") or guessed ("file").
    """

    clip: Literal["data", "file"] | float = "data"
    black: Literal["data", "file"] = "data"
    dark: Counts | None = None
    exposures: Literal["data", "file"] = "data"
    known: frozenset[str] = frozenset()
    gain_e_per_dn: float | None = None
    read_noise_e: float | None = None
    noise: Literal["data", "file"] = "data"
    mixed_aperture: bool = False

    @property
    def nothing(self) -> bool:
        """Whether everything is believed as told, so that no frame need be decoded."""
        told = self.clip != "data" and self.black == "file" and self.exposures == "file"
        return told and (self.noise == "file" or (self.gain_e_per_dn is not None and self.read_noise_e is not None))


AS_TOLD = Asked(clip="file", black="file", exposures="file", noise="file")


def measure_bracket(
    frames: Sequence[MosaicFrame],
    asked: Asked = AS_TOLD,
    *,
    progress: Callable[[int, int], None] | None = None,
) -> Measured:
    """Return levels, exposures and noise of a bracket that `check_bracket` has accepted.

    Each frame is decoded once, from the longest to the shortest, unless nothing is to be measured.

    Raises
    ------
    CalibrateError
        A noise that is not positive, a clipping level outside the range, a dark frame of another size.
    """
    infos = [f.info for f in frames]
    lowest = min(infos, key=lambda f: f.iso or 100.0)
    guess = guess_noise(lowest)
    given = NoiseModel(asked.gain_e_per_dn or guess.gain_e_per_dn, asked.read_noise_e or guess.read_noise_e)
    _refuse(asked, infos)
    light = nominal_light(infos, mixed_aperture=asked.mixed_aperture)
    black = np.array([f.black_dn for f in infos], np.float64)
    white = np.array([f.white_dn for f in infos], np.float64)
    levels = Levels(black.copy(), white.copy())
    _black_of(levels, infos, asked)
    if isinstance(asked.clip, (int, float)):
        levels.clip[:] = float(asked.clip)
        levels.clip_from = "settings"
    ratios = [Ratio(1.0, math.inf, False, 0.0)] * len(infos)
    noises = [_at_iso(given, f, lowest) for f in infos]
    noise_from = "settings" if asked.gain_e_per_dn and asked.read_noise_e else "guess"
    shift = 0.0
    if not asked.nothing:
        sites = survey(frames, infos, levels, light, plateaus=asked.clip == "data", progress=progress)
        joint = _fit(sites, infos, light, levels, noises, asked)
        ratios = _ratios(joint, infos, asked, levels.warnings)
        shift = _shift_black(joint, levels, infos, asked)
        noises, noise_from = _noises(joint, infos, noises, asked)
    first = noises[infos.index(lowest)]
    factors = np.array([r.factor if r.applied else 1.0 for r in ratios])
    exposures = tuple(
        Exposure(light[k] * factors[k], levels.black[k], levels.clip[k], white[k] - levels.black[k], *noises[k])
        for k in range(len(infos))
    )
    return Measured(
        tuple(f.name for f in infos),
        exposures,
        tuple(ratios),
        NoiseModel(*first),
        noise_from,
        levels.black_from,
        levels.clip_from,
        shift or float(np.mean(levels.black - black)),
        tuple(levels.warnings),
    )


def nominal_light(infos: Sequence[FrameInfo], *, mixed_aperture: bool = False) -> Float64:
    """Return the light of each frame by position, shape (N, P): seconds × ISO / lowest × transmission (× area / largest)."""
    lowest = min(f.iso or 100.0 for f in infos)
    smallest = max((f.f_number or 0.0) for f in infos)
    out = np.empty((len(infos), len(infos[0].cfa)))
    for k, f in enumerate(infos):
        if f.exposure_s is None:
            raise AssertionError("check_bracket lets no frame without an exposure pass")
        whole = float(f.exposure_s) * (f.iso or 100.0) / lowest
        if mixed_aperture and f.f_number:
            whole *= (smallest / f.f_number) ** 2
        out[k] = [whole * (sum(f.transmission) / 3 if c == "W" else f.transmission["RGB".index(c)]) for c in f.cfa]
    return out


def _refuse(asked: Asked, infos: Sequence[FrameInfo]) -> None:
    for value, name in ((asked.gain_e_per_dn, "gain_e_per_dn"), (asked.read_noise_e, "read_noise_e")):
        if value is not None and not value > 0:
            raise CalibrateError(f"merge: {name} is {value:g}; it must be above 0. Leave it out to have it measured.")
    if isinstance(asked.clip, (int, float)):
        for f in infos:
            if not max(f.black_dn) < asked.clip <= 65535:
                raise CalibrateError(
                    f"{f.name}: white level {asked.clip:g} from the settings; above the black level {max(f.black_dn):g} and "
                    "at most 65535 is expected. Correct `merge.white_level`."
                )
    if asked.dark is not None and asked.dark.shape != (infos[0].height, infos[0].columns):
        raise CalibrateError(
            f"dark frame of shape {asked.dark.shape}; ({infos[0].height}, {infos[0].columns}) is expected. Give "
            "`merge.dark_frame` a frame of the same camera, exposed under the lens cap."
        )


def _black_of(levels: Levels, infos: Sequence[FrameInfo], asked: Asked) -> None:
    if asked.dark is not None:
        levels.black[:] = dark_levels(asked.dark, infos[0])
        levels.black_from = "dark frame"
    elif asked.black == "data" and all(f.masked is not None for f in infos):
        masked = np.array([f.masked.black_dn for f in infos if f.masked is not None])
        # A border that sees light is brighter in the longer frames; alone, a frame must be believed to be near the file.
        span = float(np.mean(levels.clip - levels.black))
        apart = np.ptp(masked, axis=0) if len(infos) > 1 else np.abs(masked - levels.black)
        if apart.max() <= _MASKED_DRIFT * span:
            levels.black[:] = masked
            levels.black_from = "masked pixels"


def _at_iso(noise: NoiseModel, info: FrameInfo, lowest: FrameInfo) -> tuple[float, float]:
    return noise.gain_e_per_dn * (lowest.iso or 100.0) / (info.iso or 100.0), noise.read_noise_e


def _fit(
    sites: Sites,
    infos: Sequence[FrameInfo],
    light: Float64,
    levels: Levels,
    noises: Sequence[tuple[float, float]],
    asked: Asked,
) -> Joint:
    gain = np.array([g for g, _ in noises])
    read_dn = np.array([r / g for g, r in noises])
    isos = sorted({f.iso or 100.0 for f in infos})
    classes = np.array([isos.index(f.iso or 100.0) for f in infos])
    fixed = np.array([asked.exposures == "file" or f.name in asked.known for f in infos])
    with_noise = asked.noise == "data" and (asked.gain_e_per_dn is None or asked.read_noise_e is None)
    return fit_jointly(
        sites,
        light=light,
        black=levels.black,
        clip=levels.clip,
        gain=gain,
        read_dn=read_dn,
        iso_class=classes,
        fixed=fixed,
        with_noise=with_noise,
    )


def _ratios(joint: Joint, infos: Sequence[FrameInfo], asked: Asked, warnings: list[str]) -> list[Ratio]:
    """Set the gauge and decide which factors to use.

    Only ratios can be measured. The frame in the middle of what was measured is taken to be as long as it says: with one
    frame wrong, only that one changes.
    """
    known = joint.light_error < _KNOWN
    free = np.array([asked.exposures == "data" and f.name not in asked.known for f in infos])
    middle = 0.0
    if known.any() and free.all():
        middle = float(np.sort(joint.log_light[known])[(int(known.sum()) - 1) // 2])
    out = []
    for k, info in enumerate(infos):
        change, error = float(joint.log_light[k]) - middle, float(joint.light_error[k])
        telling = bool(known[k] and free[k] and abs(change) > max(_TELLING, _SURE * error))
        out.append(Ratio(math.exp(change) if known[k] else 1.0, error, telling, float(joint.uneven[k])))
        if telling and abs(change) > NOTABLE_EV * math.log(2):
            said = float(info.exposure_s or 0)
            warnings.append(
                f"{info.name}: the pixels say {said * math.exp(change):.4g} s, {change / math.log(2):+.2f} EV from the "
                f"{info.exposure_s} s of the file; the pixels are believed. If the light changed between the frames, leave "
                "this one out; if the file is right, set `merge.exposure_ratios: file`."
            )
        if joint.uneven[k] > _NOTABLE_UNEVEN and known[k]:
            warnings.append(
                f"{info.name}: its light differs by up to {joint.uneven[k]:.0%} between parts of the picture; at most "
                f"{_NOTABLE_UNEVEN:.0%} is expected. The light flickered or changed, or something large moved: leave the "
                "frame out, or photograph again with times that are multiples of the mains period."
            )
    return out


def _shift_black(joint: Joint, levels: Levels, infos: Sequence[FrameInfo], asked: Asked) -> float:
    """Move black by what the fit says where no better witness exists; return the mean shift."""
    span = float(np.mean(levels.clip - levels.black))
    if asked.black != "data" or levels.black_from != "file" or joint.spread > _UNEXPLAINED:
        return 0.0
    sure = np.abs(joint.black_shift) > np.maximum(_SURE * joint.black_error, 2e-6 * span)
    sure &= np.abs(joint.black_shift) < _LARGEST_SHIFT * span
    if not sure.any():
        return 0.0
    shift = np.where(sure, joint.black_shift, 0.0)[black_groups(infos[0].cfa)]
    levels.black += shift
    levels.black_from = "bracket"
    return float(shift.mean())


def _noises(
    joint: Joint, infos: Sequence[FrameInfo], given: Sequence[tuple[float, float]], asked: Asked
) -> tuple[list[tuple[float, float]], str]:
    """Return gain and read noise (electrons) of every frame, and where they come from."""
    isos = sorted({f.iso or 100.0 for f in infos})
    out, measured = list(given), False
    for k, info in enumerate(infos):
        found = joint.noise[isos.index(info.iso or 100.0)]
        gain, read = given[k]
        if found is not None:
            new_gain, gain_error, read_dn, read_error = found
            well = new_gain * float(np.mean(info.white_dn) - np.mean(info.black_dn)) * (info.iso or 100.0) / 100.0
            if asked.gain_e_per_dn is None and gain_error < _NOISE_KNOWN and _WELLS[0] < well < _WELLS[1]:
                gain, measured = new_gain, True
            if asked.read_noise_e is None and read_error < _NOISE_KNOWN:
                read, measured = read_dn * gain, True
        if asked.read_noise_e is None and info.masked is not None and info.masked.noise_dn > 0:
            read = info.masked.noise_dn * gain
        out[k] = gain, read
    given_all = asked.gain_e_per_dn is not None and asked.read_noise_e is not None
    return out, "bracket" if measured else "settings" if given_all else "guess"
