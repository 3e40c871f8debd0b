"""The merge from RAW files to EXR: what the settings ask for is in the file, and nothing of it is silent."""

import dataclasses
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

from envcal import exr
from envcal.checks import check_frames
from envcal.config import MergeSettings, load
from envcal.config.models import LensByName
from envcal.errors import EnvcalError
from envcal.raw import frames as frames_module
from envcal.raw import open_bracket
from envcal.steps.merge import merge, refuse_unknown_names
from samples.dng import encode_dng
from samples.sensor import Camera, expose

HEIGHT, WIDTH = 60, 120
CAMERA = Camera(hot_pixels=0)
TIMES = (Fraction(1, 64), Fraction(1, 16), Fraction(1, 4))


def radiance() -> npt.NDArray[np.float64]:
    ramp = 10 ** np.linspace(-1.5, 1.2, WIDTH)
    return np.ones((HEIGHT, 1, 1)) * ramp[None, :, None] * np.array([0.6, 1.0, 0.5])


def write(folder: Path, *, said: dict[int, Fraction] | None = None, lamp: float = 0.0) -> list[Path]:
    """A bracket; `said` replaces what single files say of their time, `lamp` is the radiance of a square in it."""
    rgb = radiance()
    if lamp:
        rgb[20:30, 40:50] = lamp * np.array([1.0, 0.8, 0.4])
    paths = []
    for n, time in enumerate(TIMES):
        counts = expose(rgb, time, camera=CAMERA, frame=n)
        data = encode_dng(counts, (said or {}).get(n, time), camera=CAMERA, neutral=np.ones(3))
        paths.append(folder / f"{n}.dng")
        paths[-1].write_bytes(data)
    return paths


def error(path: Path) -> float:
    _, image = exr.read_rgb(path)
    return float(np.nanmedian(np.abs(image / radiance() - 1)))


def test_a_wrong_time_is_corrected_by_the_pixels_or_by_the_settings_and_told(tmp_path: Path) -> None:
    frames = write(tmp_path, said={1: Fraction(1, 13)})
    out = tmp_path / "o.exr"
    measured = merge(frames, out, MergeSettings())
    assert error(out) < 0.01
    assert any("1.dng: the pixels say" in w for w in measured.warnings)
    assert [f["factor_used"] for f in measured.figures["frames"]] == [False, True, False]
    believed = merge(frames, out, MergeSettings(exposure_ratios="file"))
    assert error(out) > 0.02
    assert not any("the pixels say" in w for w in believed.warnings)
    merge(frames, out, MergeSettings(exposure_ratios="file", exposures={"1.dng": 1 / 16}))
    assert error(out) < 0.01


def test_a_name_that_no_frame_has_is_refused(tmp_path: Path) -> None:
    frames = write(tmp_path)
    settings = MergeSettings(exposures={"9.dng": 1.0}, filters={"8.dng": 0.5})
    with pytest.raises(EnvcalError) as caught:
        refuse_unknown_names(settings, {"reference": frames})
    assert [line.split(":")[0] for line in str(caught.value).splitlines()] == [
        "merge.exposures.9.dng",
        "merge.filters.8.dng",
    ]
    pipeline = tmp_path / "p.yaml"
    pipeline.write_text("capture: {reference: '*.dng'}\nmerge: {exposures: {9.dng: 1.0}}\n", encoding="utf-8")
    with pytest.raises(EnvcalError, match="no frame of any shot"):
        check_frames(load(pipeline))


def test_a_dark_frame_that_is_not_there_is_a_mistake_of_the_settings(tmp_path: Path) -> None:
    write(tmp_path)
    pipeline = tmp_path / "p.yaml"
    pipeline.write_text("capture: {reference: '*.dng'}\nmerge: {dark_frame: dark.nef}\n", encoding="utf-8")
    with pytest.raises(EnvcalError, match=r"p\.yaml:2: merge\.dark_frame: there is no file"):
        load(pipeline)


def test_lost_light_stays_nan_or_is_filled_as_asked_and_told(tmp_path: Path) -> None:
    frames = write(tmp_path, lamp=1000.0)
    out = tmp_path / "o.exr"
    kept = merge(frames, out, MergeSettings())
    _, planes = exr.read(out, ["R", "lost"])
    assert np.isnan(planes["R"][25, 45])
    assert planes["lost"][25, 45] == 1
    assert kept.figures["lost"] >= 100
    # 2:1 is a lat-long map, whose rows weigh by the sphere they cover.
    assert kept.figures["lost_share"] > 1.2 * kept.figures["lost"] / (HEIGHT * WIDTH)
    filled = merge(frames, out, MergeSettings(lost="neighbour"))
    _, planes = exr.read(out, ["R", "G", "B", "lost"])
    assert not any(np.isnan(planes[name]).any() for name in "RGB")
    assert planes["lost"][25, 45] == 1
    # At least what the shortest frame clips at, in every channel.
    assert min(planes[name][25, 45] for name in "RGB") >= 0.99 / float(TIMES[0])
    assert any("were filled with the neighbours' colour" in w for w in filled.warnings)
    declared = merge(frames, out, MergeSettings(lost=(5.0, 6.0, 7.0)))
    _, planes = exr.read(out, ["R", "G", "B"])
    assert [planes[name][25, 45] for name in "RGB"] == [5, 6, 7]
    assert any("the declared colour" in w for w in declared.warnings)


def test_the_deviation_and_the_ghosts_are_channels_when_asked_for(tmp_path: Path) -> None:
    frames = write(tmp_path)
    out = tmp_path / "o.exr"
    merge(frames, out, MergeSettings())
    assert set(exr.header(out).channels) == {"R", "G", "B", "lost"}
    merge(frames, out, MergeSettings(deviation=True, deghost=True))
    _, planes = exr.read(out, ["sigma.R", "sigma.G", "sigma.B", "ghost", "G"])
    assert not planes["ghost"].any()
    smooth = np.abs(planes["G"] / radiance()[..., 1] - 1) / (planes["sigma.G"] / radiance()[..., 1])
    # Interpolated values are quieter than the samples whose deviation is given.
    assert 0.4 < np.median(smooth) / 0.6745 < 1.1


def test_each_file_is_decoded_once_and_the_result_does_not_depend_on_what_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    frames = write(tmp_path)
    calls: list[Path] = []
    original = frames_module.read_frame

    def counted(path: Any) -> Any:
        calls.append(Path(path))
        return original(path)

    monkeypatch.setattr(frames_module, "read_frame", counted)
    merge(frames, tmp_path / "a.exr", MergeSettings())
    assert sorted(calls) == sorted(frames)
    monkeypatch.setattr("envcal.raw.open_bracket", lambda paths, **_: open_bracket(paths, keep=1))
    merge(frames, tmp_path / "b.exr", MergeSettings())
    one, other = (exr.read(tmp_path / name, ["R", "G", "B"])[1] for name in ("a.exr", "b.exr"))
    assert all(np.array_equal(one[c], other[c]) for c in "RGB")


def test_all_unreadable_frames_are_named_at_once(tmp_path: Path) -> None:
    frames = write(tmp_path)
    for frame in frames[:2]:
        frame.write_bytes(b"")
    with pytest.raises(EnvcalError) as caught:
        open_bracket(frames)
    assert len(str(caught.value).splitlines()) == 2


def test_a_described_frame_keeps_its_counts(tmp_path: Path) -> None:
    (frame, *_) = open_bracket(write(tmp_path))
    changed = frame.described(exposure_s=Fraction(3))
    assert changed.info == dataclasses.replace(frame.info, exposure_s=Fraction(3))
    assert changed.mosaic() is frame.mosaic()


def test_the_fall_off_of_the_lens_is_taken_out_from_settings_or_a_flat_field(tmp_path: Path) -> None:
    y, x = np.mgrid[0:128, 0:200] + 0.5
    r2 = ((y - 64) ** 2 + (x - 100) ** 2) / (64**2 + 100**2)
    fall = (1 - 0.5 * r2 + 0.1 * r2**2)[..., None] * np.ones(3)
    (tmp_path / "shots").mkdir()
    frames = []
    for n, time in enumerate(TIMES):
        frames.append(tmp_path / "shots" / f"{n}.dng")
        data = encode_dng(expose(2.0 * fall, time, camera=CAMERA, frame=n), time, camera=CAMERA, neutral=np.ones(3))
        frames[-1].write_bytes(data)
    flat = tmp_path / "flat.dng"
    flat.write_bytes(
        encode_dng(
            expose(fall, Fraction(1, 2), camera=CAMERA, frame=9), Fraction(1, 2), camera=CAMERA, neutral=np.ones(3)
        )
    )
    out = tmp_path / "o.exr"
    for settings in (
        MergeSettings(vignetting=(-0.5, 0.1, 0.0)),
        MergeSettings(vignetting=((-0.5, 0.1, 0.0),) * 3),
        MergeSettings(flat_field=flat),
    ):
        outcome = merge(frames, out, settings)
        _, image = exr.read_rgb(out)
        corners = image[[0, 0, -9, -9], [0, -9, 0, -9]]
        assert corners == pytest.approx(2.0, rel=0.03)
        assert np.mean(image[:8, :8]) == pytest.approx(2.0, rel=0.01)
        assert outcome.figures["vignetting"] is not None
    merge(frames, out, MergeSettings())
    assert np.mean(exr.read_rgb(out)[1][:8, :8]) < 1.4
    with pytest.raises(ValueError, match="not both"):
        MergeSettings(vignetting=(0.0, 0.0, 0.0), flat_field=flat)


DATABASE = """<lensdatabase version="1">
 <mount><name>Alpha</name></mount>
 <camera><maker>envcal</maker><model>Synthetic 360</model><mount>Alpha</mount><cropfactor>1.0</cropfactor></camera>
 <lens><maker>envcal</maker><model>envcal 35mm f/2</model><mount>Alpha</mount><cropfactor>1.0</cropfactor><calibration>
  <vignetting model="pa" focal="35" aperture="2" distance="0.5" k1="-0.5" k2="0.1" k3="0"/>
  <vignetting model="pa" focal="35" aperture="8" distance="1000" k1="-0.5" k2="0.1" k3="0"/>
 </calibration></lens>
</lensdatabase>"""


def through_a_lens(folder: Path, lens: str = "35mm F2", **settings: object) -> list[Path]:
    """A bracket of an even surface seen through a lens of the database above."""
    y, x = np.mgrid[0:128, 0:200] + 0.5
    r2 = ((y - 64) ** 2 + (x - 100) ** 2) / (64**2 + 100**2)
    fall = (1 - 0.5 * r2 + 0.1 * r2**2)[..., None] * np.ones(3)
    frames = []
    for n, time in enumerate(TIMES):
        frames.append(folder / f"{n}.dng")
        given = {"lens": lens, "focal_length_mm": 35, "distance_m": Fraction(3, 2), **settings}
        counts = expose(2.0 * fall, time, camera=CAMERA, frame=n)
        frames[-1].write_bytes(encode_dng(counts, time, camera=CAMERA, neutral=np.ones(3), settings=given))
    return frames


def test_the_fall_off_of_a_known_lens_is_taken_out_and_the_lens_told(tmp_path: Path) -> None:
    pytest.importorskip("lensfunpy", reason="the extra `lens` is not installed")
    frames = through_a_lens(tmp_path)
    database = tmp_path / "lenses.xml"
    database.write_text(DATABASE, encoding="utf-8")
    out = tmp_path / "o.exr"
    for lens in ("auto", "required", LensByName(name="envcal 35mm f/2")):
        outcome = merge(frames, out, MergeSettings(lens=lens, lens_database=database))
        assert exr.read_rgb(out)[1][[0, 0, -9, -9], [0, -9, 0, -9]] == pytest.approx(2.0, rel=0.03)
        assert outcome.figures["lens"]["lens"] == "envcal 35mm f/2"
        assert outcome.figures["lens"]["distance_m"] == 1.5
        assert outcome.figures["vignetting"] is not None
        assert not any("merge.lens" in w for w in outcome.warnings)
    assert exr.header(out).json("envcalCamera")["focal_length_mm"] == 35


def test_a_lens_that_is_not_known_is_refused_or_told_never_passed_over(tmp_path: Path) -> None:
    pytest.importorskip("lensfunpy", reason="the extra `lens` is not installed")
    frames = through_a_lens(tmp_path, "Unheard 35mm")
    database = tmp_path / "lenses.xml"
    database.write_text(DATABASE, encoding="utf-8")
    out = tmp_path / "o.exr"
    with pytest.raises(EnvcalError, match=r"'Unheard 35mm' on envcal Synthetic 360: is not in the lens database"):
        merge(frames, out, MergeSettings(lens="required", lens_database=database))
    outcome = merge(frames, out, MergeSettings(lens="auto", lens_database=database))
    (warning,) = [w for w in outcome.warnings if "merge.lens" in w]
    assert warning.startswith("merge.lens auto: no fall-off was taken out. ")
    assert outcome.figures["lens"] is outcome.figures["vignetting"] is None
    assert not any("merge.lens" in w for w in merge(frames, out, MergeSettings()).warnings)


def test_check_finds_an_unknown_lens_and_a_missing_aperture_before_anything_runs(tmp_path: Path) -> None:
    pytest.importorskip("lensfunpy", reason="the extra `lens` is not installed")
    through_a_lens(tmp_path, "Unheard 35mm", f_number=None)
    (tmp_path / "lenses.xml").write_text(DATABASE, encoding="utf-8")
    pipeline = tmp_path / "p.yaml"

    def checked(lens: str, exposure: bool) -> list[str]:
        pipeline.write_text(
            f"capture: {{reference: '*.dng'}}\nmerge: {{lens: {lens}, lens_database: lenses.xml}}\n"
            f"photometry: {{exposure: {str(exposure).lower()}}}\n",
            encoding="utf-8",
        )
        return check_frames(load(pipeline))

    with pytest.raises(EnvcalError) as caught:
        checked("required", True)
    assert "'Unheard 35mm'" in str(caught.value)
    assert "photometry.exposure: " in str(caught.value)
    assert "tells no aperture" in str(caught.value)
    assert any("merge.lens auto" in text for text in checked("auto", False))
    # A database that cannot be read is a mistake whatever was asked for.
    (tmp_path / "lenses.xml").write_text("<lensdatabase version='1'></lensdatabase>", encoding="utf-8")
    with pytest.raises(EnvcalError, match="holds no lens"):
        checked("auto", False)


def test_one_fall_off_is_no_answer_for_several_apertures(tmp_path: Path) -> None:
    frames, other = through_a_lens(tmp_path), tmp_path / "other"
    other.mkdir()
    frames[0].write_bytes(through_a_lens(other, f_number=8)[0].read_bytes())
    with pytest.raises(EnvcalError, match=r"apertures from f/5\.6 to f/8"):
        merge(frames, tmp_path / "o.exr", MergeSettings(lens="required", mixed_aperture=True))


def test_a_lens_of_the_database_excludes_a_fall_off_of_ones_own(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="only one of them"):
        MergeSettings(lens="auto", vignetting=(0.0, 0.0, 0.0))
    through_a_lens(tmp_path)
    pipeline = tmp_path / "p.yaml"
    pipeline.write_text("capture: {reference: '*.dng'}\nmerge: {lens_database: none.xml}\n", encoding="utf-8")
    with pytest.raises(EnvcalError, match=r"p\.yaml:2: merge\.lens_database: there is no file"):
        load(pipeline)


def test_a_mixed_bracket_says_the_settings_whose_unit_it_is_in(tmp_path: Path) -> None:
    frames = write(tmp_path)
    counts = expose(radiance(), TIMES[0] * 2, camera=CAMERA, frame=9)
    # Twice the ISO for half the time: the same counts, and listed first.
    data = encode_dng(counts, TIMES[0], camera=CAMERA, neutral=np.ones(3), settings={"iso": 200})
    frames[0].write_bytes(data)
    out = tmp_path / "o.exr"
    merge(frames, out, MergeSettings(mixed_iso=True))
    assert exr.header(out).json("envcalCamera")["iso"] == 100
    assert error(out) < 0.01
