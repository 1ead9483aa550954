// Sets of bytes as ascending, disjoint intervals [start, end), as in byte_intervals.py.

/** The number of bytes. */
export function measure(intervals) {
  return intervals.reduce((sum, [start, end]) => sum + end - start, 0);
}

/** The intervals with [start, end). */
export function insert(intervals, start, end) {
  const joined = intervals.filter((item) => item[1] >= start && item[0] <= end);
  if (joined.length) [start, end] = [Math.min(start, joined[0][0]), Math.max(end, joined.at(-1)[1])];
  return [...intervals.filter((item) => item[1] < start), [start, end], ...intervals.filter((item) => item[0] > end)];
}

/** The parts of the intervals that are in none of the others. */
export function subtract(intervals, others) {
  const left = [];
  for (let [start, end] of intervals) {
    for (const [begin, stop] of others) {
      if (stop <= start || begin >= end) continue;
      if (begin > start) left.push([start, begin]);
      if ((start = stop) >= end) break;
    }
    if (start < end) left.push([start, end]);
  }
  return left;
}
