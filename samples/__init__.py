"""A small spectral forward model of a capture, and the capture that it made.

Not installed with the package: tests and benchmarks import it from the checkout. `python -m samples` makes the
files of `samples/capture` again, bit for bit.
"""

from samples.capture import (
    Capture,
    CaptureSettings,
    Frame,
    bracket,
    encode_frame,
    make_capture,
    write_capture,
)
from samples.chart_view import ChartView, chart_view
from samples.places import THREE_LAMPS, TWO_LAMPS, Chart, Furnace, Lamp, Module, Room
from samples.projection import LatLong, Pinhole
from samples.sensor import Camera, expose
from samples.truth import Truth, truth_of, write_truth
from samples.view import View, look

__all__ = [
    "THREE_LAMPS", "TWO_LAMPS", "Camera", "Capture", "CaptureSettings", "Chart", "ChartView", "Frame",
    "Furnace", "Lamp", "LatLong", "Module", "Pinhole", "Room", "Truth", "View", "bracket", "chart_view",
    "encode_frame", "expose", "look", "make_capture", "truth_of", "write_capture", "write_truth",
]  # fmt: skip
