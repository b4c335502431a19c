"""How far estimates of masked success are off, from the table that calibration.py writes."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

ESTIMATES = {
    "product": "product of sub-goal rates",
    "joint": "all kept sub-goals achieved at once",
}
MEASURED = {"without_noise": "without noise", "with_noise": "with exploration noise"}


def calibration_errors(
    rows: Sequence[Mapping[str, Any]],
) -> dict[tuple[str, str], tuple[float, float]]:
    """Mean absolute error and mean error of each estimate against each measurement."""
    table = {}
    for estimate in ESTIMATES:
        for measured in MEASURED:
            difference = np.array([float(row[estimate]) - float(row[measured]) for row in rows])
            table[estimate, measured] = (float(abs(difference).mean()), float(difference.mean()))
    return table
