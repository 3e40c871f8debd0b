"""Scene radiance to spectra: pure functions on arrays.

No function here opens a file, reads a configuration or prints.
"""


class UpliftError(ValueError):
    """A mistake in a map, a light or an argument: place, value, expectation and remedy in one message."""
