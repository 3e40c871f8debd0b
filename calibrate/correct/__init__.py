"""Camera RGB to working RGB by a 3×3 matrix, or a root-polynomial, fitted to a colour chart.

The matrix minimises Σ_p w_p |M c_p / s_p − t_p|² over the patches p: c the camera RGB, t the published colours under D65, s
the light that falls on the patch (`model`). Glare and dirt spoil single patches (`spoilt`): those that the others' fit
misses by far are left out, and named; with more than a few of them the chart is refused. `fit` puts it together, `apply`
applies it to pictures.
"""

from calibrate.correct.apply import apply_matrix
from calibrate.correct.fit import ColourFit, fit_matrix
from calibrate.correct.model import least_squares, root_terms

__all__ = ["ColourFit", "apply_matrix", "fit_matrix", "least_squares", "root_terms"]
