"""The spectra of the synthetic capture: their grid, their colours, their temperatures."""

import numpy as np
import pytest

from samples import spectra

# CIE 015:2018 gives the chromaticity of D65 to five decimals; the module promises far more against our own sum.
CHROMATICITY = 1e-6


def test_the_d65_module_has_the_chromaticity_of_d65() -> None:
    difference = spectra.xy_of(spectra.d65_module()) - spectra.xy_of(spectra.lamp("D65"))
    assert np.abs(difference).max() < CHROMATICITY


def test_the_d65_module_has_not_the_spectrum_of_d65() -> None:
    module, daylight = spectra.d65_module(), spectra.lamp("D65")
    assert module.min() >= 0.0
    assert np.sqrt(np.mean((module - daylight) ** 2)) > 0.4 * daylight.mean()


# Published: CIE 015:2018 table of LED illuminants and of illuminant A; FL2 in the table of fluorescent lamps.
@pytest.mark.parametrize(("name", "kelvin"), [("LED-B4", 5109), ("LED-B3", 4103), ("A", 2856), ("FL2", 4225)])
def test_a_lamp_has_its_published_temperature(name: str, kelvin: float) -> None:
    assert spectra.cct_of(spectra.lamp(name))[0] == pytest.approx(kelvin, abs=2.0)  # rounding and the 5 nm sum


@pytest.mark.parametrize("name", ["D65", "LED-B4", "A", "D65 module"])
def test_every_lamp_has_a_luminance_of_one(name: str) -> None:
    assert spectra.xyz_of(spectra.lamp(name))[1] == pytest.approx(1.0, rel=1e-12)


def test_an_unknown_lamp_is_refused_with_the_names_of_the_known() -> None:
    with pytest.raises(KeyError, match=r"'LED-B9'.*LED-B4"):
        spectra.lamp("LED-B9")


def test_reflectances_lie_between_nothing_and_one() -> None:
    for reflectances in (spectra.chart_reflectances(), spectra.colour_samples()):
        assert reflectances.shape[1] == 81
        assert reflectances.min() >= 0.0 and reflectances.max() <= 1.0


def test_the_sensitivities_end_where_they_were_measured() -> None:
    sigma = spectra.camera_sensitivities("Sigma SDMerill (NPL)")
    assert sigma.shape == (3, 81)
    assert not sigma[:, spectra.WAVELENGTHS_NM < 400].any()
