"""What stands beyond the border of a mosaic: its mirror image, which keeps the colours of a 2×2 pattern in place."""

import numpy as np
import numpy.typing as npt


def reflected(n: int, reach: int) -> npt.NDArray[np.int64]:
    """Return the indices −reach … n + reach − 1 reflected into 0 … n − 1 (n ≥ 2) without repeating the edge."""
    i = np.arange(-reach, n + reach) % (2 * n - 2)
    return np.where(i >= n, 2 * n - 2 - i, i)
