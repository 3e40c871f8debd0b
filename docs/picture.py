"""Make docs/images/sample.jpg, the picture of the README, from a finished run: `python docs/picture.py output`."""

from __future__ import annotations

import base64
import re
import sys
from pathlib import Path

import cv2
import numpy as np

WIDTH = 1000


def main(output: Path, picture: Path) -> None:
    """Put the report's picture of the map above its picture of the clusters."""
    page = (output / "report.html").read_text(encoding="utf-8")
    images = [
        cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_COLOR)
        for data in re.findall(r"data:image/(?:jpeg|png);base64,([A-Za-z0-9+/=]+)", page)
    ]
    wide = [image for image in images if image.shape[1] == 2 * image.shape[0] and image.shape[1] >= WIDTH]
    chosen = [wide[0], wide[-1]] if len(wide) > 1 else wide
    rows = [cv2.resize(image, (WIDTH, WIDTH // 2), interpolation=cv2.INTER_AREA) for image in chosen]
    picture.parent.mkdir(parents=True, exist_ok=True)
    cv2.imwrite(str(picture), np.vstack(rows), [cv2.IMWRITE_JPEG_QUALITY, 82])


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(__file__).parent / "images" / "sample.jpg")
