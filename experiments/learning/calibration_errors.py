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
    """Mean absolute error and mean error of each estimate against each measurement.

    The full goal is left out without noise: its estimates come from the very episodes that measure
    it then.
    """
    full = max(len(row["kept"].split()) for row in rows)
    masked = [row for row in rows if len(row["kept"].split()) < full]
    table = {}
    for estimate in ESTIMATES:
        for measured in MEASURED:
            judged = masked if measured == "without_noise" else rows
            difference = np.array([float(row[estimate]) - float(row[measured]) for row in judged])
            table[estimate, measured] = (float(abs(difference).mean()), float(difference.mean()))
    return table
