"""The ColorChecker Classic 24: its published colours, where it stands in an image, and what its patches read."""

from calibrate.chart.detect import find_chart
from calibrate.chart.geometry import ChartFound, chart_from_corners
from calibrate.chart.patches import Patches, measure_patches
from calibrate.chart.reference import (
    AFTER_2014,
    REFERENCE_NAMES,
    ChartReference,
    chart_reference,
    measured_reference,
)

__all__ = [
    "AFTER_2014",
    "REFERENCE_NAMES",
    "ChartFound",
    "ChartReference",
    "Patches",
    "chart_from_corners",
    "chart_reference",
    "find_chart",
    "measure_patches",
    "measured_reference",
]
