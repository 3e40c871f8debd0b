"""RAW bracket → radiance in camera RGB.

`asked` is what the settings ask for, `bracket` turns frames into one mosaic, `fall_off` finds the lens's, `stage` does it all
and writes the file, `figures` is what is told of it.
"""

from envcal.steps.merge.asked import changes_of, refuse_unknown_names, rooted
from envcal.steps.merge.fall_off import fall_off
from envcal.steps.merge.stage import merge

__all__ = ["changes_of", "fall_off", "merge", "refuse_unknown_names", "rooted"]
