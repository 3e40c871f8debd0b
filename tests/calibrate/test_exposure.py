"""Human mistakes in a bracket: each is found, named and answered with a remedy."""

import dataclasses
from fractions import Fraction
from typing import Any

import pytest

from calibrate import CalibrateError
from calibrate.exposure import FrameInfo, by_exposure, check_bracket


def frame(name: str = "a.dng", exposure: Fraction | None = Fraction(1, 60), **changed: Any) -> FrameInfo:
    plain = FrameInfo(
        name=name,
        exposure_s=exposure,
        iso=100.0,
        f_number=8.0,
        camera="Maker One",
        lens="50 mm",
        width=6000,
        height=4000,
        cfa="RGGB",
        black_dn=(512.0,) * 4,
        white_dn=(16383.0,) * 4,
        bits=14,
        focal_length_mm=50.0,
    )
    return dataclasses.replace(plain, **changed)


def bracket(**odd: Any) -> list[FrameInfo]:
    """Four frames 2 EV apart, the third of which is changed."""
    frames = [frame(f"{n}.dng", Fraction(4**n, 1000)) for n in range(4)]
    frames[2] = dataclasses.replace(frames[2], **odd)
    return frames


def test_a_sound_bracket_gives_no_warning() -> None:
    assert check_bracket(bracket()) == ()


@pytest.mark.parametrize(
    ("odd", "said"),
    [
        ({"iso": 400.0}, "2.dng: ISO 400 differs from ISO 100 of 0.dng"),
        ({"f_number": 5.6}, "2.dng: aperture f/5.6 differs from aperture f/8 of 0.dng"),
        ({"camera": "Other"}, "2.dng: camera 'Other' differs from camera 'Maker One' of 0.dng"),
        ({"lens": "35 mm"}, "2.dng: lens '35 mm' differs from lens '50 mm' of 0.dng"),
        ({"focal_length_mm": 70.0}, "2.dng: focal length 70 mm differs from focal length 50 mm of 0.dng"),
        ({"width": 5999}, "2.dng: size 5999×4000 differs from size 6000×4000 of 0.dng"),
        ({"height": 3999}, "2.dng: size 6000×3999 differs"),
        ({"cfa": "BGGR"}, "2.dng: colour filter array BGGR differs from colour filter array RGGB of 0.dng"),
        ({"bits": 12}, "2.dng: 12 bits a sample differs from 14 bits a sample of 0.dng"),
        ({"white_dn": (15000.0, 15200.0, 15200.0, 15000.0)}, "2.dng: white level 15000/15200/15200/15000 differs"),
        ({"black_dn": (1024.0,) * 4}, "2.dng: black level 1024 differs from 512 of 0.dng by more than 1%"),
        ({"exposure_s": None}, "2.dng: no exposure time in the file"),
        ({"exposure_s": Fraction(0)}, "2.dng: exposure time 0 s; it must be above 0"),
        ({"exposure_s": Fraction(-1, 60)}, "2.dng: exposure time -0.0166667 s; it must be above 0"),
        ({"exposure_s": Fraction(4, 1000)}, "2.dng: exposure 1/250 s is also that of 1.dng"),
        ({"exposure_s": Fraction(401, 100_000)}, "2.dng: exposure 401/100000 s is also that of 1.dng"),
        ({"cfa": "XTRANS"}, "2.dng: colour filter array 'XTRANS'; a Bayer pattern"),
        ({"black_dn": (512.0, 512.0, 512.0, 20000.0)}, "2.dng: black level 20000 and white level 16383"),
        ({"black_dn": (float("nan"),) * 4}, "2.dng: black level nan"),
        ({"width": 2}, "2.dng: 2×4000 photosites; at least 4×4"),
    ],
)
def test_a_mistake_is_named_with_file_value_and_expectation(odd: dict[str, Any], said: str) -> None:
    with pytest.raises(CalibrateError) as caught:
        check_bracket(bracket(**odd))
    assert any(line.startswith(said) for line in str(caught.value).splitlines()), caught.value


@pytest.mark.parametrize("odd", [{"iso": 400.0}, {"exposure_s": None}, {"exposure_s": Fraction(4, 1000)}])
def test_every_message_ends_with_a_remedy_that_names_a_setting(odd: dict[str, Any]) -> None:
    with pytest.raises(CalibrateError, match=r"`capture\.reference`"):
        check_bracket(bracket(**odd))


def test_all_mistakes_come_at_once_one_a_line() -> None:
    frames = bracket(iso=200.0, f_number=4.0)
    frames[0] = dataclasses.replace(frames[0], exposure_s=None)
    with pytest.raises(CalibrateError) as caught:
        check_bracket(frames)
    lines = str(caught.value).splitlines()
    assert len(lines) == 3
    assert [line.split(":")[0] for line in lines] == ["0.dng", "2.dng", "2.dng"]


def test_the_odd_one_out_is_blamed_even_if_it_comes_first() -> None:
    frames = bracket()
    frames[0] = dataclasses.replace(frames[0], iso=800.0)
    with pytest.raises(CalibrateError, match=r"^0\.dng: ISO 800 differs from ISO 100 of 1\.dng"):
        check_bracket(frames)


def test_mixed_iso_can_be_allowed_but_needs_every_iso() -> None:
    assert check_bracket(bracket(iso=400.0), mixed_iso=True) == ()
    same_time = [frame("a.dng", iso=100.0), frame("b.dng", iso=400.0)]
    assert check_bracket(same_time, mixed_iso=True) == ()
    with pytest.raises(CalibrateError, match=r"`merge\.mixed_iso: false`"):
        check_bracket(bracket(iso=None), mixed_iso=True)


def test_black_levels_measured_anew_for_every_frame_are_no_mistake() -> None:
    assert check_bracket(bracket(black_dn=(512.7, 511.9, 512.2, 512.0))) == ()


def test_a_focal_length_that_is_rounded_otherwise_or_missing_is_no_mistake() -> None:
    for told in (50.8, 49.2, None):
        assert check_bracket(bracket(focal_length_mm=told)) == ()
    zoomed = [dataclasses.replace(f, focal_length_mm=f.focal_length_mm if k else 24.0) for k, f in enumerate(bracket())]
    with pytest.raises(CalibrateError, match=r"^0\.dng: focal length 24 mm differs.*Move the file out of the bracket"):
        check_bracket(zoomed)


def test_what_only_some_files_tell_is_not_compared() -> None:
    assert check_bracket(bracket(lens="", f_number=None, bits=None, camera="")) == ()


def test_a_single_frame_warns_that_clipping_stays_or_is_refused_if_asked() -> None:
    (warning,) = check_bracket([frame()])
    assert "cannot be recovered" in warning
    with pytest.raises(CalibrateError, match="the only frame"):
        check_bracket([frame()], allow_single=False)


def test_no_frames_are_refused() -> None:
    with pytest.raises(CalibrateError, match="0 frames"):
        check_bracket([])


def test_the_same_file_twice_is_called_that() -> None:
    with pytest.raises(CalibrateError, match="listed twice"):
        check_bracket([frame(), frame()])


def test_a_step_above_four_ev_warns_and_one_of_four_does_not() -> None:
    assert check_bracket([frame("a.dng", Fraction(1, 160)), frame("b.dng", Fraction(1, 10))]) == ()
    (warning,) = check_bracket([frame("a.dng", Fraction(1, 640)), frame("b.dng", Fraction(1, 10))])
    assert warning.startswith("b.dng: 6.0 EV above a.dng")


def test_a_missing_iso_warns_once() -> None:
    (warning,) = check_bracket([dataclasses.replace(f, iso=None) for f in bracket()])
    assert warning.startswith("0.dng and 3 more: no ISO")


def test_frames_sort_by_light_whatever_their_order() -> None:
    frames = [
        frame("c.dng", Fraction(1, 15)),
        frame("a.dng", Fraction(1, 60)),
        frame("b.dng", Fraction(1, 60), iso=200.0),
        frame("none.dng", None),
    ]
    assert [frames[i].name for i in by_exposure(frames)] == ["none.dng", "a.dng", "b.dng", "c.dng"]
    reversed_frames = frames[::-1]
    assert [reversed_frames[i].name for i in by_exposure(reversed_frames)] == ["none.dng", "a.dng", "b.dng", "c.dng"]
