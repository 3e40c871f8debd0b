"""Find and measure the D65 module: a small lamp of known colour that stands in the view beside the chart.

After the chart correction, the light at the chart looks like D65, whatever it was; the module, which does not share
that light, looks as D65 does to an eye adapted to the scene: bluish under a warm light, yellowish under a blue sky.
Where the camera's response to D65 is known, so is that colour; else `adapted_d65_curve` is the curve of D65 as seen from
lights of 1800–12000 K. Regions that stand out from their surround at one of many thresholds, each a factor of √2 above the
last, are candidates (`regions`). What each looks like gives the odds that it is the lamp (`evidence`): its colour, once
what it may reflect of the scene's light is taken off; its brightness; its size and its distance from the chart; whether
it is of one colour, sharply bounded, alone of its kind and not cut by the picture's border. The odds of all candidates, and of
none, make probabilities (`finding`). No lamp is guessed: below a least probability the search is refused with its
remedy, which is to name a rectangle, and short of certainty the odds are told. The reading is the mean over the interior,
so edges do not mix (`reading`); how much of it may be the scene's light is bounded (`reflected`).

With a second picture, taken with the module off, nothing need be known: the difference is the lamp (`lamp_alone`).

The module's own deviation from D65 is not corrected here.
"""

from calibrate.lamp.curve import adapted_d65_curve
from calibrate.lamp.expected import ExpectedColour, ExpectedForm
from calibrate.lamp.finding import find_lamp
from calibrate.lamp.lit import find_lit_lamp
from calibrate.lamp.named import measure_lamp, rectangle_from_chart
from calibrate.lamp.pair import LampAlone, lamp_alone
from calibrate.lamp.reading import Lamp

__all__ = [
    "ExpectedColour",
    "ExpectedForm",
    "Lamp",
    "LampAlone",
    "adapted_d65_curve",
    "find_lamp",
    "find_lit_lamp",
    "lamp_alone",
    "measure_lamp",
    "rectangle_from_chart",
]
