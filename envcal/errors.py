"""The one error that the command line reports without a traceback."""


class EnvcalError(Exception):
    """A mistake in the input or in the settings: place, value, expectation and remedy in one message."""
