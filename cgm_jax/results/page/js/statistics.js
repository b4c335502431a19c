// As results/statistics.py has them; tests hold the two together.

/** Lower quartile, median and upper quartile, interpolated; infinity is a run that never arrived. */
function quartiles(values) {
  const ordered = [...values].sort((a, b) => a - b);
  return [0.25, 0.5, 0.75].map((share) => {
    const place = share * (ordered.length - 1);
    const below = ordered[Math.floor(place)], above = ordered[Math.ceil(place)];
    return below === above || above === Infinity ? above : below + (place % 1) * (above - below);
  });
}

/** Index of the first evaluation at which a run holds `level`, with the ones before it; or -1. */
function firstToHold(rates, level) {
  for (let i = report.holding - 1; i < rates.length; i++) {
    let sum = 0;
    for (let j = i - report.holding + 1; j <= i; j++) sum += rates[j] ?? 0;
    if (sum / report.holding >= level - report.rounding) return i;
  }
  return -1;
}

const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;
const isKnown = (value) => value !== null && value !== undefined;
