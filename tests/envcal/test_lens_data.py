"""A lens of the database is taken when it is this one, at settings that were measured; anything else is refused by name."""

from __future__ import annotations

import dataclasses
import math
import sys
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from calibrate.exposure import FrameInfo
from calibrate.lens import remove_vignetting
from envcal.config.models import LensByName
from envcal.errors import EnvcalError
from envcal.lens_data import database_files, known_lens

lensfunpy = pytest.importorskip("lensfunpy", reason="the extra `lens` is not installed")

#: Lensfun numbers pixels from corner to corner, we from middle to middle: half a pixel of 720.
HALF_A_PIXEL = 6e-3
#: Lensfun keeps single precision.
SINGLE = 1e-6

ENTRIES = """<lensdatabase version="1">
 <mount><name>Alpha</name></mount>
 <camera><maker>Maker</maker><model>Maker One</model><mount>Alpha</mount><cropfactor>1.0</cropfactor></camera>
 <camera><maker>Maker</maker><model>Maker Small</model><mount>Alpha</mount><cropfactor>1.5</cropfactor></camera>
 <camera><maker>Maker</maker><model>Compact</model><mount>makerCompact</mount><cropfactor>4.0</cropfactor></camera>
 <camera><maker>Maker</maker><model>Twice</model><mount>Alpha</mount><cropfactor>1.0</cropfactor></camera>
 <camera><maker>Maker</maker><model>T-wice</model><mount>Alpha</mount><cropfactor>1.3</cropfactor></camera>
 {lenses}
</lensdatabase>"""


def lens(name: str, *, mount: str = "Alpha", crop: float = 1.0, k1: float = -0.4, near: float = -0.4) -> str:
    points = "".join(
        f'<vignetting model="pa" focal="{focal}" aperture="{n}" distance="{d}" k1="{k}" k2="0.1" k3="-0.05"/>'
        for focal in (24, 50)
        for n in (2.8, 8)
        for d, k in ((0.5, near), (1000, k1))
    )
    return (
        f"<lens><maker>Maker</maker><model>{name}</model><mount>{mount}</mount><cropfactor>{crop}</cropfactor>"
        f"<calibration>{points if k1 else ''}</calibration></lens>"
    )


LENSES = (
    lens("Maker 24-50mm f/2.8"),
    lens("Maker Zoom 24-50mm f/2.8 II", k1=-0.6, near=-0.3),
    lens("Maker Plain 35mm f/2", k1=0.0),
    lens("Maker Double 50mm f/2", k1=-0.2),
    lens("Maker Double Lens 50mm f/2", k1=-0.3),
    lens("Maker Formats 50mm", k1=-0.2),
    lens("Maker Formats 50mm", k1=-0.1, crop=1.5),
    lens("Standard", mount="makerCompact", crop=4.0),
)


@pytest.fixture
def database(tmp_path: Path) -> Path:
    path = tmp_path / "own.xml"
    path.write_text(ENTRIES.format(lenses="".join(LENSES)), encoding="utf-8")
    return path


def frame(**changed: object) -> FrameInfo:
    info = FrameInfo(
        "a.dng", Fraction(1, 10), 100.0, 2.8, "Maker One", "24-50mm F2.8", 600, 400, "RGGB",
        (512.0,) * 4, (16383.0,) * 4, 14, focal_length_mm=24.0, focus_distance_m=math.inf,
    )  # fmt: skip
    return dataclasses.replace(info, **changed)  # type: ignore[arg-type]


def test_a_lens_is_known_by_its_name_however_it_is_written(database: Path) -> None:
    for name in ("24-50mm F2.8", "Maker 24-50mm f/2.8", "MAKER 24-50MM F2.8", "maker zoom 24-50mm f/2.8"):
        found = known_lens(frame(lens=name), database=database)
        assert found.lens == "Maker 24-50mm f/2.8"
        assert found.vignetting[0] == pytest.approx((-0.4, 0.1, -0.05), rel=SINGLE)
        assert found.vignetting == (found.vignetting[0],) * 3
        assert found.corner == pytest.approx(0.65, rel=SINGLE)
        assert found.warnings == ()
        assert found.database == "own.xml"
    second = known_lens(frame(lens="24-50mm F2.8 II"), database=database)
    assert second.vignetting[0][0] == pytest.approx(-0.6, rel=SINGLE)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"lens": "24-50mm F2.8 III"}, ("is not in the lens database", "24-50mm f/2.8 II", "merge.lens: {name:")),
        ({"lens": ""}, ("no lens in the file", "Maker One")),
        ({"lens": "Double 50mm f/2"}, ("is 2 times in the lens database", "Maker Double 50mm f/2; Maker Double Lens")),
        ({"lens": "Plain 35mm f/2"}, ("nobody has measured its fall-off", "merge.flat_field")),
        ({"camera": "Maker Unheard"}, ("the camera 'Maker Unheard'", "Nearest: Maker One")),
        ({"camera": ""}, ("no camera in the file", "camera: …")),
        ({"camera": "Maker TWICE"}, ("is 2 times", "Maker T-wice (crop factor 1.3)")),
        ({"focal_length_mm": None}, ("no focal length in the file", "focal_length_mm")),
        ({"f_number": None}, ("no aperture in the file", "f_number")),
        ({"focal_length_mm": 16.0}, ("16 mm", "from 24 to 50 mm")),
        ({"focal_length_mm": 70.0}, ("70 mm", "from 24 to 50 mm")),
        ({"f_number": 2.0}, ("f/2;", "from f/2.8 to f/8")),
    ],
)
def test_what_is_missing_ambiguous_or_unmeasured_is_refused_by_name(
    database: Path, changed: dict[str, object], words: tuple[str, ...]
) -> None:
    with pytest.raises(EnvcalError) as caught:
        known_lens(frame(**changed), database=database)
    assert str(caught.value).startswith("a.dng: ")
    for word in words:
        assert word in str(caught.value)


def test_settings_name_what_the_file_does_not_tell(database: Path) -> None:
    mute = frame(camera="", lens="", focal_length_mm=None, f_number=None, focus_distance_m=None)
    asked = LensByName(name="24-50mm f/2.8 II", camera="Maker One", focal_length_mm=50, f_number=8, distance_m=0.5)
    found = known_lens(mute, asked, database=database)
    assert (found.focal_length_mm, found.f_number, found.distance_m) == (50, 8, 0.5)
    assert found.vignetting[0][0] == pytest.approx(-0.3, rel=SINGLE)


def test_an_exact_name_settles_what_was_ambiguous(database: Path) -> None:
    for name, k1 in (("Maker Double 50mm f/2", -0.2), ("Maker Double Lens 50mm f/2", -0.3)):
        assert known_lens(frame(), LensByName(name=name), database=database).vignetting[0][0] == pytest.approx(k1)
    assert known_lens(frame(), LensByName(name=name, camera="Maker T-wice"), database=database).camera == "Maker T-wice"


def test_a_lens_that_cannot_be_changed_needs_no_name(database: Path) -> None:
    assert known_lens(frame(camera="Maker Compact", lens=""), database=database).lens == "Standard"


def test_stopped_down_beyond_the_measured_the_fall_off_stays(database: Path) -> None:
    assert known_lens(frame(f_number=22.0), database=database).vignetting == (
        known_lens(frame(f_number=8.0), database=database).vignetting
    )


def test_an_unknown_distance_is_told_where_it_matters(database: Path) -> None:
    assert known_lens(frame(focus_distance_m=None), database=database).warnings == ()
    (warning,) = known_lens(frame(focus_distance_m=None, lens="24-50mm F2.8 II"), database=database).warnings
    assert "45% of the light" in warning
    assert "75% at the nearest" in warning


def test_the_measurement_on_this_cameras_own_format_is_taken(database: Path) -> None:
    small = known_lens(frame(camera="Maker Small", lens="Formats 50mm", focal_length_mm=50.0), database=database)
    assert small.vignetting[0][0] == pytest.approx(-0.1, rel=SINGLE)
    full = known_lens(frame(lens="Formats 50mm", focal_length_mm=50.0), database=database)
    assert full.vignetting[0][0] == pytest.approx(-0.2, rel=SINGLE)


@pytest.mark.parametrize("camera", ["Maker One", "Maker Small"])
def test_the_fall_off_taken_out_is_lensfuns_own_on_any_format(database: Path, camera: str) -> None:
    found = known_lens(frame(camera=camera), database=database)
    entries = lensfunpy.Database(paths=[str(database)], load_common=False, load_bundled=False)
    (body,) = entries.find_cameras(None, camera)
    (glass,) = [one for one in entries.lenses if one.model == "Maker 24-50mm f/2.8"]
    theirs = np.ones((400, 600, 3), np.float32)
    modifier = lensfunpy.Modifier(glass, body.crop_factor, 600, 400)
    modifier.initialize(24.0, 2.8, 1000.0, pixel_format=np.float32, flags=lensfunpy.ModifyFlags.VIGNETTING)
    assert modifier.apply_color_modification(theirs)
    ours = remove_vignetting(np.ones((400, 600, 3), np.float32), found.vignetting)
    assert theirs[0, 0, 0] > 1.1
    np.testing.assert_allclose(ours, theirs, rtol=HALF_A_PIXEL)


def test_the_database_that_comes_with_the_package_knows_a_common_lens() -> None:
    found = known_lens(frame(camera="Canon EOS 5D Mark II", lens="EF24-70mm f/2.8L USM"))
    assert found.lens == "Canon EF 24-70mm f/2.8L USM"
    assert 0.1 < found.corner < 0.5
    assert found.database == f"lensfunpy {lensfunpy.__version__}"


def test_a_file_that_is_no_database_is_refused(tmp_path: Path) -> None:
    (tmp_path / "odd.xml").write_text("<lensdatabase version='1'></lensdatabase>", encoding="utf-8")
    (tmp_path / "notes.txt").write_text("nothing", encoding="utf-8")
    assert database_files(tmp_path) == [tmp_path / "odd.xml"]
    with pytest.raises(EnvcalError, match="holds no lens"):
        known_lens(frame(), database=tmp_path)
    (tmp_path / "odd.xml").write_text("<lensdatabase version='1'><lens>", encoding="utf-8")
    with pytest.raises(EnvcalError, match=r"cannot be read as a Lensfun database|holds no lens"):
        known_lens(frame(), database=tmp_path / "odd.xml")


def test_without_the_package_the_message_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "lensfunpy", None)
    with pytest.raises(EnvcalError, match=r"pip install 'envcal\[lens\]'"):
        known_lens(frame())
