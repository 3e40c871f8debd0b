"""The workstation: command line, configuration, order of the stages, files and report."""

__version__ = "0.1.0"
