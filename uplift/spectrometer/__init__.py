"""The colour chart as a spectrometer: the spectrum of the light on it, from the 24 patches' raw values.

72 linear readings do not determine 81 wavelengths, but lamps are not arbitrary spectra. `measure_light` returns the most
probable non-negative light under a prior made of published and modelled lamps (`lamps`, `prior`), with its standard deviation,
the probability of each family of lamps, and a goodness of fit that refuses a reading which no single light explains
(`measure`). The camera's sensitivities are given, or fitted together with the light (`camera`, `fit`).

Left out: fluorescence of the patches, and lines narrower than the grid's step.
"""

from uplift.spectrometer.chart import Reading, anchored, reading_of
from uplift.spectrometer.lamps import FAMILIES
from uplift.spectrometer.measure import MeasuredLight, chart_reflectances, measure_light

__all__ = ["FAMILIES", "MeasuredLight", "Reading", "anchored", "chart_reflectances", "measure_light", "reading_of"]
