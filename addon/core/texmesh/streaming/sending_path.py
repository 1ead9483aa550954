"""The best order of levels and increments for an uncertain number of bytes. See `controller`."""

from .sending_state import Job

# Bytes after which the client may have to stop, relative to the expected number, equally likely: small ones since lines fade, and because
# what comes is seen at once.
STOPS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3, 1.4, 1.6, 2.0)
MIN_ERROR = 1e-6


def find_path(job: Job, level: int, count: int, owed: float, budget: float, window: float) -> tuple[int, int]:
    """Return the level and the number of increments that the best path has asked for after about `window` bytes.

    A path goes from `level` and `count` increments to the best level of the plan and all increments. Each step is the next level, of which
    parts are of no use, or the increments up to the next number in the plan. The best path has the smallest sum, over STOPS, of errors
    relative to those that the plan has for as many bytes; it is found from its end backwards. A level that is longer than `window` is the
    first step or none.

    Args:
        level: the finest one of which nothing is left to ask for. owed: bytes that are left of the next one. budget: bytes that are
            expected before the limit.
    """
    finest = max(level, min(job.plan, key=lambda row: row[2])[0])
    counts = [count, *sorted({row[1] for row in job.plan if row[1] > count} | ({len(job.ends)} - {count}))]
    begin = measure_increments(job, count)
    textures = [measure_increments(job, other) - begin for other in counts]
    meshes = [0] + [job.levels[other].end - job.levels[level + 1].end + owed for other in range(level + 1, finest + 1)]
    budget = min(budget, meshes[-1] + textures[-1])
    stops = [budget * stop for stop in STOPS]
    weights = [1.0 / _plan_error(job, job.levels[level].end + begin + stop) for stop in stops]
    errors = _level_errors(job, finest, counts)[level:]
    last, rows = len(counts) - 1, finest - level
    takes_level = [[False] * len(counts) for _ in meshes]
    costs: list[float] = []

    def add_cost(cost: float, start: float, end: float, error: float, rise: float) -> float:
        """Add the errors at the stops from `start` to `end`."""
        for stop, weight in zip(stops, weights, strict=True):
            if start <= stop < end:
                cost += weight * (error + (stop - start) * rise)
        return cost

    for row in range(rows, -1, -1):
        finer, costs = costs, [0.0] * len(counts)
        for column in range(last, -1, -1):
            start, error = meshes[row] + textures[column], errors[row][column]
            if start > stops[-1]:
                continue
            if column < last:
                step = textures[column + 1] - textures[column]
                costs[column] = add_cost(costs[column + 1], start, start + step, error, (errors[row][column + 1] - error) / step)
            if row < rows:
                cost = add_cost(finer[column], start, meshes[row + 1] + textures[column], error, 0.0)
                takes_level[row][column] = column == last or cost < costs[column]
                if takes_level[row][column]:
                    costs[column] = cost
            elif column == last:
                costs[column] = add_cost(0.0, start, 2.0 * stops[-1] + 1.0, error, 0.0)
    row = column = 0
    while meshes[row] + textures[column] < window:
        if takes_level[row][column]:
            if row + column and meshes[row + 1] + textures[column] > window:
                break
            row += 1
        elif column < last:
            column += 1
        else:
            break
    return level + row, counts[column]


def measure_increments(job: Job, count: int) -> int:
    """Return the bytes of the first `count` increments."""
    return job.ends[count - 1] - job.begin if count else 0


def _plan_error(job: Job, byte_count: float) -> float:
    """Return the error that the plan has with `byte_count` bytes of levels and increments."""
    fitting = [error for level, count, error in job.plan if job.levels[level].end + measure_increments(job, count) <= byte_count]
    return max(min(fitting + [1.0]), MIN_ERROR)


def _level_errors(job: Job, finest: int, counts: list[int]) -> list[list[float]]:
    """Return the error of each level up to `finest` with each of `counts` increments: linear between rows of the plan, that of the last row
    behind it, and that of a coarser level before the first one and where that is smaller."""
    best, errors = [1.0] * len(counts), []
    for level in range(finest + 1):
        rows = [(measure_increments(job, row[1]), row[2]) for row in job.plan if row[0] == level]
        if not level:
            rows = [(0, 1.0), *rows]
        for column, count in enumerate(counts):
            at = measure_increments(job, count)
            for index, (start, error) in enumerate(rows):
                end, other = rows[index + 1] if index + 1 < len(rows) else (at + 1, error)
                if start <= at < end:
                    best[column] = min(best[column], error + (other - error) * ((at - start) / (end - start)))
        errors.append(list(best))
    return errors
