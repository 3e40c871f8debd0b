"""Find and measure the D65 module: a small lamp of known colour that stands in the view beside the chart.

After the chart correction, the light at the chart looks like D65, whatever it was; the module, which does not share
that light, looks as D65 does to an eye adapted to the scene: bluish under a warm light, yellowish under a blue sky.
Where the camera's response to D65 is known, so is that colour; else `adapted_d65_curve` is the curve of D65 as seen from
lights of 1800–12000 K. The module is looked for as a region that

- stands out from its surround at one of many thresholds, each a factor of √2 above the last,
- is compact: it fills its smallest rectangle, and is neither tiny nor larger than a few charts,
- has one chromaticity, that colour or on that curve once what it may reflect of the scene's light is taken off,
- shines: usually brighter than the chart's white, and than what surrounds it,
- has no others of its kind beside it, as panes have,
- is near the chart, and not cut by the picture's border.

Each of these is a factor between 0 and 1; their product is the score. No lamp is guessed: below a least score the search is
refused with its remedy, which is to name a rectangle. The reading is the mean over the interior, so edges do not mix.

With a second picture, taken with the module off, nothing need be known: the difference is the lamp (`lamp_alone`).

The module's own deviation from D65 is not corrected here.
"""

from calibrate.lamp.curve import adapted_d65_curve
from calibrate.lamp.finding import find_lamp
from calibrate.lamp.pair import LampAlone, find_lit_lamp, lamp_alone
from calibrate.lamp.reading import Lamp, measure_lamp, rectangle_from_chart

__all__ = [
    "Lamp",
    "LampAlone",
    "adapted_d65_curve",
    "find_lamp",
    "find_lit_lamp",
    "lamp_alone",
    "measure_lamp",
    "rectangle_from_chart",
]
