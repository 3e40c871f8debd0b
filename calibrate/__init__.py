"""Camera counts to calibrated scene radiance: pure functions on arrays.

No function here opens a file, reads a configuration or prints.
"""


class CalibrateError(ValueError):
    """A mistake in the capture or in an argument: place, value, expectation and remedy in one message."""
