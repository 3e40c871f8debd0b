"""The lattice uplift, a baseline: the algorithm of Tódová and Wilkie (EGSR 2024), as they describe it.

A cube of evenly spaced RGB colours holds a smooth reflectance for each, fitted under D65 from the centre (½, ½,
½) outwards. Under another emission the same reflectances have other colours, which skews the cube. A pixel is divided
by scale = 2 · max(rgb) and walks from cell to neighbouring cell until one holds it; its reflectance is a mixture of
that cell's eight. RGB is linear in the spectrum, so with the weights that mix the eight *colours* to the pixel's
the mixture of the eight *spectra* has exactly the pixel's RGB: an inversion of the trilinear map, by Newton's method.

What the skewed lattice does not hold is treated as in the paper, and marked: dark pixels are uplifted in the lattice of
D65 (FALLBACK), bright ones, and those that D65 cannot show either, get the nearest colour of the lattice (CLOSEST).

The paper leaves open where the walk starts. Here: at the cell that would hold the colour, divided by the light's, if
nothing were skewed. A walk that gets lost is followed by a search through all cells, so that no pixel counts as
outside by mistake.

It shares no table, look-up or solver with the exact path (`uplift.pixels`), so that the two cannot agree by accident.
"""

from uplift.lattice.cube import Cube, Lattice, build_cube, build_lattice
from uplift.lattice.mixture import rgb_of_lattice, spectra_of_lattice
from uplift.lattice.pixels import LatticeUplift, nodes_and_weights, uplift_lattice

__all__ = [
    "Cube",
    "Lattice",
    "LatticeUplift",
    "build_cube",
    "build_lattice",
    "nodes_and_weights",
    "rgb_of_lattice",
    "spectra_of_lattice",
    "uplift_lattice",
]
