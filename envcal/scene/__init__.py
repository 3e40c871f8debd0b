"""A small scene to look at a map with: chart spheres, a grey and a mirror ball, lit by the spectra and by plain RGB."""
