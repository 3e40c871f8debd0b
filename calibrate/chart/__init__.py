"""ColorChecker charts: their published colours, where they stand in an image, and what their patches read."""

from calibrate.chart.detect import find_chart, find_charts, other_charts
from calibrate.chart.geometry import CLASSIC, CLASSIC_ON_SG, SG, ChartFound, Layout, chart_from_corners
from calibrate.chart.patches import Patches, measure_patches
from calibrate.chart.reference import (
    AFTER_2014,
    REFERENCE_NAMES,
    SG_AFTER_2014,
    ChartReference,
    chart_reference,
    measured_reference,
)

__all__ = [
    "AFTER_2014",
    "CLASSIC",
    "CLASSIC_ON_SG",
    "REFERENCE_NAMES",
    "SG",
    "SG_AFTER_2014",
    "ChartFound",
    "ChartReference",
    "Layout",
    "Patches",
    "chart_from_corners",
    "chart_reference",
    "find_chart",
    "find_charts",
    "measure_patches",
    "measured_reference",
    "other_charts",
]
