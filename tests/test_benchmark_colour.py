"""The colour benchmark measures what it says: on a camera that sees as the eye does nothing is left."""

import numpy as np
import pytest

from benchmarks import __main__ as program
from benchmarks import colour as bench
from uplift.spectrum import observer

EYES = observer()
LUTHER = (EYES.cmfs @ np.array([[0.6, 0.3, 0.05], [0.25, 0.8, -0.02], [0.02, -0.1, 0.7]]).T)[np.newaxis]


def nikon():
    import colour

    known = colour.MSDS_CAMERA_SENSITIVITIES["Nikon 5100 (NPL)"]
    at = EYES.wavelengths_nm
    return np.stack([np.interp(at, known.wavelengths, c, left=0, right=0) for c in known.values.T], -1)[np.newaxis]


def test_without_the_folder_it_says_so_and_measures_nothing(capsys, monkeypatch):
    monkeypatch.delenv("ENVCAL_DATA", raising=False)
    assert program.main(["colour"]) == 0
    assert "skipped" in capsys.readouterr().err


def test_a_luther_camera_leaves_no_difference_under_d65_whatever_the_fit():
    for settings in bench.FITS.values():
        assert bench.differences(LUTHER, bench.chart(), "D65", settings).max() < 1e-5


def test_a_luther_camera_gives_the_temperature_of_every_light_by_its_sensitivities():
    for name in ("A", "2000 K", "FL2"):
        assert np.abs(bench.errors_by_sensitivities(LUTHER, name)).max() < 1e-6


def test_a_light_like_the_lamp_has_no_error_in_any_space_and_a_warm_one_another_in_each():
    day, warm = (
        bench.errors_by_chart(LUTHER, bench.chart(), name, shading="none", spoilt="keep") for name in ("D65", "2000 K")
    )
    assert max(np.abs(errors).max() for errors in day.values()) < 1e-6
    assert len({round(float(errors[0]), 4) for errors in warm.values()}) == len(bench.TRANSFORMS)


@pytest.mark.parametrize("name", ["A", "2000 K"])
def test_a_fall_off_that_the_fit_knows_of_changes_nothing_and_one_that_it_does_not_much(name):
    def error(falls_by, shading):
        errors = bench.errors_by_chart(nikon(), bench.chart(), name, falls_by=falls_by, shading=shading, spoilt="keep")
        return np.abs(errors["CAT16"])

    np.testing.assert_allclose(error(0.3, "plane"), error(0.0, "plane"), atol=1e-6)
    assert error(0.3, "none") > 3 * error(0.3, "plane")
