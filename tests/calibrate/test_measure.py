"""Levels, exposures and noise are those the bracket was made with; where it says nothing, nothing is changed."""

import dataclasses
from fractions import Fraction
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from calibrate import CalibrateError
from calibrate.exposure import Masked
from calibrate.merge import Asked, Measured, NoiseModel, masked_black, measure_bracket, merge_mosaics
from calibrate.merge.levels import find_plateau
from tests.calibrate.brackets import BLACK, TIMES, WHITE, photograph, scene

SHAPE = (240, 320)
# 0.3 % is what a ratio, 0.5 % what a white level has to be right to.
RATIO, LEVEL = 3e-3, 5e-3


def factors(measured: Measured) -> npt.NDArray[np.float64]:
    return np.array([r.factor if r.applied else 1.0 for r in measured.ratios])


def relative(values: npt.NDArray[np.float64], truth: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    ratio = values / truth
    return ratio / np.median(ratio) - 1


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.slow), pytest.param(3, marks=pytest.mark.slow)])
def test_faults_of_a_capture_are_measured_to_what_the_merge_needs(seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = 2 ** rng.uniform(-1 / 3, 1 / 3, len(TIMES))
    blacks, clips = rng.uniform(-3, 3, 4), np.round(rng.uniform(15000, WHITE, 4))
    gain, read = rng.uniform(0.6, 4), rng.uniform(2, 8)
    frames = photograph(
        scene(SHAPE, seed=seed), seed=seed, gain=gain, read_e=read, factors=true, blacks=blacks, clips=clips
    )
    measured = measure_bracket(frames, Asked())
    assert np.abs(relative(factors(measured), true)).max() < RATIO
    assert [f.decoded for f in frames] == [1] * len(frames)
    np.testing.assert_allclose(measured.exposures[0].clip, clips, rtol=LEVEL)
    assert (measured.exposures[0].clip <= clips).all()
    # A tenth of a count is a tenth of the read noise.
    np.testing.assert_allclose(measured.exposures[0].black, BLACK + blacks, atol=0.2)
    assert measured.black_from == "bracket"
    assert measured.noise_from == "bracket"
    assert measured.noise.gain_e_per_dn == pytest.approx(gain, rel=0.05)
    # Rounding to whole counts adds 1/12 to the variance.
    assert measured.noise.read_noise_e == pytest.approx(np.hypot(read, gain * 12**-0.5), rel=0.1)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow), pytest.param(2, marks=pytest.mark.slow)])
def test_a_capture_without_faults_is_left_as_it_is(seed: int) -> None:
    measured = measure_bracket(photograph(scene(SHAPE, seed=seed), seed=seed), Asked())
    # What is applied by chance is too small to matter.
    assert np.abs(factors(measured) - 1).max() < 1e-3
    assert abs(measured.black_shift_dn) < 0.1
    np.testing.assert_array_equal(measured.exposures[0].clip, [WHITE] * 4)
    assert measured.warnings == ()


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_measuring_makes_no_capture_worse_that_had_no_faults(seed: int) -> None:
    radiance = scene(SHAPE, seed=seed)
    frames = photograph(radiance, seed=seed + 10)
    told = merge_mosaics(frames, noise=NoiseModel(3.1, 4.0), defects=False).mosaic / radiance - 1
    seen = merge_mosaics(frames, measured=measure_bracket(frames, Asked()), defects=False).mosaic / radiance - 1
    for low in np.arange(-3.0, 2.0):
        inside = (radiance > 10**low) & (radiance < 10 ** (low + 1)) & np.isfinite(told) & np.isfinite(seen)
        if inside.sum() > 2000:
            assert np.sqrt(np.mean(seen[inside] ** 2)) < 1.01 * np.sqrt(np.mean(told[inside] ** 2))


def test_a_single_wrong_time_changes_that_frame_alone_and_is_told() -> None:
    true = np.ones(len(TIMES))
    true[2] = 2 ** (1 / 3)
    measured = measure_bracket(photograph(scene(SHAPE, seed=5), seed=5, factors=true), Asked())
    np.testing.assert_allclose(factors(measured), true, rtol=RATIO)
    (warning,) = measured.warnings
    assert warning.startswith("2.dng: the pixels say 0.07874 s, +0.33 EV") or "+0.33 EV" in warning
    assert "merge.exposure_ratios" in warning


def test_a_time_that_a_person_gave_is_kept() -> None:
    true = np.ones(len(TIMES))
    true[2] = 1.2
    frames = photograph(scene(SHAPE, seed=5), seed=5, factors=true)
    everything = measure_bracket(frames, Asked(known=frozenset(f.info.name for f in frames)))
    np.testing.assert_array_equal(factors(everything), 1.0)
    believed = measure_bracket(frames, Asked(exposures="file"))
    np.testing.assert_array_equal(factors(believed), 1.0)
    assert not any("the pixels say" in w for w in believed.warnings)


def test_something_that_moves_does_not_move_the_ratios() -> None:
    true = 2 ** np.random.default_rng(6).uniform(-0.3, 0.3, len(TIMES))
    frames = photograph(scene(SHAPE, seed=6), seed=6, factors=true)
    for n, f in enumerate(frames):
        # A dark figure of a tenth of the picture that walks through.
        f.counts[40:200, 20 + 45 * n : 70 + 45 * n] = BLACK + 20
    measured = measure_bracket(frames, Asked())
    assert np.abs(relative(factors(measured), true)).max() < RATIO


def test_light_that_changes_over_a_part_of_the_picture_is_told() -> None:
    radiance = scene(SHAPE, seed=7, low=-1.5, high=1.0)
    frames = photograph(radiance, seed=7)
    darker = radiance.copy()
    darker[:, :160] *= 0.9
    frames[3] = photograph(darker, seed=8)[3]
    measured = measure_bracket(frames, Asked())
    assert any("3.dng: its light differs by up to" in w and "flickered" in w for w in measured.warnings)
    assert not any("differs" in w for w in measure_bracket(photograph(radiance, seed=7), Asked()).warnings)


def test_a_dark_frame_pair_that_says_nothing_is_believed() -> None:
    # Nothing but read noise: no ratio, no black, no gain can be known.
    frames = photograph(np.full(SHAPE, 1e-7), TIMES[:3])
    measured = measure_bracket(frames, Asked())
    np.testing.assert_array_equal(factors(measured), 1.0)
    assert not any(r.error < 3e-3 and k != 2 for k, r in enumerate(measured.ratios[:2]))


# Levels


@pytest.mark.parametrize(("clip", "spread"), [(16383, 0.0), (15200, 0.0), (15200, 6.0), (13000, 12.0)])
def test_the_white_level_is_the_plateau_of_the_clipped_samples(clip: float, spread: float) -> None:
    frames = photograph(scene(SHAPE, seed=9), seed=9)
    rng = np.random.default_rng(9)
    for f in frames:
        levels = clip + spread * rng.standard_normal(f.counts.shape)
        f.counts[:] = np.rint(np.minimum(f.counts, levels)).astype(np.uint16)
    measured = measure_bracket(frames, Asked())
    found = measured.exposures[0].clip
    assert np.all(found <= clip)
    np.testing.assert_allclose(found, clip, rtol=LEVEL)
    told = [w for w in measured.warnings if "clip at" in w]
    assert len(told) == (1 if clip < 0.99 * WHITE else 0)
    merged = merge_mosaics(frames, measured=measured, defects=False).mosaic / scene(SHAPE, seed=9) - 1
    bright = (scene(SHAPE, seed=9) > 2) & np.isfinite(merged)
    assert abs(np.mean(merged[bright])) < 3e-3


def test_a_plateau_above_the_files_white_level_is_told_and_not_used() -> None:
    frames = photograph(scene(SHAPE, seed=9), seed=9)
    for f in frames:
        f.info = dataclasses.replace(f.info, white_dn=(15000.0,) * 4)
    measured = measure_bracket(frames, Asked())
    np.testing.assert_array_equal(measured.exposures[0].clip, [15000.0] * 4)
    assert any("above the white level 15000" in w and "merge.white_level" in w for w in measured.warnings)


@pytest.mark.parametrize("noisy", [True, False])
def test_an_evenly_lit_surface_is_no_plateau(noisy: bool) -> None:
    radiance = scene(SHAPE, seed=10, high=-0.5)
    radiance[100:200, 100:300] = 0.6  # the brightest, at 60 % of white in the longest frame, one value
    times = tuple(Fraction(4**n, 64) for n in range(4))
    frames = photograph(radiance, times, seed=10)
    if not noisy:
        for f in frames:
            value = np.rint(BLACK + 0.6 * float(f.info.exposure_s) * (WHITE - BLACK))
            f.counts[100:200, 100:300] = value
            f.counts[:] = np.minimum(f.counts, max(value, BLACK + 30))
    measured = measure_bracket(frames, Asked())
    np.testing.assert_array_equal(measured.exposures[0].clip, [WHITE] * 4)


def test_a_comb_of_counts_has_its_plateau_at_its_last_tooth() -> None:
    rng = np.random.default_rng(11)
    counts = (4 * np.minimum(np.rint(rng.uniform(0, 1400, (200, 200))), 1023)).astype(np.uint16)
    plateau = find_plateau(counts, (0, 0), (2, 2), span=4092.0)
    assert plateau is not None
    assert plateau.clip == plateau.level == 4092


def test_a_white_level_of_the_settings_is_used_or_refused() -> None:
    frames = photograph(scene(SHAPE, seed=9), seed=9)
    measured = measure_bracket(frames, Asked(clip=14000.0))
    np.testing.assert_array_equal(measured.exposures[3].clip, [14000.0] * 4)
    assert measured.clip_from == "settings"
    with pytest.raises(CalibrateError, match=r"`merge\.white_level`"):
        measure_bracket(frames, Asked(clip=100.0))


def test_masked_photosites_are_black_if_they_are_dark_and_the_same_in_every_frame() -> None:
    frames = photograph(scene(SHAPE, seed=12), seed=12, blacks=(1.0, -2.0, 0.5, 2.5))
    truth = (513.0, 510.0, 512.5, 514.5)
    for f in frames:
        f.info = dataclasses.replace(f.info, masked=Masked(truth, 1.3, 4000))
    measured = measure_bracket(frames, Asked())
    assert measured.black_from == "masked pixels"
    np.testing.assert_array_equal(measured.exposures[0].black, truth)
    frames[5].info = dataclasses.replace(frames[5].info, masked=Masked(tuple(v + 8 for v in truth), 1.3, 4000))
    lit = measure_bracket(frames, Asked())
    assert lit.black_from == "bracket"
    np.testing.assert_allclose(lit.exposures[0].black, truth, atol=0.2)


def test_a_masked_strip_gives_its_mean_unless_it_sees_light() -> None:
    rng = np.random.default_rng(13)
    blacks, whites = (510.0, 511.0, 512.0, 513.0), (16383.0,) * 4
    strip = np.empty((400, 20))
    for k in range(4):
        strip[k // 2 :: 2, k % 2 :: 2] = blacks[k] + 0.3 + 2 * rng.standard_normal((200, 10))
    strip[5, 5] = 9000
    found = masked_black([np.rint(strip).astype(np.uint16)], (2, 2), blacks, whites)
    assert found is not None
    np.testing.assert_allclose(found.black_dn, np.array(blacks) + 0.3, atol=5 * 2 / 2000**0.5)
    assert found.noise_dn == pytest.approx(2.0, rel=0.05)
    bright = np.rint(strip + 200).astype(np.uint16)
    assert masked_black([bright], (2, 2), blacks, whites) is None
    assert masked_black([np.full((400, 20), 512, np.uint16)], (2, 2), blacks, whites) is None
    assert masked_black([strip[:20].astype(np.uint16)], (2, 2), blacks, whites) is None


def test_a_dark_frame_is_black() -> None:
    frames = photograph(scene(SHAPE, seed=12), seed=12, blacks=(2.0,) * 4)
    (dark,) = photograph(np.zeros(SHAPE), TIMES[:1], seed=99, blacks=(2.0,) * 4)
    measured = measure_bracket(frames, Asked(dark=dark.counts))
    assert measured.black_from == "dark frame"
    np.testing.assert_allclose(measured.exposures[0].black, BLACK + 2, atol=0.05)
    with pytest.raises(CalibrateError, match=r"`merge\.dark_frame`"):
        measure_bracket(frames, Asked(dark=dark.counts[:-2]))


# Filters, ISO, aperture


def test_a_filter_of_declared_transmission_is_divided_out_by_colour() -> None:
    radiance = scene(SHAPE, seed=14, low=-1.0, high=0.5)
    through = (0.011, 0.010, 0.009)
    frames = photograph(radiance, TIMES[2:5], seed=14)
    dim = radiance.copy()
    for k, channel in enumerate((0, 1, 1, 2)):
        dim[k // 2 :: 2, k % 2 :: 2] *= through[channel]
    (filtered,) = photograph(dim, TIMES[2:3], seed=15, changed={0: {"transmission": through, "name": "nd.dng"}})
    merged = merge_mosaics([*frames, filtered], defects=False)
    assert merged.frames[0].name == "nd.dng"
    error = merged.mosaic / radiance - 1
    assert abs(np.nanmean(error)) < 2e-3
    alone = merge_mosaics([filtered], defects=False).mosaic / radiance - 1
    for k in range(4):
        assert abs(np.mean(alone[k // 2 :: 2, k % 2 :: 2])) < 0.01


def test_frames_of_several_iso_have_each_its_own_noise() -> None:
    radiance = scene(SHAPE, seed=16, low=-2.5, high=1.0)
    low = photograph(radiance, TIMES[1:5], seed=16, gain=3.0, read_e=6.0)
    high = photograph(radiance * 8, TIMES[1:4], seed=17, gain=3.0 / 8, read_e=2.0)
    for f in high:
        f.info = dataclasses.replace(f.info, iso=800.0, name=f"high{f.info.name}")
    measured = measure_bracket([*low, *high], Asked())
    for n, (gain, read) in enumerate([(3.0, 6.0)] * 4 + [(3.0 / 8, 2.0)] * 3):
        assert measured.exposures[n].gain_e_per_dn == pytest.approx(gain, rel=0.06)
        assert measured.exposures[n].read_noise_e == pytest.approx(np.hypot(read, gain * 12**-0.5), rel=0.12)
    merged = merge_mosaics([*low, *high], measured=measured, mixed_iso=True, defects=False)
    assert abs(np.nanmean(merged.mosaic / radiance - 1)) < 3e-3


def test_frames_of_several_apertures_are_merged_when_asked() -> None:
    radiance = scene(SHAPE, seed=18, low=-1.5, high=0.5)
    frames = photograph(radiance, TIMES[2:5], seed=18)
    (wide,) = photograph(radiance * 4, TIMES[2:3], seed=19, changed={0: {"f_number": 4.0, "name": "wide.dng"}})
    with pytest.raises(CalibrateError, match=r"`merge\.mixed_aperture: true`"):
        merge_mosaics([*frames, wide])
    measured = measure_bracket([*frames, wide], Asked(mixed_aperture=True))
    merged = merge_mosaics([*frames, wide], measured=measured, mixed_aperture=True, defects=False)
    assert abs(np.nanmean(merged.mosaic / radiance - 1)) < 3e-3


# The merge with what was measured


def test_the_deviation_is_how_far_the_result_is_off() -> None:
    radiance = scene(SHAPE, seed=20)
    frames = photograph(radiance, seed=20)
    merged = merge_mosaics(frames, measured=measure_bracket(frames, Asked()), deviation=True, defects=False)
    assert merged.deviation is not None
    np.testing.assert_array_equal(np.isnan(merged.deviation), merged.lost)
    z = (merged.mosaic - radiance) / merged.deviation
    for low in range(-3, 2):
        inside = (radiance > 10.0**low) & (radiance < 10.0 ** (low + 1)) & ~merged.lost
        if inside.sum() > 2000:
            assert np.std(z[inside]) == pytest.approx(1.0, abs=0.1)
    assert merge_mosaics(frames, defects=False).deviation is None


def ideal(frames: Any, radiance: Any, *, true: Any, blacks: Any, clips: Any, gain: float, read: float) -> Any:
    """Inverse-variance weights by one who knows every parameter and the radiance itself."""
    above, below = np.zeros(radiance.shape), np.zeros(radiance.shape)
    black, clip = np.empty(radiance.shape), np.empty(radiance.shape)
    for k in range(4):
        black[k // 2 :: 2, k % 2 :: 2] = BLACK + blacks[k]
        clip[k // 2 :: 2, k % 2 :: 2] = clips[k]
    well = gain * (WHITE - BLACK)
    for f, factor in zip(frames, true, strict=True):
        light = float(f.info.exposure_s) * factor
        weight = light**2 / (radiance * light / well + (read**2 + gain**2 / 12) / well**2)
        weight[(f.counts >= clip) | (radiance * light * (WHITE - BLACK) + black >= clip)] = 0
        above += weight * (f.counts - black) / (WHITE - BLACK) / light
        below += weight
    with np.errstate(invalid="ignore"):
        return above / below


@pytest.mark.parametrize("seed", [21, pytest.param(22, marks=pytest.mark.slow)])
def test_a_faulty_capture_is_merged_as_well_as_by_one_who_knows_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    true = 2 ** rng.uniform(-1 / 3, 1 / 3, len(TIMES))
    true /= np.sort(true)[(len(true) - 1) // 2]  # only ratios can be known
    blacks, clips = rng.uniform(-3, 3, 4), np.round(rng.uniform(15000, WHITE, 4))
    radiance = scene((400, 600), seed=seed)
    frames = photograph(radiance, seed=seed, factors=true, blacks=blacks, clips=clips)
    merged = merge_mosaics(frames, measured=measure_bracket(frames, Asked()), defects=False)
    best = ideal(frames, radiance, true=true, blacks=blacks, clips=clips, gain=3.1, read=4.0) / radiance - 1
    error = merged.mosaic / radiance - 1
    for low in range(-3, 2):
        inside = (radiance > 10.0**low) & (radiance < 10.0 ** (low + 1)) & np.isfinite(error) & np.isfinite(best)
        if inside.sum() < 3000:
            continue
        rmse, best_rmse = (float(np.sqrt(np.mean(e[inside] ** 2))) for e in (error, best))
        assert rmse < 1.03 * best_rmse, low
        assert abs(np.mean(error[inside])) < 3e-3 + 3 * best_rmse / inside.sum() ** 0.5, low


def test_noise_that_is_not_positive_is_refused() -> None:
    frames = photograph(scene((40, 40), seed=1), TIMES[:2])
    with pytest.raises(CalibrateError, match="gain_e_per_dn is 0"):
        measure_bracket(frames, Asked(gain_e_per_dn=0.0))
    with pytest.raises(CalibrateError, match="read_noise_e is -1"):
        measure_bracket(frames, Asked(read_noise_e=-1.0))
