"""Emission spectra of the families of lamps that an environment map may hold."""
