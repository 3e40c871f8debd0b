"""Merging: right without noise, near the ideal with it, blind to what is clipped, and the same on every machine."""

import dataclasses
import tracemalloc
import weakref
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import cv2
import numba
import numpy as np
import numpy.typing as npt
import pytest

from calibrate import CalibrateError
from calibrate.exposure import FrameInfo
from calibrate.merge import Merged, MosaicFrame, NoiseModel, guess_noise, merge_mosaics, windows

Counts = npt.NDArray[np.uint16]
Radiance = npt.NDArray[np.float64]

WHITE, BLACK = 16383.0, 512.0
SPAN = WHITE - BLACK
# SCIENCE's table setting: a well of 50 000 e-, 3 e- of read noise, five frames 2 EV apart.
WELL_E, READ_E = 50_000.0, 3.0
NOISE = NoiseModel(WELL_E / SPAN, READ_E)
TIMES = tuple(Fraction(4**n, 256) for n in range(5))

# Two sums and their quotient in float32.
ROUNDING = 4 * 2.0**-23


class Frame:
    """A frame that hands out copies, so that the mosaics alive at a time can be counted."""

    def __init__(self, info: FrameInfo, counts: Counts) -> None:
        self.info = info
        self.counts = counts
        self.alive: list[weakref.ref[Counts]] = []

    def mosaic(self) -> Counts:
        handed = self.counts.copy()
        self.alive.append(weakref.ref(handed))
        return handed


def info_of(exposure: Fraction, shape: tuple[int, int], **changed: Any) -> FrameInfo:
    info = FrameInfo(
        name=f"{exposure.numerator}_{exposure.denominator}.dng",
        exposure_s=exposure,
        iso=100.0,
        f_number=8.0,
        camera="Maker One",
        lens="",
        width=shape[1],
        height=shape[0],
        cfa="RGGB",
        black_dn=(BLACK,) * 4,
        white_dn=(WHITE,) * 4,
        bits=14,
    )
    return dataclasses.replace(info, **changed)


def exposed(
    radiance: Radiance, times: Sequence[Fraction] = TIMES, *, seed: int | None = 0, **changed: Any
) -> list[Frame]:
    """The forward model: shot noise, read noise, rounding, clipping; no noise and no rounding up if seed is None."""
    rng = np.random.default_rng(seed)
    frames = []
    for time in times:
        signal = radiance * float(time)
        if seed is not None:
            electrons = rng.poisson(np.clip(signal, 0, 4) * WELL_E) + READ_E * rng.standard_normal(radiance.shape)
            signal = electrons / WELL_E
        counts = np.clip(np.rint(signal * SPAN + BLACK), 0, WHITE).astype(np.uint16)
        frames.append(Frame(info_of(time, radiance.shape, **changed), counts))
    return frames


def smooth(shape: tuple[int, int], low: float, high: float, seed: int = 1) -> Radiance:
    """A ramp over decades with soft texture in every colour, as a lens would leave it."""
    rng = np.random.default_rng(seed)
    ramp = 10 ** np.linspace(low, high, shape[1])[None, :]
    colours = [cv2.GaussianBlur(rng.random(shape), (0, 0), 1.5) for _ in range(3)]
    out = np.empty(shape)
    for k, colour in enumerate((0, 1, 1, 2)):
        out[k // 2 :: 2, k % 2 :: 2] = colours[colour][k // 2 :: 2, k % 2 :: 2]
    return ramp * (0.6 + 0.8 * out)


def assert_same(a: Merged, b: Merged) -> None:
    np.testing.assert_array_equal(a.mosaic, b.mosaic)
    np.testing.assert_array_equal(a.lost, b.lost)
    assert [(f.name, f.clipped, f.used, f.share) for f in a.frames] == [
        (f.name, f.clipped, f.used, f.share) for f in b.frames
    ]


def test_without_noise_the_radiance_comes_back_exact() -> None:
    # Radiances whose counts are whole numbers in the shortest frame, so in every longer one too.
    steps = np.random.default_rng(2).integers(0, 15_870, (40, 50))
    radiance = steps / SPAN / float(TIMES[0])
    merged = merge_mosaics(exposed(radiance, seed=None), defects=False)
    np.testing.assert_allclose(merged.mosaic, radiance, rtol=ROUNDING, atol=0)
    assert merged.lost_count == 0


def test_black_and_white_belong_to_their_positions() -> None:
    blacks, whites = (100.0, 200.5, 300.0, 400.25), (4000.0, 8000.0, 12000.0, 16000.0)
    steps = np.random.default_rng(3).integers(1, 200, (12, 14))
    frames = []
    for time in (Fraction(1, 8), Fraction(1)):
        counts = np.empty(steps.shape, np.uint16)
        expected = np.empty(steps.shape)
        for k in range(4):
            place = np.s_[k // 2 :: 2, k % 2 :: 2]
            counts[place] = np.ceil(blacks[k]) + steps[place] * int(8 * time)
            expected[place] = steps[place] * 8 / (whites[k] - blacks[k])
        frames.append(Frame(info_of(time, steps.shape, black_dn=blacks, white_dn=whites), counts))
    merged = merge_mosaics(frames, defects=False)
    # Position (0, 1) and (1, 1) stand a fraction of a count above black.
    offset = np.array([[0, 0.5], [0, 0.75]])[np.arange(12) % 2][:, np.arange(14) % 2]
    scale = np.array([[3900, 7799.5], [11700, 15599.75]])[np.arange(12) % 2][:, np.arange(14) % 2]
    error = np.abs(merged.mosaic - expected)
    assert np.all(error <= offset / scale * 8 + 1e-6)
    np.testing.assert_allclose(merged.mosaic[0::2, 0::2], expected[0::2, 0::2], rtol=1e-6)


def slow_merge(frames: Sequence[Frame], noise: NoiseModel) -> npt.NDArray[np.float64]:
    """The same estimator, pixel by pixel and frame by frame, in double precision."""
    frames = sorted(frames, key=lambda f: f.info.exposure_s or 0)
    height, width = frames[0].counts.shape
    out = np.full((height, width), np.nan)
    well = noise.gain_e_per_dn * SPAN
    dark = (noise.read_noise_e / well) ** 2
    for y in range(height):
        for x in range(width):
            seen = [
                (float(f.info.exposure_s or 0), (float(f.counts[y, x]) - BLACK) / SPAN)
                for f in frames
                if f.counts[y, x] < WHITE
            ]
            if not seen:
                continue
            first = max(sum(t * s for t, s in seen) / sum(t * t for t, _ in seen), 0.0)
            above = below = 0.0
            for k, (t, s) in enumerate(seen):
                own = first * t / well + dark
                if k > 0 and first * t > 0.5:
                    rest = seen[:k] + seen[k + 1 :]
                    square = sum(u * u for u, _ in rest)
                    told = t * sum(u * v for u, v in rest) / square
                    ratio = t / square**0.5
                    borrowed = ratio * first * t / well + ratio**2 * dark
                    both = (s / own + told / borrowed) / (1 / own + 1 / borrowed)
                    if both + 2 * own * borrowed**0.5 / (own + borrowed) >= 1:
                        continue
                above += t * s / own
                below += t * t / own
            out[y, x] = above / below
    return out


@pytest.mark.parametrize(
    "times",
    [
        TIMES,
        # Thirds of a stop: a longer frame may see what a shorter one clips.
        tuple(Fraction(round(1000 * 2 ** (n / 3)), 64_000) for n in range(6)),
        # 14 EV apart: the sums of the short frame are lost in the rounding of the long one's.
        (Fraction(1, 65_536), Fraction(1, 4)),
        (Fraction(1, 32_768), Fraction(1, 16_384), Fraction(1), Fraction(2)),
    ],
)
def test_it_is_what_a_slow_obvious_loop_says(times: tuple[Fraction, ...]) -> None:
    # Odd sides, so that a row ends within a pattern.
    radiance = 10 ** np.random.default_rng(4).uniform(-4, np.log10(2 / float(times[0])), (31, 41))
    frames = exposed(radiance, times, seed=4)
    merged = merge_mosaics(frames, noise=NOISE, defects=False)
    expected = slow_merge(frames, NOISE)
    # Sums in float32 against double; radiances near zero are differences of larger sums.
    np.testing.assert_allclose(merged.mosaic, expected, rtol=3e-6, atol=1e-9)
    assert merged.lost_count == int(np.isnan(expected).sum()) > 0


def ideal(frames: Sequence[Frame], radiance: Radiance, *, expect: bool = True) -> Radiance:
    """Inverse-variance weights from the radiance itself, which no estimator knows; nor does one know what is expected."""
    above, below = np.zeros(radiance.shape), np.zeros(radiance.shape)
    for f in frames:
        time = float(f.info.exposure_s or 0)
        weight = time**2 / (radiance * time / WELL_E + (READ_E / WELL_E) ** 2)
        weight[(f.counts >= WHITE) | (expect & (radiance * time >= 1))] = 0
        above += weight * (f.counts - BLACK) / SPAN / time
        below += weight
    return above / below


@pytest.mark.parametrize("decade", range(-4, 2))
def test_noise_and_bias_are_those_of_an_estimator_that_knows_the_radiance(decade: int) -> None:
    # 100 000 pixels a decade: an RMSE is known to 0.3 %, the mean to 1/300 of the RMSE.
    radiance = 10 ** np.random.default_rng(decade + 9).uniform(decade, decade + 1, (250, 400))
    frames = exposed(radiance, seed=decade + 9)
    merged = merge_mosaics(frames, noise=NOISE, defects=False)
    error = merged.mosaic / radiance - 1
    best = ideal(frames, radiance) / radiance - 1
    rmse, best_rmse = np.sqrt(np.mean(error**2)), np.sqrt(np.mean(best**2))
    assert rmse < 1.03 * best_rmse
    assert abs(np.mean(error)) < 3 * best_rmse / 300


def test_the_figures_of_the_table_setting_are_reached() -> None:
    # 120 000 pixels: known to 0.2 %. RMSE of inverse-variance weights from the darkest decade to the brightest: 25.9, 8.4, 2.46, 0.77 %, where decades
    # end at clipping of the longest frame; the first depends on where in its decade the darkest pixel lies.
    for decade, expected in ((-3, 0.084), (-2, 0.0246), (-1, 0.0077)):
        radiance = 10 ** np.random.default_rng(5).uniform(decade, decade + 1, (300, 400))
        merged = merge_mosaics(exposed(radiance, seed=6), noise=NOISE, defects=False)
        assert np.sqrt(np.mean((merged.mosaic / radiance - 1) ** 2)) == pytest.approx(expected, rel=0.03)


def test_choosing_samples_near_clipping_does_not_darken_the_mean() -> None:
    # Just around the white level of the fourth frame; a choice by the sample's own value would keep the low ones.
    edge = 1 / float(TIMES[3])
    radiance = np.random.default_rng(8).uniform(0.995 * edge, 1.005 * edge, (250, 400))
    frames = exposed(radiance, seed=8)
    one_sigma = 1 / np.sqrt(WELL_E)
    error = merge_mosaics(frames, noise=NOISE, defects=False).mosaic / radiance - 1
    assert abs(np.mean(error)) < 0.1 * one_sigma
    naive = ideal(frames, radiance, expect=False) / radiance - 1
    assert np.mean(naive) < -0.2 * one_sigma


def test_a_clipped_sample_has_no_influence_at_all() -> None:
    radiance = 10 ** np.random.default_rng(10).uniform(-2, 2.2, (40, 60))
    frames = exposed(radiance, seed=10)
    before = merge_mosaics(frames, noise=NOISE)
    rng = np.random.default_rng(11)
    for f in frames:
        clipped = f.counts >= WHITE
        f.counts[clipped] = rng.integers(WHITE, 65536, int(clipped.sum()))
    assert sum(f.clipped for f in before.frames) > 1000
    assert_same(before, merge_mosaics(frames, noise=NOISE))


def test_order_of_frames_and_number_of_threads_change_no_bit() -> None:
    radiance = smooth((60, 80), -3, 2)
    frames = exposed(radiance, seed=12)
    reference = merge_mosaics(frames)
    assert_same(reference, merge_mosaics([frames[k] for k in (3, 0, 4, 2, 1)]))
    threads = numba.get_num_threads()
    try:
        numba.set_num_threads(1)
        assert_same(reference, merge_mosaics(frames))
    finally:
        numba.set_num_threads(threads)


def many(shape: tuple[int, int], count: int) -> list[Frame]:
    """A bracket of exposures 1/3 EV apart; all frames share one array, as files on a disk would."""
    counts = exposed(smooth(shape, -2, 0), [Fraction(1, 64)])[0].counts
    times = [Fraction(round(1e6 * 2 ** (k / 3)), 10**8) for k in range(count)]
    return [Frame(info_of(t, shape), counts) for t in times]


def test_each_mosaic_is_decoded_once_and_none_is_held_afterwards() -> None:
    frames = exposed(smooth((20, 30), -2, 1))
    merge_mosaics(frames)
    assert [len(f.alive) for f in frames] == [1] * len(frames)
    assert not any(r() is not None for f in frames for r in f.alive)


def test_a_long_bracket_is_merged_in_windows_to_the_same_values(monkeypatch: pytest.MonkeyPatch) -> None:
    frames = exposed(smooth((150, 60), -2, 1), [Fraction(2**n, 64) for n in range(8)])
    whole = merge_mosaics(frames)
    monkeypatch.setattr(windows, "MOSAICS_AT_ONCE", 3)
    assert_same(whole, merge_mosaics(frames))
    # 150 rows in windows of 48.
    assert {len(f.alive) for f in frames} == {1 + 4}


def test_memory_does_not_grow_with_the_number_of_frames() -> None:
    shape = (1500, 320)

    def peak(count: int) -> float:
        frames = many(shape, count)
        merge_mosaics(frames[:2])
        tracemalloc.start()
        merge_mosaics(frames)
        highest = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return highest / (shape[0] * shape[1])

    def allowed(count: int, held: float) -> float:
        # In bytes a photosite: mosaic, weights and a mask; a band's rows; three tallies a row; what every call needs.
        return 4 + 4 + 1 + held + count * (48 * 2 / shape[0] + 24 / shape[1]) + 2

    assert peak(3) < allowed(3, 2 * 3)
    # Rows of every frame, 12 mosaics' worth, and one mosaic while its rows are cut out.
    assert peak(26) < allowed(26, 24 + 2)
    assert peak(52) < allowed(52, 24 + 2)


def test_what_is_clipped_everywhere_is_nan_masked_counted_and_told() -> None:
    radiance = smooth((40, 60), -1, 1)
    radiance[10:14, 20:30] = 1000.0
    merged = merge_mosaics(exposed(radiance))
    assert merged.lost_count == 40
    assert merged.lost[10:14, 20:30].all()
    np.testing.assert_array_equal(np.isnan(merged.mosaic), merged.lost)
    (warning,) = merged.warnings
    assert warning.startswith("1_256.dng: 40 photosites (0.017 of all) are clipped")
    assert "Add a shorter exposure" in warning


def test_a_single_frame_merges_and_warns() -> None:
    radiance = smooth((20, 30), -1, 0)
    merged = merge_mosaics(exposed(radiance, [Fraction(1, 8)], seed=None))
    np.testing.assert_allclose(merged.mosaic, radiance, atol=0.5 / SPAN * 8 * (1 + 1e-5), rtol=0)
    assert "cannot be recovered" in merged.warnings[0]


def test_a_frame_that_adds_nothing_is_named() -> None:
    radiance = np.full((20, 30), 100.0)
    merged = merge_mosaics(exposed(radiance, [Fraction(1, 500), Fraction(1, 2)]), defects=False)
    assert any(w.startswith("1_2.dng: no sample of it was used (100% clipped)") for w in merged.warnings)
    assert merged.frames[1].share == 0.0


def test_the_record_of_each_frame_adds_up() -> None:
    radiance = smooth((60, 90), -2, 2)
    frames = exposed(radiance)
    merged = merge_mosaics(frames[::-1])
    assert [f.exposure_s for f in merged.frames] == list(TIMES)
    assert [f.clipped for f in merged.frames] == [int((f.counts >= WHITE).sum()) for f in frames]
    assert all(f.used + f.clipped <= radiance.size for f in merged.frames)
    assert sum(f.share for f in merged.frames) == pytest.approx(1.0, abs=1e-6)


def test_mixed_iso_gives_the_radiance_of_the_lowest() -> None:
    radiance = smooth((20, 30), -2, -1)
    low = exposed(radiance, [Fraction(1)], seed=None)[0]
    high = exposed(radiance * 4, [Fraction(1)], seed=None)[0]
    high.info = dataclasses.replace(high.info, iso=400.0, name="high.dng")
    with pytest.raises(CalibrateError, match="ISO 400"):
        merge_mosaics([low, high])
    merged = merge_mosaics([low, high], mixed_iso=True, defects=False)
    np.testing.assert_allclose(merged.mosaic, radiance, atol=0.5 / SPAN * (1 + 1e-5), rtol=0)
    assert [f.name for f in merged.frames] == ["1_1.dng", "high.dng"]


def test_progress_counts_bands_of_rows() -> None:
    told: list[tuple[int, int]] = []
    merge_mosaics(exposed(smooth((100, 30), -1, 0)), progress=lambda done, total: told.append((done, total)))
    assert told == [(1, 3), (2, 3), (3, 3)]


def test_the_guessed_noise_model_scales_with_levels_and_iso() -> None:
    plain = guess_noise(info_of(Fraction(1), (4, 4)))
    assert plain.gain_e_per_dn * SPAN == pytest.approx(50_000)
    assert guess_noise(info_of(Fraction(1), (4, 4), iso=400.0)).gain_e_per_dn == pytest.approx(plain.gain_e_per_dn / 4)
    assert guess_noise(info_of(Fraction(1), (4, 4), iso=None)) == plain


def test_a_wrong_noise_model_costs_noise_but_no_bias() -> None:
    radiance = 10 ** np.random.default_rng(14).uniform(-3, -2, (200, 250))
    frames = exposed(radiance, seed=14)
    right = merge_mosaics(frames, noise=NOISE, defects=False).mosaic / radiance - 1
    wrong = merge_mosaics(frames, noise=NoiseModel(NOISE.gain_e_per_dn * 2, READ_E / 2), defects=False)
    error = wrong.mosaic / radiance - 1
    assert np.sqrt(np.mean(error**2)) < 1.05 * np.sqrt(np.mean(right**2))
    assert abs(np.mean(error)) < 3 * np.sqrt(np.mean(error**2) / error.size)


# Defects


def with_defects(radiance: Radiance, count: int, seed: int) -> tuple[Radiance, npt.NDArray[np.bool_]]:
    """Hot photosites, 4 to 1000 times their surroundings, none beside another."""
    rng = np.random.default_rng(seed)
    cells = [(y, x) for y in range(6, radiance.shape[0] - 6, 9) for x in range(6, radiance.shape[1] - 6, 9)]
    mask = np.zeros(radiance.shape, np.bool_)
    for k in rng.permutation(len(cells))[:count]:
        y, x = cells[k]
        mask[y + rng.integers(0, 3), x + rng.integers(0, 3)] = True
    return np.where(mask, radiance * 10 ** rng.uniform(0.6, 3, radiance.shape) + 0.002, radiance), mask


def test_hot_photosites_are_found_replaced_and_counted() -> None:
    clean = smooth((270, 450), -3, 0)
    radiance, hot = with_defects(clean, 300, 20)
    merged = merge_mosaics(exposed(radiance, seed=20))
    found = np.zeros(hot.shape, np.bool_)
    found[tuple(merged.defects.T)] = True
    assert (found & hot).sum() >= 0.93 * hot.sum()
    assert (found & ~hot).sum() == 0
    assert merged.defect_count == len(merged.defects) == found.sum()
    # Texture and the noise of the darkest decade (up to 14 %) are what the median of the neighbours cannot know.
    error = merged.mosaic[found] / clean[found] - 1
    assert np.sqrt(np.mean(error**2)) < 0.25


def test_defects_can_be_kept() -> None:
    radiance, hot = with_defects(smooth((90, 120), -2, 0), 30, 21)
    frames = exposed(radiance, seed=21)
    merged = merge_mosaics(frames, defects=False)
    assert merged.defect_count == 0
    assert merged.defects.shape == (0, 2)
    replaced = merge_mosaics(frames)
    untouched = np.ones(hot.shape, np.bool_)
    untouched[tuple(replaced.defects.T)] = False
    np.testing.assert_array_equal(merged.mosaic[untouched], replaced.mosaic[untouched])


def test_stuck_and_dead_photosites_are_found_too() -> None:
    frames = exposed(smooth((60, 80), -1, 0), seed=22)
    for f in frames:
        f.counts[20, 31] = WHITE
        f.counts[41, 50] = BLACK
        f.counts[0, 0] = WHITE
    merged = merge_mosaics(frames)
    np.testing.assert_array_equal(merged.defects, [[0, 0], [20, 31], [41, 50]])
    assert merged.lost_count == 0
    assert not merged.lost.any()
    assert np.isfinite(merged.mosaic).all()


def lamps(shape: tuple[int, int], colour: tuple[float, float, float], width_px: float, seed: int) -> Radiance:
    """Points of light seen through a lens: Gaussian of the given full width at half maximum, anywhere on the grid."""
    rng = np.random.default_rng(seed)
    fine = np.zeros((4 * shape[0], 4 * shape[1]))
    for y in range(10, shape[0] - 10, 20):
        for x in range(10, shape[1] - 10, 20):
            fine[4 * y + rng.integers(0, 8), 4 * x + rng.integers(0, 8)] = 10 ** rng.uniform(1, 4)
    fine = cv2.GaussianBlur(fine, (0, 0), width_px / 2.355 * 4)
    image = fine.reshape(shape[0], 4, shape[1], 4).sum((1, 3))
    out = np.empty(shape)
    for k, channel in enumerate((0, 1, 1, 2)):
        place = np.s_[k // 2 :: 2, k % 2 :: 2]
        out[place] = image[place] * colour[channel]
    return out


@pytest.mark.parametrize("width_px", [1.0, 1.5, 3.0])
@pytest.mark.parametrize("colour", [(1.0, 1.0, 1.0), (1.0, 0.5, 0.2), (0.25, 0.6, 1.0), (1.0, 0.15, 0.05)])
def test_small_lamps_survive(width_px: float, colour: tuple[float, float, float]) -> None:
    shape = (200, 300)
    radiance = smooth(shape, -1.5, -1.5) + 0.1 * lamps(shape, colour, width_px, 23)
    merged = merge_mosaics(exposed(radiance, [*(t / 64 for t in TIMES[:2]), *TIMES], seed=23))
    # 150 lamps, 10 to 10 000 times as strong as what a photosite of their surroundings collects.
    assert merged.defect_count <= 1


def test_edges_texture_and_noise_are_no_defects() -> None:
    image = smooth((200, 300), -4, 1)
    image[50:100, 40:200] *= 300
    image[:, 250:] *= 0.003
    image = cv2.GaussianBlur(image, (0, 0), 0.6)
    assert merge_mosaics(exposed(image, seed=24)).defect_count == 0
    # Read noise three times what the model says.
    timid = NoiseModel(NOISE.gain_e_per_dn, READ_E / 3)
    assert merge_mosaics(exposed(image * 0.01, seed=25), noise=timid).defect_count <= 6


def test_too_many_defects_are_told() -> None:
    radiance = np.full((90, 90), 0.1)
    radiance[4::9, 4::9] = 5.0
    merged = merge_mosaics(exposed(radiance, seed=26))
    assert merged.defect_count == 100
    assert any("`merge.defects: false`" in w for w in merged.warnings)


# Refusals


def test_a_bracket_with_a_mistake_is_refused_before_anything_is_decoded() -> None:
    frames = exposed(smooth((20, 30), -1, 0))
    frames[2].info = dataclasses.replace(frames[2].info, f_number=2.8)
    with pytest.raises(CalibrateError, match=r"aperture f/2\.8"):
        merge_mosaics(frames)
    assert not any(f.alive for f in frames)


@pytest.mark.parametrize("counts", [np.zeros((20, 31), np.uint16), np.zeros((20, 30), np.float32)])
def test_a_mosaic_that_is_not_what_its_frame_announced_is_refused(counts: npt.NDArray[Any]) -> None:
    frames: list[MosaicFrame] = list(exposed(smooth((20, 30), -1, 0)))
    frames[1] = Frame(frames[1].info, counts)
    with pytest.raises(CalibrateError, match=r"1_64\.dng: mosaic of shape"):
        merge_mosaics(frames)


@pytest.mark.parametrize("noise", [NoiseModel(0.0, 3.0), NoiseModel(3.0, 0.0), NoiseModel(float("nan"), 3.0)])
def test_a_noise_model_that_is_not_positive_is_refused(noise: NoiseModel) -> None:
    with pytest.raises(CalibrateError, match="both must be above 0"):
        merge_mosaics(exposed(smooth((20, 30), -1, 0)), noise=noise)
