"""RAW files → what a frame says about itself, and its mosaic. The only module that imports rawpy.

LibRaw opens more than it can give: a float DNG arrives as rounded integers, a damaged one as zeros or as whatever the
memory held. Whatever is not a mosaic (Bayer, 6×6, monochrome) or a linear image of integers with something recorded in
it is refused here, by name and with a remedy. Orientation is left alone: mosaics are never rotated. The three colours of
a linear frame stand side by side in the rows of its mosaic.
"""

from envcal.raw.frames import KEPT_IF_MOVED, KEPT_MOSAICS, RawFrame, open_bracket, read_frame, read_info, read_mosaic
from envcal.raw.matrix import camera_from_xyz
from envcal.raw.opening import rawpy_version

__all__ = [
    "KEPT_IF_MOVED",
    "KEPT_MOSAICS",
    "RawFrame",
    "camera_from_xyz",
    "open_bracket",
    "rawpy_version",
    "read_frame",
    "read_info",
    "read_mosaic",
]
